"""The takes of a folder: listed, named, renamed, deleted and brought back, with nothing overwritten."""

import os
import time

import pytest
import take_bags

from capture_rig.errors import InputError
from sagoma_tools.takes.folder import BEING_WRITTEN_S, TakesFolder
from sagoma_tools.takes.measure import SIDECAR_TAKE, finish_take
from sagoma_tools.takes.take import TakeState


@pytest.fixture()
def takes(tmp_path):
    folder = TakesFolder(tmp_path / "takes")
    take_bags.write_take(folder.new_path("walk"), 20)
    finish_take(folder.path / "walk")
    return folder


def cut(takes, name="cut", seconds_ago=2 * BEING_WRITTEN_S):
    """A bag whose recorder was killed."""
    path = takes.path / name
    path.mkdir()
    (path / "bag.mcap").write_bytes(b"x")
    os.utime(path / "bag.mcap", (time.time() - seconds_ago,) * 2)
    return path


def test_takes_are_listed_with_what_is_known_and_a_broken_one_says_why(takes):
    take_bags.write_take(takes.path / "old", 10)
    cut(takes)
    broken = take_bags.write_take(takes.path / "broken", 10)
    (broken / "broken.mcap").write_bytes((broken / "broken.mcap").read_bytes()[:3000])
    for name, damage in (("yaml", b"{"), ("binary", b"\xff\xfe\x00"), ("empty", b"")):
        (take_bags.write_take(takes.path / name, 3) / "metadata.yaml").write_bytes(damage)
    (take_bags.write_take(takes.path / "figures", 3) / SIDECAR_TAKE).write_text("format: 99")
    (takes.path / "no take").mkdir()
    found = {take.name: take for take in takes.takes()}
    assert found["walk"].state is TakeState.WHOLE and found["walk"].summary.persons["b0001"].rows == 20
    assert found["old"].state is TakeState.WHOLE and found["old"].summary is None and found["old"].topics
    assert found["cut"].state is TakeState.UNFINISHED and "recover" in found["cut"].problem
    for name in ("broken", "yaml", "binary", "empty", "figures"):
        assert found[name].state is TakeState.DAMAGED and found[name].problem, name
    assert "no take" not in found


def test_a_list_is_read_again_only_where_something_changed(takes):
    first = takes.takes()
    assert takes.takes()[0] is first[0]
    finish_take(takes.path / "walk")
    assert takes.takes()[0] is not first[0]


def test_a_folder_that_is_not_there_holds_no_takes(tmp_path):
    assert TakesFolder(tmp_path / "none").takes() == []


def test_a_new_take_overwrites_nothing_and_stays_in_its_folder(takes):
    assert takes.new_path(" Anna walks ").name == "Anna walks"
    assert takes.new_path("").name.startswith("take-")
    with pytest.raises(InputError, match="already"):
        takes.new_path("walk")
    for name in ("../up", "a/b", ".hidden", "..", "x" * 100, "a\nb", "name~20261122-120000", "dot.", "ü"):
        with pytest.raises(InputError, match="no name"):
            takes.new_path(name)


def test_rename_keeps_every_byte_and_overwrites_nothing(takes):
    before = {path.name: path.read_bytes() for path in (takes.path / "walk").iterdir()}
    take_bags.write_take(takes.path / "other", 3)
    with pytest.raises(InputError, match="already"):
        takes.rename("walk", "other")
    for name in ("../out", "", "."):
        with pytest.raises(InputError, match="no name"):
            takes.rename("walk", name)
    moved = takes.rename("walk", "Anna walks")
    assert {path.name: path.read_bytes() for path in moved.iterdir()} == before
    assert takes.find("Anna walks").summary is not None and not (takes.path / "walk").exists()


def test_nothing_outside_of_the_folder_can_be_named(takes, tmp_path):
    take_bags.write_take(tmp_path / "outside", 3)
    for name in ("../outside", str(tmp_path / "outside"), "..", ".", "", "walk/../../outside", "walk\0"):
        for act in (takes.find, takes.delete, lambda name: takes.rename(name, "mine"), takes.restore):
            with pytest.raises(InputError):
                act(name)
    assert (tmp_path / "outside" / "metadata.yaml").exists()


def test_a_deleted_take_comes_back_from_the_bin_whole(takes):
    take_bags.write_take(takes.path / "other", 3)
    takes.delete("walk")
    take_bags.write_take(takes.path / "walk", 5)
    takes.delete("walk")
    assert [take.name for take in takes.takes()] == ["other"]
    assert [deleted.name for deleted in takes.deleted()] == ["walk", "walk"]
    takes.restore("walk")
    with pytest.raises(InputError, match="already"):
        takes.restore("walk")
    takes.restore("walk", "first walk")
    assert takes.find("first walk").summary.persons["b0001"].rows == 20  # the one that was deleted first
    with pytest.raises(InputError, match="not in the bin"):
        takes.restore("walk")


def test_the_bin_is_emptied_for_good_and_a_link_in_it_leads_nowhere(takes, tmp_path):
    outside = take_bags.write_take(tmp_path / "outside", 3)
    (takes.path / "link").symlink_to(outside)
    takes.delete("link")
    takes.delete("walk")
    assert len(takes.empty_bin()) == 2 and takes.deleted() == []
    assert (outside / "metadata.yaml").exists()


def test_a_take_that_is_being_recorded_is_left_alone(takes):
    cut(takes, "running", seconds_ago=0)
    for act in (takes.delete, lambda name: takes.rename(name, "mine")):
        with pytest.raises(InputError, match="is being recorded"):
            act("running")
    cut(takes, "killed")
    takes.delete("killed")
    assert [deleted.name for deleted in takes.deleted()] == ["killed"]
