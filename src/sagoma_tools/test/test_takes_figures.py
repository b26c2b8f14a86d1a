"""Figures of a take, parts of it, and whether it is what was recorded; its files of other programs, and its video."""

import csv

import numpy as np
import pytest
import take_bags
from take_bags import CAMERAS, EPOCH_NS, PERIOD_NS, TYPES, write_take

from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from capture_rig.video import Video
from sagoma_tools.cli import main
from sagoma_tools.overlays import LEFT_BGR
from sagoma_tools.recording.reader import bag_topics, read_messages, read_provenance
from sagoma_tools.recording.recorded_motion import recorded_motions
from sagoma_tools.recording.writer import BagWriter
from sagoma_tools.takes.exporting import BODY_GREY, ROOM_GREY, write_video
from sagoma_tools.takes.folder import TakesFolder, trim
from sagoma_tools.takes.measure import ERROR, OK, WARNING, finish_take, measure, read_summary, verify
from sagoma_tools.takes.take import Background, Summary
from virtual_studio.rig import ring


@pytest.fixture()
def takes(tmp_path, take_at):
    walked = {"doubtful": range(10, 15), "lost": range(22, 24), "missing": range(30, 34)}
    take_at(tmp_path / "takes" / "walk", 50, **walked)
    return TakesFolder(tmp_path / "takes")


def test_figures_are_those_of_the_messages_and_read_back_as_they_were_written(takes):
    summary = read_summary(takes.path / "walk")
    assert summary == measure(takes.path / "walk")
    quality, person = summary.quality, summary.persons["b0001"]
    assert (quality.begins_ns, quality.ends_ns) == (EPOCH_NS, EPOCH_NS + 49 * PERIOD_NS)
    assert (quality.sets, quality.rate_hz, quality.incomplete, quality.unanswered) == (50, 50.0, 4, 4)
    assert quality.seconds == pytest.approx(0.98) and quality.sets_per_s == pytest.approx(50.0)
    assert (person.rows, person.coverage) == (46, pytest.approx(44 / 50))
    assert person.doubtful == pytest.approx(5 / 46, abs=1e-4) and person.lost == pytest.approx(2 / 46, abs=1e-4)
    assert person.sd_mm == pytest.approx(1e3 * take_bags.SIGMA_M, abs=1e-3)
    first, second = summary.cameras["cam01"], summary.cameras["cam02"]
    assert (first.frames, first.serial, first.lost, first.expected) == (50, "S1", 4, 40)
    assert (second.frames, second.lost, second.backgrounds) == (46, None, ())
    assert [background.learned[14:16] for background in first.backgrounds] == ["00", "05"]
    assert first.backgrounds[0] == Background("good; 100 frames", "2026-11-22T18:00:00+00:00", "S1")
    assert "lengths" in summary.body
    for broken in ({}, {"format": 1}, {**summary.document(), "cameras": 3}, {**summary.document(), "quality": {}}):
        with pytest.raises(InputError, match=r"take\.yaml"):
            Summary.parse(broken, "take.yaml")


def test_a_part_is_a_new_take_that_says_what_it_is_of(takes):
    whole = takes.path / "walk"
    before = {path.name: path.read_bytes() for path in whole.iterdir()}
    path = trim(takes, "walk", "middle", 0.1, 0.4)
    assert {file.name: file.read_bytes() for file in whole.iterdir()} == before
    made = takes.find("middle")
    expected = {"take": "walk", "from_s": 0.1, "to_s": 0.4}
    assert {key: made.trimmed_from[key] for key in expected} == expected
    assert made.software == takes.find("walk").software and read_provenance(path)["graph"] == {}
    assert (made.summary.quality.begins_ns, made.summary.quality.sets) == (EPOCH_NS + 5 * PERIOD_NS, 16)
    assert bag_topics(path) == bag_topics(whole)
    kept = [m.data for m in read_messages(whole, "/mocap/torso".__eq__)][5:21]
    assert [m.data for m in read_messages(path, "/mocap/torso".__eq__)] == kept
    assert sum(1 for _ in read_messages(path, "/icp/body".__eq__)) == 1  # from before the cut
    assert sum(1 for _ in read_messages(path, "/diagnostics".__eq__)) == 2
    assert len(recorded_motions(path)["b0001"]) == 16
    assert [file.name for file in path.glob("*.mcap")] == ["middle.mcap"]
    assert {file.name for file in takes.path.iterdir()} == {"walk", "middle"}
    assert trim(takes, "middle", "less", 0.1).name == "less"
    assert takes.find("less").trimmed_from["trimmed_from"]["take"] == "walk"


@pytest.mark.parametrize(
    ("name", "from_s", "to_s", "says"),
    [
        ("middle", -1.0, 1.0, "part"),
        ("middle", 0.6, 0.2, "part"),
        ("middle", 0.101, 0.102, "part"),
        ("walk", 0.1, 0.4, "already"),
        ("../walk", 0.1, 0.4, "no name"),
    ],
)
def test_a_part_that_is_none_or_overwrites_another_is_refused_and_leaves_nothing(takes, name, from_s, to_s, says):
    with pytest.raises(InputError, match=says):
        trim(takes, "walk", name, from_s, to_s)
    assert {file.name for file in takes.path.iterdir()} == {"walk"}


def test_a_take_is_verified_and_a_changed_byte_is_found_and_not_measured_anew(takes, capsys):
    take_bags.write_take(takes.path / "old", 3)  # of before: as far as it can be
    for name in ("walk", "old"):
        assert {check.grade for check in verify(takes.find(name))} == {OK, WARNING}  # there is no rig
    file = takes.path / "walk" / "walk.mcap"
    content = bytearray(file.read_bytes())
    content[content.index(b"good; 100 frames")] ^= 1
    file.write_bytes(content)
    assert any(check.grade == ERROR and "hecksum" in check.text for check in verify(takes.find("walk")))
    assert main(["takes", "measure", "walk", "--takes", str(takes.path)]) == 2
    assert "not those that were recorded" in capsys.readouterr().err
    file.write_bytes(content[: len(content) // 2])
    assert ERROR in {check.grade for check in verify(takes.find("walk"))}


# --- files of other programs, and videos

FRAMES = 8


def test_every_format_is_written_beside_the_take_and_none_is_overwritten(tmp_path, take_at, capsys):
    take = take_at(tmp_path / "first", 20)
    assert main(["export", str(take)]) == 0
    names = {path.name for path in (take / "export").iterdir()}
    assert names == {f"first.{kind}" for kind in ("bvh", "glb", "c3d", "trc", "osim", "mot", "csv")}
    assert "b0001: 20 frames at 50 Hz, no gaps" in capsys.readouterr().out
    (take / "export" / "first.trc").write_text("mine")
    arguments = ["export", str(take), "--format", "trc", "bvh"]
    assert main(arguments) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (take / "export" / "first.trc").read_text() == "mine"
    assert main([*arguments, "--overwrite"]) == 0
    assert (take / "export" / "first.trc").read_text() != "mine"


def test_several_persons_get_a_file_each_with_the_numbers_of_the_bag_and_one_of_nobody_is_refused(tmp_path, capsys):
    take = write_take(tmp_path / "two", 20, prefixes=("/mocap", "/mocap/bodies/b0002"), missing=range(7, 9))
    assert main(["export", str(take), "--format", "csv", "--output", str(tmp_path / "out")]) == 0
    places_m = []
    for person in ("b0001", "b0002"):
        text = (tmp_path / "out" / f"two_{person}.csv").read_text(encoding="utf-8")
        rows = list(csv.DictReader(text.splitlines()))
        assert [k for k, row in enumerate(rows) if row["state"] == ""] == [7, 8]
        places_m += [[float(rows[k][f"torso_{axis}_m"]) for axis in "xy"] for k in (0, 19)]
    np.testing.assert_allclose(np.subtract(places_m, places_m[0]), [[0, 0], [0, 0.19], [1, 0], [1, 0.19]], atol=1e-6)
    with BagWriter(tmp_path / "empty") as bag:
        bag.add_topic("/mocap/reference_points", TYPES["reference_points"])
    assert main(["export", str(tmp_path / "empty")]) == 2
    assert "holds no tracked person" in capsys.readouterr().err


@pytest.fixture(scope="module")
def take(tmp_path_factory):
    """A take of two cameras, one of which shows a silhouette of its left half."""
    folder = tmp_path_factory.mktemp("takes")
    rig = ring(2, False)
    halves = {}
    for camera in rig.cameras:
        canvas = camera.undistorted_view().camera
        halves[camera.name] = np.zeros((canvas.height, canvas.width), np.uint8)
    halves[CAMERAS[0]][:, : halves[CAMERAS[0]].shape[1] // 2] = 255
    path = write_take(folder / "walk", FRAMES, masks=halves)
    save_rig(rig, path / "rig.yaml")
    finish_take(path)
    return TakesFolder(folder).find("walk")


def test_a_person_is_drawn_over_the_silhouettes_of_every_camera(take, tmp_path):
    assert write_video(take, tmp_path / "walk.avi") == FRAMES
    with Video(tmp_path / "walk.avi") as video:
        shown = list(video)
    assert len(shown) == FRAMES and not (tmp_path / ".walk.part.avi").exists()
    left, right = np.array_split(shown[3].astype(int), 2, axis=1)
    for half in (left, right):
        assert (np.abs(half - LEFT_BGR).max(-1) < 90).sum() > 50
    quarter = left.shape[1] // 8
    middle = left[left.shape[0] // 2 + 100]
    assert abs(middle[quarter].mean() - BODY_GREY) < 25 and abs(middle[-quarter].mean() - ROOM_GREY) < 25


def test_what_cannot_be_drawn_is_said_before_anything_is_written(take, tmp_path):
    bare = write_take(tmp_path / "bare", 3)
    for arguments, says in (
        ((take, tmp_path / "v.gif"), "cannot be written"),
        ((take, take.path / "rig.yaml"), "exists already"),
        ((TakesFolder(tmp_path).find("bare"), tmp_path / "v.avi"), r"no rig\.yaml"),
    ):
        with pytest.raises(InputError, match=says):
            write_video(*arguments)
    assert {path.name for path in tmp_path.iterdir()} == {bare.name}
