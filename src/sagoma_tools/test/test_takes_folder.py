"""The takes of a folder: listed, named, renamed, deleted and brought back, by the page's and the command's means."""

import json
import os
import time

import pytest
import take_bags

from capture_rig.errors import InputError
from sagoma_tools.cli import main
from sagoma_tools.graph import PATIENCE_S
from sagoma_tools.takes.folder import TakesFolder
from sagoma_tools.takes.measure import SIDECAR_TAKE


@pytest.fixture()
def takes(tmp_path, take_at):
    """A folder with one measured take, of twenty frames of which five are doubtful."""
    take_at(tmp_path / "takes" / "walk", 20, doubtful=range(5))
    return TakesFolder(tmp_path / "takes")


def cut(takes, name="cut", seconds_ago=2 * PATIENCE_S):
    """A bag whose recorder was killed."""
    path = takes.path / name
    path.mkdir()
    (path / "bag.mcap").write_bytes(b"x")
    os.utime(path / "bag.mcap", (time.time() - seconds_ago,) * 2)
    return path


STATES = {"walk": "whole", "old": "whole", "cut": "unfinished"}
STATES |= dict.fromkeys(("broken", "yaml", "binary", "empty", "figures"), "damaged")


def test_takes_are_listed_with_what_is_known_and_a_broken_one_says_why(takes):
    take_bags.write_take(takes.path / "old", 3)
    cut(takes)
    for name, content in (("yaml", b"{"), ("binary", b"\xff\xfe\x00"), ("empty", b"")):
        (take_bags.write_take(takes.path / name, 3) / "metadata.yaml").write_bytes(content)
    damaged = take_bags.write_take(takes.path / "broken", 3) / "broken.mcap"
    damaged.write_bytes(damaged.read_bytes()[:3000])
    (take_bags.write_take(takes.path / "figures", 3) / SIDECAR_TAKE).write_text("format: 99")
    (takes.path / "no take").mkdir()
    found = {take.name: take for take in takes.takes()}
    assert {name: take.state for name, take in found.items()} == STATES
    assert found["walk"].summary.persons["b0001"].rows == 20 and found["old"].summary is None and found["old"].topics
    assert {name for name, take in found.items() if not take.problem} == {"walk", "old"}
    assert "recover" in found["cut"].problem


def test_a_new_take_overwrites_nothing_and_stays_in_its_folder(takes):
    assert takes.new_path(" Anna walks ").name == "Anna walks"
    assert takes.new_path("").name.startswith("take-")
    with pytest.raises(InputError, match="already"):
        takes.new_path("walk")
    for name in ("../up", "a/b", ".hidden", "..", "x" * 100, "a\nb", "name~20261122-120000", "dot.", "ü"):
        with pytest.raises(InputError, match="no name"):
            takes.new_path(name)


def test_nothing_outside_of_the_folder_can_be_named_or_emptied_by_a_link_in_the_bin(takes, tmp_path):
    outside = take_bags.write_take(tmp_path / "outside", 1)
    for name in ("../outside", str(outside), "..", ".", "", "walk/../../outside", "walk\0"):
        for act in (takes.find, takes.delete, lambda name: takes.rename(name, "mine"), takes.restore):
            with pytest.raises(InputError):
                act(name)
    (takes.path / "link").symlink_to(outside)
    takes.delete("link")
    takes.delete("walk")
    assert len(takes.empty_bin()) == 2 and takes.deleted() == []
    assert (outside / "metadata.yaml").exists()


def test_a_deleted_take_comes_back_from_the_bin_whole(takes):
    takes.delete("walk")
    take_bags.write_take(takes.path / "walk", 5)
    takes.delete("walk")
    assert takes.takes() == []
    assert [deleted.name for deleted in takes.deleted()] == ["walk", "walk"]
    takes.restore("walk")
    with pytest.raises(InputError, match="already"):
        takes.restore("walk")
    with pytest.raises(InputError, match="already"):
        takes.rename("walk", "walk")
    takes.rename("walk", "second walk")
    takes.restore("walk")
    assert takes.find("walk").summary.persons["b0001"].rows == 20  # the one that was deleted first
    with pytest.raises(InputError, match="not in the bin"):
        takes.restore("walk")


def test_a_take_that_is_being_recorded_is_left_alone(takes):
    cut(takes, "running", seconds_ago=0)
    for act in (takes.delete, lambda name: takes.rename(name, "mine")):
        with pytest.raises(InputError, match="is being recorded"):
            act("running")
    cut(takes, "killed")
    takes.delete("killed")
    assert [deleted.name for deleted in takes.deleted()] == ["killed"]


# --- sagoma takes


def test_takes_are_listed_shown_verified_measured_renamed_trimmed_deleted_and_brought_back(takes, capsys):
    """Beside the measured take there are one that was not measured and one whose recorder was killed."""
    folder = takes.path
    take_bags.write_take(folder / "old", 10)
    cut(takes)

    def does(status, *arguments):
        assert main(["takes", *arguments, "--takes", str(folder)]) == status
        return capsys.readouterr().out

    said = does(0, "list")
    rows = {line.split()[0]: line for line in said.splitlines()[1:4]}
    assert "100 %" in rows["walk"] and "25 %" in rows["walk"] and "not measured" in rows["old"]
    assert "recover" in said
    listed = {take["name"]: take for take in json.loads(does(0, "list", "--json"))}
    assert listed["walk"]["summary"]["persons"]["b0001"]["doubtful"] == 0.25
    assert {name: take["state"] for name, take in listed.items()} == {n: STATES[n] for n in ("walk", "old", "cut")}
    lines = does(0, "verify", "walk").splitlines()
    assert len(lines) > 2 and {line[:8] for line in lines} == {"ok      ", "warning "}
    checks = json.loads(does(0, "verify", str(folder / "walk"), "--json"))
    assert {check["grade"] for check in checks} == {"ok", "warning"}
    assert does(1, "verify", "cut").startswith("error   ")
    said = does(0, "show", "walk")
    assert "20 frame sets" in said and "background: good" in said and "S1" in said
    does(1, "show", "cut")
    does(0, "measure", "old")
    assert (folder / "old" / SIDECAR_TAKE).exists()
    does(0, "rename", "old", "younger")
    assert (folder / "younger").is_dir()
    does(0, "trim", "walk", "part", "--from", "0.1", "--to", "0.3")
    assert "trimmed from walk, 0.1 s to 0.3 s" in does(0, "show", "part")
    does(0, "delete", "walk")
    assert not (folder / "walk").exists() and "walk   deleted 20" in does(0, "bin")
    does(0, "restore", "walk")
    assert (folder / "walk").is_dir()
    does(0, "delete", "walk")
    does(2, "empty")  # nobody to ask
    does(0, "empty", "--yes")
    does(2, "restore", "walk")
