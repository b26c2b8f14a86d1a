"""HumanEva-I's file formats one by one, damaged ones too, and the joints that follow from the body model's points."""

import numpy as np
import pytest
from humaneva_files import marker_points, model_points, write_c3d, write_mp

from capture_rig.errors import InputError
from sagoma_tools.importers.formats import Mocap, Offset, common_time, read_c3d, read_cal, read_mp, read_ofs
from sagoma_tools.importers.humaneva_joints import joints, measures
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import walk

CAL = "700 710\n320 240\n0\n-0.2 0.1 0.001 -0.002 0.03\n1 0 0\n0 0 -1\n0 1 0\n100 1200 3400\n"


def tracks(frames=5, seed=1):
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(-900, 900, (frames, 3)) for name in ("RASI", "C7", "PELO", "LFEP")}


def lens_of(path):
    return read_cal(path, "cam01", 640, 480)


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (lens_of, "700 710 320", r"holds 3 finite numbers instead of 22.*fc\(2\)"),
        (lens_of, CAL.replace("3400", "far"), "holds something else than numbers"),
        (lens_of, CAL.replace("3400", "nan"), "holds 21 finite numbers"),
        (lens_of, CAL.replace("0 1 0", "0 1.1 0"), "its R is not a rotation"),
        (lens_of, CAL.replace("0 1 0", "0 -1 0"), "its R is not a rotation"),
        (lens_of, CAL.replace("700", "-700"), r"focal lengths \[-700"),
        (lens_of, CAL.replace("\n0\n", "\n0.01\n"), r".*skew 0\.01"),
        *((read_ofs, text, "") for text in ("1 2", "1 2 0", "1 2 -2")),
    ],
)
def test_damaged_cal_or_ofs_is_refused_by_name(tmp_path, read, text, message):
    (tmp_path / "C1.txt").write_text(text)
    with pytest.raises(InputError, match=r"C1\.txt: " + message) as caught:
        read(tmp_path / "C1.txt")
    assert caught.value.remedy


def test_mp_measures_are_found_by_name(tmp_path):
    path = write_mp(tmp_path / "S2.mp")
    assert read_mp(path, ("LShoulderOffset", "RShoulderOffset")) == {"LShoulderOffset": 46.0, "RShoulderOffset": 52.0}
    for name, message in (
        ("S2.mp", r"S2\.mp: has no line '\$ShoeSize = number'"),
        ("S9.mp", r"S9\.mp: cannot be read"),
    ):
        with pytest.raises(InputError, match=message):
            read_mp(tmp_path / name, ("ShoeSize",))


def test_c3d_in_metres_is_read_as_millimetres_unseen_points_are_unknown_and_missing_ones_are_named(tmp_path):
    written = tracks()
    written["C7"][2] = 0.0
    in_metres = {label: track / 1000 for label, track in written.items()}
    mocap = read_c3d(write_c3d(tmp_path / "x.c3d", in_metres, 120.0, "m", "Chris:"))
    assert mocap.rate_hz == 120.0 and mocap.track_mm("PELO") == pytest.approx(written["PELO"], abs=1e-3)
    assert np.isnan(mocap.track_mm("NONE", "C7")[2]).all()  # either of two names
    with pytest.raises(InputError, match=r"x\.c3d: has no point labelled LFRM or LFRA"):
        mocap.track_mm("LFRM", "LFRA")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path, whole: path.write_bytes(whole[:-200]), r"x\.c3d: ends after 36 of 40 frames"),
        (lambda path, whole: path.write_bytes(whole[:300]), r"x\.c3d: is not a readable \.c3d"),
        (lambda path, whole: path.write_bytes(b"RIFF" + whole), r"x\.c3d: is not a readable \.c3d"),
    ],
)
def test_damaged_c3d_is_refused_by_name(tmp_path, damage, message):
    path = write_c3d(tmp_path / "x.c3d", tracks(frames=40))
    damage(path, path.read_bytes())
    with pytest.raises(InputError, match=message) as caught:
        read_c3d(path)
    assert caught.value.remedy


# --- The common clock of cameras and motion capture, from their offsets alone.


@pytest.mark.parametrize(
    ("offsets", "first_image", "mocap"),
    [  # image 1 at mocap frame 13, 9, 21: the camera that starts latest
        ({"C1": (10, 31, 2), "C2": (7, 21, 2), "BW1": (6, 31, 2)}, {"C1": 5, "C2": 7, "BW1": 1}, [21.0, 31.0]),
        ({"C1": (51, 1, 2), "C2": (61, 1, 2)}, {"C1": 51, "C2": 61}, [1.0, 11.0]),  # motion capture starts latest
        ({"C1": (1, 10, 2), "C2": (1, 9, 2)}, {"C1": 1, "C2": 2}, [10.0, 20.0]),  # half a frame is rounded up
        ({"C1": (1, 1, 1.9), "C2": (1, 1, 2.1)}, {"C1": 1, "C2": 1}, [1.0, 11.0]),  # the rate is the mean of all
    ],
)
def test_common_frame_one_is_where_the_last_begins(offsets, first_image, mocap):
    time = common_time({name: Offset(*offset) for name, offset in offsets.items()})
    assert dict(time.first_image) == first_image
    assert time.mocap(np.array([1, 6])) == pytest.approx(mocap)
    assert time.image("C1", 6) == first_image["C1"] + 5


# --- joints

SIZES = 170.0, {"L": 46.0, "R": 52.0}
GRID_HZ = 600


@pytest.fixture(scope="module")
def person():
    """Points (F, 15, 3) m and torso rotations (F, 3, 3) of a walk at 600 Hz."""
    body = Body.from_stature(1.70)
    poses = walk(body, 3.0, GRID_HZ).poses[1000:1500]
    return np.array([forward(body, pose) for pose in poses]), np.array([pose.R_world_torso for pose in poses])


def mocap_of(points, R_torso):
    tracks = {**marker_points(points), **model_points(points, R_torso)}
    column = {label: index for index, label in enumerate(tracks)}
    return Mocap(None, column, np.stack(list(tracks.values()), axis=1), 120.0)


def test_torso_leans_back_and_upper_arms_turn_back(person):
    points, R_torso = (a[:1] for a in person)
    mocap = mocap_of(points, R_torso)
    placed = {"TRXO": [0, 0, 400], "LCLO": [0, 200, 400]}
    for segment_name, origin, arm in (("PEL", [0, 0, 0], 100), ("LHU", [0, 200, 100], 90), ("LRA", [0, 200, -150], 90)):
        placed[f"{segment_name}O"] = origin
        placed |= {f"{segment_name}{end}": origin + arm * np.eye(3)[k] for k, end in enumerate("ALP")}
    for label, at in placed.items():
        mocap.points_mm[0, mocap.column[label]] = np.array([1000.0, 0.0, 0.0]) + at  # a body that faces +x; mm
    found, _ = joints(mocap, np.array([1.0]), 160.0, {"L": 60.0, "R": 60.0})
    # the torso, 400 long, leans back by atan(80 / 400) from 50 behind the pelvis; the neck is half way to the thorax
    lean = np.arctan2(80.0, 400.0)
    assert found["Pelvis"][0] == pytest.approx([950, 0, 0])
    neck = [1000 + (-50 - 400 * np.sin(lean)) / 2, 0, (400 * np.cos(lean) + 400) / 2]
    assert found["Neck"][0] == pytest.approx(neck)
    # the upper arm: 300 long, turned back by atan(30 / 300); the forearm, 250 long, starts there and is turned forward
    turn = np.arctan2(30.0, 300.0)
    elbow = [1000 - 300 * np.sin(turn), 200, 400 - 300 * np.cos(turn)]
    assert found["LElbow"][0] == pytest.approx(elbow)
    assert found["LWrist"][0] == pytest.approx([elbow[0] + 250 * np.sin(turn), 200, elbow[2] - 250 * np.cos(turn)])


def test_points_that_are_no_frame_and_instants_beyond_the_motion_capture_are_invalid(person):
    points, R_torso = (a[::20] for a in person)
    mocap = mocap_of(points, R_torso)
    column = mocap.column
    mocap.points_mm[4, column["PELA"]] = mocap.points_mm[4, column["PELL"]]  # two axes in one
    mocap.points_mm[6, [column["LFEA"], column["LFEL"]]] = mocap.points_mm[6, [column["LFEL"], column["LFEA"]]]
    _, valid = joints(mocap, np.arange(1.0, 9.0), *SIZES)
    assert valid.tolist() == [True] * 4 + [False, True, False, True]
    _, valid = joints(mocap_of(points, R_torso), np.array([0.5, 1.0, 25.0, 25.2, 60.0]), *SIZES)
    assert valid.tolist() == [False, True, True, False, False]


def test_chest_radius_leaves_out_frames_in_which_a_shoulder_was_not_seen(tmp_path):
    still = {"LSHO": np.tile([0.0, 200.0, 1400.0], (4, 1)), "RSHO": np.tile([0.0, -160.0, 1400.0], (4, 1))}
    still["RSHO"][1] = 0.0
    mp = write_mp(tmp_path / "S2.mp")
    found = measures(read_c3d(write_c3d(tmp_path / "Static.c3d", still)), mp)
    assert found == (pytest.approx(360 / 2 - 7), {"L": 46.0, "R": 52.0})
    still["RSHO"][:] = 0.0
    with pytest.raises(InputError, match=r"Static\.c3d: both shoulder markers"):
        measures(read_c3d(write_c3d(tmp_path / "Static.c3d", still)), mp)
