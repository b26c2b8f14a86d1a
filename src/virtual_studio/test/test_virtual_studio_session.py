"""Session folders: what is in them, repeatability, and what happens when they cannot be written."""

import numpy as np
import pytest
import yaml

from capture_rig.errors import InputError
from capture_rig.rigid import rotation_matrix
from capture_rig.session import load_session
from capture_rig.video import Video
from stick_figure.body import Body, load_body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from virtual_studio.__main__ import main
from virtual_studio.motions.catalogue import tour
from virtual_studio.recording.session import TORSO_COLUMNS, RenderSettings, write_session
from virtual_studio.rig import ring

BODY = Body.from_stature(1.80)
RIG = ring(1, ceiling=True)
FRAMES = 16
SETTINGS = dict(rig=RIG, body=BODY, motion="tour", fps=10, seconds=FRAMES / 10)


def read_grey(path):
    """All frames (F, h, w) of a grey video."""
    with Video(path) as video:
        return np.array([image[..., 0] for image in video])


@pytest.fixture(scope="module")
def session_folder(tmp_path_factory):
    return write_session(tmp_path_factory.mktemp("studio") / "session", settings=RenderSettings(seed=4), **SETTINGS)


def test_session_reads_back_as_it_was_written(session_folder):
    session = load_session(session_folder)
    assert session.fps == 10
    assert set(session.videos) == set(session.backgrounds) == set(session.masks) == {"cam01", "cam02"}
    assert session.rig.names == RIG.names
    for name in session.videos:
        assert read_grey(session.videos[name]).shape == (FRAMES, 480, 640)
        assert read_grey(session.backgrounds[name]).shape == (15, 480, 640)
        assert set(np.unique(read_grey(session.masks[name]))) == {0, 255}


def test_truth_reads_back_with_points_and_angles(session_folder):
    truth, played = load_session(session_folder).truth, tour(BODY, FRAMES / 10, 10)
    np.testing.assert_array_equal(truth.frames, np.arange(FRAMES))
    points = np.array([forward(BODY, pose) for pose in played.poses])
    np.testing.assert_allclose(truth.points_world, points, atol=2e-7)
    np.testing.assert_allclose(truth.angles, played.angles, atol=1e-7)


def test_truth_points_follow_from_the_files_angles_torso_and_body(session_folder):
    truth, body = load_session(session_folder).truth, load_body(session_folder / "body.yaml")
    table = np.genfromtxt(session_folder / "truth.csv", delimiter=",", names=True)
    for frame in range(0, FRAMES, 3):
        torso = np.array([table[name][frame] for name in TORSO_COLUMNS])
        pose = Pose.from_angles(torso[:3], rotation_matrix(torso[3:]), truth.angles[frame])
        np.testing.assert_allclose(forward(body, pose), truth.points_world[frame], atol=1e-6)


def test_footage_shows_the_person_where_the_mask_is(session_folder):
    session = load_session(session_folder)
    for name in session.videos:
        footage = read_grey(session.videos[name]).astype(float)
        empty, masks = read_grey(session.backgrounds[name]).mean(0), read_grey(session.masks[name]) > 0
        difference = np.abs(footage - empty)
        for frame in (0, 8, FRAMES - 1):
            assert 2000 < masks[frame].sum() < 40_000
            inside, outside = difference[frame][masks[frame]], difference[frame][~masks[frame]]
            assert np.median(inside) > 30
            assert np.median(outside) < 6


def test_footage_keeps_noise_after_decoding(session_folder):
    empty = read_grey(load_session(session_folder).backgrounds["cam01"]).astype(float)
    still = empty - empty.mean((1, 2), keepdims=True)  # without flicker
    assert 0.8 < still.std(0).mean() < 3.5


def test_same_seed_gives_the_same_bytes_of_every_frame(session_folder, tmp_path):
    again = write_session(tmp_path / "again", settings=RenderSettings(seed=4), **SETTINGS)
    for kind in ("videos", "masks", "backgrounds"):
        first, second = getattr(load_session(session_folder), kind), getattr(load_session(again), kind)
        for name in first:
            assert read_grey(first[name]).tobytes() == read_grey(second[name]).tobytes()
    assert (session_folder / "truth.csv").read_bytes() == (again / "truth.csv").read_bytes()


def test_folder_of_someone_else_is_refused_and_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "session.yaml").write_text("fps: 60\n")
    with pytest.raises(InputError, match="not empty"):
        write_session(tmp_path, **SETTINGS)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    with pytest.raises(InputError, match=r"notes\.txt"):
        write_session(tmp_path / "notes.txt", **SETTINGS)


def test_interrupted_writing_leaves_the_older_session_and_no_rest(tmp_path):
    folder = tmp_path / "session"
    short = SETTINGS | {"rig": ring(1, ceiling=False), "seconds": 0.2, "motion": "t_pose_only"}
    write_session(folder, **short)
    before = (folder / "truth.csv").read_bytes()

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_session(folder, **(short | {"seconds": 0.5}), progress=stop)
    assert (folder / "truth.csv").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["session"]
    write_session(folder, **(short | {"seconds": 0.3}))
    assert len(load_session(folder).truth.frames) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["session"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"motion": "dance"}, "dance"),
        ({"noise": -1.0}, "noise"),
        ({"flicker": 2.0}, "flicker"),
        ({"seed": -3}, "seed"),
        ({"fps": 0.0}, "fps"),
        ({"noise": float("nan")}, "noise"),
    ],
)
def test_impossible_settings_are_refused_before_anything_is_written(tmp_path, change, words):
    with pytest.raises(InputError, match=words):
        given = SETTINGS | change
        settings = RenderSettings(**{key: given.pop(key) for key in ("seed", "noise", "flicker") if key in given})
        write_session(tmp_path / "session", **given, settings=settings)
    assert list(tmp_path.iterdir()) == []


def test_command_line_writes_a_session_and_says_what_or_what_is_wrong_in_one_line(tmp_path, capsys):
    folder = tmp_path / "session"
    arguments = ["--cameras", "1", "--no-ceiling", "--seconds", "0.2", "--fps", "10", "--stature", "1.6"]
    arguments += ["--size", "320x200"]
    assert main([str(folder), *arguments]) == 0
    assert "1 cameras x 2 frames" in capsys.readouterr().out
    rig, usual = load_session(folder).rig, ring(1, ceiling=False)
    assert rig.names == ("cam01",) and (rig.cameras[0].width, rig.cameras[0].height) == (320, 200)
    point, (x, y) = np.array([[0.3, -0.2, 1.0]]), usual.cameras[0].project(np.array([[0.3, -0.2, 1.0]]))[0]
    across = (x + 0.5) / 2 - 0.5, (y + 0.5) / 2 - 0.5 - 20.0  # half the pixels, 20 rows cut off at the top
    np.testing.assert_allclose(rig.cameras[0].project(point)[0], across, atol=1e-3)
    assert load_body(folder / "body.yaml").stature == pytest.approx(1.6)
    assert yaml.safe_load((folder / "session.yaml").read_text())["recipe"]["motion"] == "tour"
    (tmp_path / "other").write_text("in the way")
    assert main([str(tmp_path / "other"), *arguments]) == 2
    error = capsys.readouterr().err
    assert "virtual_studio:" in error and len(error.splitlines()) == 1
