"""A trial in BioCV's formats about a person we know, imported and held against what is toured."""

import numpy as np
import pytest
from humaneva_files import write_c3d

from capture_rig.errors import InputError
from capture_rig.session import WRIST_FRACTION, load_session
from sagoma_tools.cli import main
from sagoma_tools.importers.biocv import import_trial

FPS, MOCAP_HZ, FRAMES = 20.0, 100.0, 12
NAMES = ("cam01", "cam02", "cam03", "cam04")
MIDDLE_OF = {7: "ELB", 9: "KNE", 13: "ANK"}  # left points, and the stems of the markers on both sides of the joint
CENTRES = {3: "SJC", 5: "HJC"}


def calibration_text(camera) -> str:
    """The file as the data set's note describes it, millimetres."""
    L = np.eye(4)
    L[:3, :3], L[:3, 3] = camera.T_camera_world[:3, :3], 1000.0 * camera.T_camera_world[:3, 3]
    rows = [[camera.width], [camera.height], *camera.K, [], *L, [], camera.D]
    return "\n".join(" ".join(repr(float(value)) for value in row) for row in rows) + "\n"


def tracks_mm(points_world) -> dict[str, np.ndarray]:
    """Markers (F, 3) of points (F, 15, 3), interpolated to the motion capture's rate."""
    times = np.arange(int(len(points_world) / FPS * MOCAP_HZ)) / MOCAP_HZ
    place = np.clip(times * FPS, 0, len(points_world) - 1)
    before = np.minimum(place.astype(int), len(points_world) - 2)
    share = (place - before)[:, None, None]
    at = 1000.0 * (points_world[before] + share * (points_world[before + 1] - points_world[before]))
    tracks = {"HEAD_TOP": at[:, 1], "C7": at[:, 2] - [30.0, 0, 0], "CLAV": at[:, 2] + [30.0, 0, 0]}
    for side, shift in (("L", 0), ("R", 1)):
        for point, name in CENTRES.items():
            tracks[side + name] = at[:, point + shift]
        for point, name in MIDDLE_OF.items():
            tracks[side + name] = at[:, point + shift] + [0, 40.0, 0]
            tracks[side + name + "M"] = at[:, point + shift] - [0, 40.0, 0]
        elbow, hand = at[:, 7 + shift], at[:, 11 + shift]
        wrist = elbow + WRIST_FRACTION * (hand - elbow)
        across = np.array([0.0, 0.0, 25.0])
        tracks[side + "WRA"], tracks[side + "WRB"] = wrist + across, wrist - across
    return tracks


@pytest.fixture
def trial(toured, tmp_path):
    folder = tmp_path / "P03" / "P03_WALK_01"
    calibration = folder.parent / "calib_02"
    folder.mkdir(parents=True)
    calibration.mkdir()
    for number, camera in enumerate(toured.rig.cameras):
        video = toured.videos[camera.name]
        (folder / f"{number:02d}{video.suffix}").write_bytes(video.read_bytes())
        (calibration / f"{number:02d}.mp4.calib").write_text(calibration_text(camera))
    write_c3d(folder / "markers.c3d", tracks_mm(toured.truth.points_world), MOCAP_HZ, prefix="P03:")
    return folder


def test_rig_points_and_rate_come_back_and_the_command_says_what_comes_next(toured, trial, tmp_path, capsys):
    assert main(["import", "biocv", str(trial), str(tmp_path / "session")]) == 0
    said, session = capsys.readouterr().out, load_session(tmp_path / "session")
    assert (session.fps, list(session.videos)) == (FPS, [*NAMES])
    assert all(text in said for text in (f"{FRAMES} frames", "LKnee: LKNE, LKNEM", f"in {FRAMES} f", "sagoma evaluate"))
    for mine, true in zip(session.rig.cameras, toured.rig.cameras, strict=True):
        points = toured.truth.points_world[0]
        np.testing.assert_allclose(mine.project(points), true.project(points), atol=0.01)
    expected = toured.truth.points_world.copy()
    for elbow, hand in ((7, 11), (8, 12)):
        expected[:, hand] = expected[:, elbow] + WRIST_FRACTION * (expected[:, hand] - expected[:, elbow])
    assert np.abs(session.truth.points_world - expected).max() < 1e-3
    assert session.rig.volume.low[2] < 0.0 < session.rig.volume.high[2]
    assert main(["import", "biocv", str(trial.parent), str(tmp_path / "other")]) == 2
    assert "holds 0 videos" in capsys.readouterr().err


def test_a_marker_that_was_not_seen_leaves_its_point_unknown(toured, trial, tmp_path):
    tracks = tracks_mm(toured.truth.points_world)
    tracks["LKNE"][:5] = 0.0
    write_c3d(trial / "markers.c3d", tracks, MOCAP_HZ)
    said = import_trial(trial, tmp_path / "session")
    unknown = np.isnan(load_session(tmp_path / "session").truth.points_world[:, 9]).any(axis=1)
    assert unknown[0] and not unknown[-1] and f"in {FRAMES - unknown.sum()} frames" in said[-1]


def test_motion_capture_that_began_later_is_moved_in_time(toured, trial, tmp_path):
    import_trial(trial, tmp_path / "session", mocap_delay_s=2.0 / FPS)
    found = load_session(tmp_path / "session").truth.points_world[:, 9]
    assert np.isnan(found[:2]).all()
    np.testing.assert_allclose(found[2:], toured.truth.points_world[:-2, 9], atol=1e-3)


def test_markers_by_other_names_are_listed_and_can_be_given(toured, trial, tmp_path):
    tracks = {name.replace("SJC", "_glen"): track for name, track in tracks_mm(toured.truth.points_world).items()}
    write_c3d(trial / "markers.c3d", tracks, MOCAP_HZ)
    with pytest.raises(InputError, match=r"no markers for LShoulder, RShoulder .* L_glen"):
        import_trial(trial, tmp_path / "session")
    (tmp_path / "markers.yaml").write_text("LShoulder: [L_glen]\nRShoulder: [R_glen]\n")
    said = import_trial(trial, tmp_path / "session", markers=tmp_path / "markers.yaml")
    assert "LShoulder: L_glen" in said


def spoilt(change):
    """Damage to the second camera's calibration."""

    def damage(calibration):
        path = calibration / "01.mp4.calib"
        path.write_text(change(path.read_text()))

    return damage


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (spoilt(lambda text: "1 " + text.split(maxsplit=1)[1]), r"01\.mp4\.calib.*is of images of 1 x"),
        (spoilt(lambda text: " ".join(text.split()[:20])), r"01\.mp4\.calib.*20 finite numbers instead of 32"),
        (lambda calibration: (calibration / "02.mp4.calib").unlink(), r"no calibration of 02\.mp4"),
    ],
)
def test_a_broken_or_missing_calibration_is_named(trial, tmp_path, damage, message):
    damage(trial.parent / "calib_02")
    with pytest.raises(InputError, match=message):
        import_trial(trial, tmp_path / "session")
    assert not (tmp_path / "session").exists()
