"""HumanEva's joints from the body model's points: turns by hand, a walking person whole, and lost markers."""

import numpy as np
import pytest
from humaneva_files import SHOULDER_WIDTH_MM, joints_of, marker_points, model_points, write_c3d, write_mp
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from sagoma_tools.importers.formats import Mocap, read_c3d
from sagoma_tools.importers.humaneva_joints import Instants, Measures, joints, measures, segment
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import walk

SIZES = Measures(SHOULDER_WIDTH_MM / 2 - 7.0, {"L": 46.0, "R": 52.0})
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


def test_joints_at_whole_mocap_frames_are_the_persons(person):
    points, R_torso = person
    found = joints(mocap_of(points[::5], R_torso[::5]), np.arange(1.0, 101.0), SIZES)
    assert found.valid.all()
    for name, expected in joints_of(points[::5], R_torso[::5]).items():
        assert found.points_mm[name] == pytest.approx(1e3 * expected, abs=1e-6), name


def test_joints_between_mocap_frames_are_the_persons_within_a_millimetre(person):
    points, R_torso = person  # mocap at 120 Hz: every fifth; asked for at two fifths of the way
    found = joints(mocap_of(points[::5], R_torso[::5]), np.arange(1.0, 99.0) + 0.4, SIZES)
    for name, expected in joints_of(points[2:492:5], R_torso[2:492:5]).items():
        off_mm = np.linalg.norm(found.points_mm[name] - 1e3 * expected, axis=1)
        assert off_mm.max() < 1.0, name
    speed_mm = np.linalg.norm(np.diff(found.points_mm["LAnkle"], axis=0), axis=1)
    assert speed_mm.max() > 15.0  # a mocap frame off would show


def test_sixteen_bit_points_move_the_joints_by_less_than_a_millimetre(person, tmp_path):
    points, R_torso = (a[::50] for a in person)
    tracks = {**marker_points(points), **model_points(points, R_torso)}
    found = joints(read_c3d(write_c3d(tmp_path / "x.c3d", tracks, step=0.1)), np.arange(1.0, 11.0), SIZES)
    assert found.valid.all()
    for name, expected in joints_of(points, R_torso).items():
        assert np.abs(found.points_mm[name] - 1e3 * expected).max() < 1.0, name


def test_torso_leans_back_and_upper_arms_turn_back(person):
    points, R_torso = (a[:1] for a in person)
    mocap = mocap_of(points, R_torso)
    for label, at in (
        ("PELO", [0, 0, 0]),
        ("PELA", [100, 0, 0]),
        ("PELL", [0, 100, 0]),
        ("PELP", [0, 0, 100]),
        ("TRXO", [0, 0, 400]),
        ("LCLO", [0, 200, 400]),
        ("LHUO", [0, 200, 100]),
        ("LHUA", [90, 200, 100]),
        ("LHUL", [0, 290, 100]),
        ("LHUP", [0, 200, 190]),
        ("LRAO", [0, 200, -150]),
        ("LRAA", [90, 200, -150]),
        ("LRAL", [0, 290, -150]),
        ("LRAP", [0, 200, -60]),
    ):
        mocap.points_mm[0, mocap.column[label]] = [1000.0 + at[0], at[1], at[2]]  # a body that faces +x; mm
    found = joints(mocap, np.array([1.0]), Measures(160.0, {"L": 60.0, "R": 60.0})).points_mm
    # the torso, 400 long, leans back by atan(80 / 400) from 50 behind the pelvis; the neck is half way to the thorax
    lean = np.arctan2(80.0, 400.0)
    assert found["Pelvis"][0] == pytest.approx([950, 0, 0])
    neck = [1000 + (-50 - 400 * np.sin(lean)) / 2, 0, (400 * np.cos(lean) + 400) / 2]
    assert found["Neck"][0] == pytest.approx(neck)
    assert neck[0] < 950  # behind the pelvis's point
    # the upper arm: 300 long, turned back by atan(30 / 300); the forearm, 250 long, starts there and is turned forward
    turn = np.arctan2(30.0, 300.0)
    elbow = [1000 - 300 * np.sin(turn), 200, 400 - 300 * np.cos(turn)]
    assert found["LElbow"][0] == pytest.approx(elbow)
    assert found["LWrist"][0] == pytest.approx([elbow[0] + 250 * np.sin(turn), 200, elbow[2] - 250 * np.cos(turn)])


def test_segment_axes_turn_evenly_between_two_mocap_frames():
    begin, turn = Rotation.from_euler("xyz", [0.4, -0.3, 2.0]), np.array([0.2, -0.9, 0.5])
    end = Rotation.from_rotvec(turn) * begin
    origins = np.array([[100.0, 200, 300], [200.0, 250, 310]])
    points = np.array([[o, *(o + 80 * R.as_matrix().T)] for o, R in zip(origins, (begin, end), strict=True)])
    mocap = Mocap(None, {"PELO": 0, "PELA": 1, "PELL": 2, "PELP": 3}, points, 120.0)
    pelvis = segment(mocap, Instants.of(np.array([1.0, 1.25, 2.0]), 2), "PEL")
    for k, share in enumerate((0.0, 0.25, 1.0)):
        expected = Rotation.from_rotvec(share * turn) * begin
        assert (Rotation.from_matrix(pelvis.R_world_segment[k]) * expected.inv()).magnitude() < 1e-9
        assert pelvis.origin_mm[k] == pytest.approx(origins[0] + share * (origins[1] - origins[0]))


@pytest.mark.parametrize("label", ["C7", "RFRA", "LTOE", "TRXO", "PELL", "LHUP", "RTIO", "LFEP"])
def test_frames_beside_a_lost_point_are_invalid_and_no_others(person, label):
    points, R_torso = (a[::20] for a in person)
    mocap = mocap_of(points, R_torso)
    mocap.points_mm[9, mocap.column[label]] = 0.0  # mocap frame 10
    positions = np.array([8.0, 9.0, 9.01, 9.5, 10.0, 10.99, 11.0, 12.0])
    found = joints(mocap, positions, SIZES)
    assert found.valid.tolist() == [True, True, False, False, False, False, True, True]


def test_points_that_are_no_frame_make_the_frame_invalid(person):
    points, R_torso = (a[::20] for a in person)
    mocap = mocap_of(points, R_torso)
    column = mocap.column
    mocap.points_mm[4, column["PELA"]] = mocap.points_mm[4, column["PELL"]]  # two axes in one
    mocap.points_mm[6, [column["LFEA"], column["LFEL"]]] = mocap.points_mm[6, [column["LFEL"], column["LFEA"]]]
    found = joints(mocap, np.arange(1.0, 9.0), SIZES)
    assert found.valid.tolist() == [True] * 4 + [False, True, False, True]


def test_frames_beyond_the_motion_capture_are_invalid(person):
    points, R_torso = (a[::50] for a in person)
    found = joints(mocap_of(points, R_torso), np.array([0.5, 1.0, 10.0, 10.2, 30.0]), SIZES)
    assert found.valid.tolist() == [False, True, True, False, False]


def test_chest_radius_leaves_out_frames_in_which_a_shoulder_was_not_seen(tmp_path):
    still = {"LSHO": np.tile([0.0, 200.0, 1400.0], (4, 1)), "RSHO": np.tile([0.0, -160.0, 1400.0], (4, 1))}
    still["RSHO"][1] = 0.0
    mp = write_mp(tmp_path / "S2.mp")
    found = measures(read_c3d(write_c3d(tmp_path / "Static.c3d", still)), mp)
    assert found.chest_radius_mm == pytest.approx(360 / 2 - 7)
    assert found.shoulder_offset_mm == {"L": 46.0, "R": 52.0}
    still["RSHO"][:] = 0.0
    with pytest.raises(InputError, match=r"Static\.c3d: both shoulder markers"):
        measures(read_c3d(write_c3d(tmp_path / "Static.c3d", still)), mp)
