"""``sagoma takes`` as a user types it."""

import json

import pytest
import take_bags

from sagoma_tools.cli import main
from sagoma_tools.takes.measure import SIDECAR_TAKE, finish_take


@pytest.fixture()
def folder(tmp_path):
    finish_take(take_bags.write_take(tmp_path / "takes" / "walk", 20, doubtful=range(5)))
    take_bags.write_take(tmp_path / "takes" / "old", 10)
    (tmp_path / "takes" / "cut").mkdir()
    (tmp_path / "takes" / "cut" / "cut.mcap").write_bytes(b"")
    return tmp_path / "takes"


def takes(folder, *arguments):
    return main(["takes", *arguments, "--takes", str(folder)])


def test_takes_are_listed_for_people_and_for_programs(folder, capsys):
    assert takes(folder, "list") == 0
    said = capsys.readouterr().out
    rows = {line.split()[0]: line for line in said.splitlines()[1:4]}
    assert "100 %" in rows["walk"] and "25 %" in rows["walk"] and "not measured" in rows["old"]
    assert "recover" in said
    assert takes(folder, "list", "--json") == 0
    listed = {take["name"]: take for take in json.loads(capsys.readouterr().out)}
    assert listed["walk"]["summary"]["persons"]["b0001"]["doubtful"] == 0.25
    assert (listed["old"]["state"], listed["old"]["summary"]) == ("whole", None)
    assert listed["cut"]["state"] == "unfinished"


def test_a_take_is_shown_measured_renamed_trimmed_deleted_and_brought_back(folder, capsys):
    assert takes(folder, "show", "walk") == 0
    said = capsys.readouterr().out
    assert "20 frame sets" in said and "background: good" in said and "S1" in said
    assert takes(folder, "show", "cut") == 1
    assert takes(folder, "measure", "old") == 0 and (folder / "old" / SIDECAR_TAKE).exists()
    assert takes(folder, "rename", "old", "younger") == 0 and (folder / "younger").is_dir()
    assert takes(folder, "trim", "walk", "part", "--from", "0.1", "--to", "0.3") == 0
    capsys.readouterr()
    assert takes(folder, "show", "part") == 0
    assert "trimmed from walk, 0.1 s to 0.3 s" in capsys.readouterr().out
    assert takes(folder, "delete", "walk") == 0 and not (folder / "walk").exists()
    assert takes(folder, "bin") == 0
    assert "walk   deleted 20" in capsys.readouterr().out
    assert takes(folder, "restore", "walk") == 0 and (folder / "walk").is_dir()
    assert takes(folder, "delete", "walk") == 0
    assert takes(folder, "empty") == 2  # nobody to ask
    assert takes(folder, "empty", "--yes") == 0
    assert takes(folder, "restore", "walk") == 2


def test_a_bag_may_be_named_by_its_path(folder, capsys):
    assert main(["takes", "verify", str(folder / "walk"), "--json"]) == 0
    assert {check["grade"] for check in json.loads(capsys.readouterr().out)} == {"ok", "warning"}
    assert main(["takes", "verify", str(folder / "cut")]) == 1
    assert capsys.readouterr().out.startswith("error   ")


def test_checks_printed_into_a_pipe_are_columns(folder, capsys):
    assert takes(folder, "verify", "walk") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 2 and {line[:8] for line in lines} == {"ok      ", "warning "}


def test_a_take_that_is_not_there_is_named(folder):
    assert main(["takes", "show", str(folder / "nobody")]) == 2


def test_a_take_whose_bytes_changed_is_not_measured_anew(folder, capsys):
    file = folder / "walk" / "walk.mcap"
    content = bytearray(file.read_bytes())
    content[content.index(b"good; 100 frames")] ^= 1
    file.write_bytes(content)
    assert takes(folder, "measure", "walk") == 2
    assert "not those that were recorded" in capsys.readouterr().err
