"""A whole data set in HumanEva-I's formats about a person we know, imported and held against what is known."""

import shutil

import numpy as np
import pytest
import yaml
from humaneva_files import FIRST_IMAGE, LAST_COMMON, write_avi, write_data_set

from capture_rig.errors import InputError
from capture_rig.session import load_session
from capture_rig.video import Video
from sagoma_tools.cli import main
from sagoma_tools.importers.humaneva import Trial, import_trial

FIRST = 6
CAMERAS = ("C1", "C2", "C3", "BW1")
NAMES = dict(zip(CAMERAS, ("cam01", "cam02", "cam03", "cam04"), strict=True))
WITH_TRUTH = [*range(8, 10), *range(13, 20), *range(21, 36)]  # common frames, from the data set's DROPOUTS
_JOINTS = "Head Neck LShoulder RShoulder LHip RHip LElbow RElbow LKnee RKnee LWrist RWrist LAnkle RAnkle"
JOINT_OF_POINT = dict(enumerate(_JOINTS.split(), start=1))


@pytest.fixture(scope="module")
def data_set(tmp_path_factory):
    return write_data_set(tmp_path_factory.mktemp("humaneva"))


@pytest.fixture(scope="module")
def imported(data_set, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sessions") / "walking"
    return folder, import_trial(trial_of(data_set.root), folder, CAMERAS)


@pytest.fixture(scope="module")
def films(imported):
    """All images of each camera of the imported session, (F, h, w, 3)."""
    return {name: images(path) for name, path in load_session(imported[0]).videos.items()}


@pytest.fixture
def copy(data_set, tmp_path):
    """The data set's folder, to be damaged."""
    return shutil.copytree(data_set.root, tmp_path / "copy")


def trial_of(root):
    return Trial(root, "S2", "Walking", 1)


def images(path):
    with Video(path) as video:
        return np.array(list(video))


def test_every_common_frame_from_the_sixth_on_is_the_data_sets_own_in_colour_and_grey(data_set, imported, films):
    session = load_session(imported[0])
    assert session.fps == 60.0 and session.rig.volume.low[2] == -0.05
    assert yaml.safe_load((imported[0] / "session.yaml").read_text())["first_mocap_frame"] == 31.4
    assert {*map(len, films.values())} == {LAST_COMMON - FIRST + 1}
    for camera, name in NAMES.items():
        source = images(data_set.root / "S2" / "Image_Data" / f"Walking_1_({camera}).avi")
        copied = films[name]
        start = FIRST_IMAGE[camera] + FIRST - 2
        if camera.startswith("BW"):
            assert (copied[..., 0] == copied[..., 2]).all()
            assert np.abs(copied[..., 1].astype(int) - source[start : start + len(copied), ..., 1]).max() <= 1
        else:
            assert (copied == source[start : start + len(copied)]).all()
            assert copied[..., 2].mean() > 1.2 * copied[..., 0].mean()  # the tint


def test_the_empty_room_in_the_footages_light_is_taken_without_its_first_images(data_set, imported):
    folder, said = imported
    for camera, name in NAMES.items():
        assert f"empty room of {camera}: Background_2_({camera}).avi" in said
        empty = images(load_session(folder).backgrounds[name])
        assert len(empty) == 8  # 13 less the five at the begin, which are black here
        assert empty.mean(axis=(1, 2, 3)).min() > 20


def test_truth_is_where_the_person_was_and_empty_in_gaps(data_set, imported):
    folder, said = imported
    truth = load_session(folder).truth
    known = np.isfinite(truth.points_world).all(axis=(1, 2))
    assert (truth.frames[known] + FIRST).tolist() == WITH_TRUTH and f"complete in {len(WITH_TRUTH)} of" in said[-1]
    for frame, points in zip(truth.frames[known] + FIRST, truth.points_world[known], strict=True):
        for index, joint in JOINT_OF_POINT.items():
            assert np.linalg.norm(points[index] - data_set.joints[frame][joint]) < 1e-3, (frame, joint)
    first, *others = (folder / "truth.csv").read_text().splitlines()[1:]
    assert first.startswith("2,0")  # common frame 8
    assert [set(row.removeprefix("4")) for row in others if row.startswith("4,")] == [{","}]


def test_command_imports_chosen_frames_and_says_what_is_there(data_set, tmp_path, capsys):
    options = ["--subject", "S2", "--action", "Walking", "--frames", "13", "22", "--cameras", "C1", "C2", "C3"]
    assert main(["import", "humaneva", str(data_set.root), str(tmp_path / "chosen"), *options]) == 0
    said = capsys.readouterr().out
    assert "10 frames of C1, C2, C3" in said and "9 of them (90%)" in said
    truth = load_session(tmp_path / "chosen").truth
    assert truth.frames.tolist() == list(range(10))
    assert truth.points_world[0, 1] == pytest.approx(data_set.joints[13]["Head"], abs=1e-3)


def test_footage_alone_needs_no_motion_capture(copy, tmp_path):
    for path in (copy / "S2" / "Mocap_Data").iterdir():
        path.unlink()
    with pytest.raises(InputError, match=r"Walking_1\.c3d: cannot be read .*--no-truth"):
        import_trial(trial_of(copy), tmp_path / "out", CAMERAS)
    said = import_trial(trial_of(copy), tmp_path / "out", ("C2",), (6, 8), with_truth=False)
    session = load_session(tmp_path / "out")
    assert session.truth is None and said[0] == "S2 Walking_1: 3 frames of C2"
    assert session.fps == 60.0


MOVIE, ROOM = "S2/Image_Data/Walking_1_(C{}).avi", "Background/Background_1_(C2).avi"


def missing(path):
    return lambda root: root.joinpath(path).unlink()


def black(path, count, *shape):
    return lambda root: write_avi(root / path, [np.zeros(shape, np.uint8)] * count)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (missing(MOVIE.format(2)), r"\(C2\)\.avi: is not there.*has Walking_1_\(BW1\), Walking_1_\(C1\)"),
        (lambda root: root.joinpath(MOVIE.format(2)).write_text("none"), r"\(C2\)\.avi: cannot be opened as a video"),
        (missing("S2/Calibration_Data/BW1.cal"), r"BW1\.cal: is not there"),
        (missing("S2/Sync_Data/Walking_1_(C1).ofs"), r"\(C1\)\.ofs: is not there"),
        (missing("S2/Mocap_Data/Static.c3d"), r"Static\.c3d: cannot be read"),
        (black(MOVIE.format(3), 5, 240, 320), r"\(C3\)\.avi: ends after 5 images, before image 8"),
        (black(ROOM, 9, 120, 160), r"Background_1_\(C2\)\.avi: its images have shape \(120, 160, 3\)"),
        (lambda root: shutil.rmtree(root / "Background"), r"Background: has no Background_\*_\(C1\)\.avi"),
    ],
)
def test_damaged_file_is_named_with_a_remedy_and_nothing_is_left(copy, tmp_path, damage, message):
    damage(copy)
    with pytest.raises(InputError, match=message) as caught:
        import_trial(trial_of(copy), tmp_path / "out", CAMERAS)
    assert caught.value.remedy
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copy"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--subject S7 --action Walking", "S7/Sync_Data/Walking_1_(C1).ofs: is not there. Unpack Sync_Data of S7"),
        ("--subject S2 --action Jog", "Jog_1_(C1).ofs: is not there. S2 has Walking_1_(BW1)"),
        ("--subject S2 --action Walking --frames 1 9", "--frames: 1 9 is not a range"),
        ("--subject S2 --action Walking --frames 9 8", "--frames: 9 8 is not a range"),
        ("--subject S2 --action Walking --frames 30 90", "too early. Import fewer frames"),
        ("--subject S2 --action Walking --frames 36 38", "no imported frame of S2 Walking_1 has"),
    ],
)
def test_command_says_what_it_cannot_use(data_set, tmp_path, capsys, arguments, message):
    given = [str(data_set.root), str(tmp_path / "out"), *arguments.split(), "--cameras", "C1"]
    assert main(["import", "humaneva", *given]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
