"""``sagoma export`` on bags as the graph records them."""

import csv

import pytest
from take_bags import TYPES, write_take

from sagoma_tools.cli import main
from sagoma_tools.recording.recorded_motion import recorded_motions
from sagoma_tools.recording.writer import BagWriter


def test_every_format_is_written_beside_the_take(tmp_path, capsys):
    take = write_take(tmp_path / "first", 20)
    assert main(["export", str(take)]) == 0
    names = {path.name for path in (take / "export").iterdir()}
    assert names == {f"first.{kind}" for kind in ("bvh", "glb", "c3d", "trc", "osim", "mot", "csv")}
    assert "b0001: 20 frames at 50 Hz, no gaps" in capsys.readouterr().out


def test_numbers_of_the_bag_arrive(tmp_path):
    take = write_take(tmp_path / "first", 20, missing=range(7, 9))
    assert main(["export", str(take), "--format", "csv", "--output", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "first.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows].count("") == 2 and rows[7]["state"] == ""
    assert float(rows[19]["torso_y_m"]) - float(rows[0]["torso_y_m"]) == pytest.approx(0.19, abs=1e-6)


def test_several_persons_get_a_file_each(tmp_path):
    take = write_take(tmp_path / "two", 20, prefixes=("/mocap", "/mocap/bodies/b0002"))
    motions = recorded_motions(take)
    assert sorted(motions) == ["b0001", "b0002"]
    assert motions["b0002"].points_world[0, 0, 0] - motions["b0001"].points_world[0, 0, 0] == pytest.approx(1.0)
    assert main(["export", str(take), "--format", "bvh", "--output", str(tmp_path)]) == 0
    assert (tmp_path / "two_b0001.bvh").exists() and (tmp_path / "two_b0002.bvh").exists()


def test_files_that_exist_are_not_overwritten(tmp_path, capsys):
    take = write_take(tmp_path / "first", 20)
    arguments = ["export", str(take), "--format", "trc", "bvh"]
    assert main(arguments) == 0
    (take / "export" / "first.trc").write_text("mine")
    assert main(arguments) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (take / "export" / "first.trc").read_text() == "mine"
    assert main([*arguments, "--overwrite"]) == 0
    assert (take / "export" / "first.trc").read_text() != "mine"


def test_a_bag_without_a_person_is_refused(tmp_path, capsys):
    with BagWriter(tmp_path / "empty") as bag:
        bag.add_topic("/mocap/reference_points", TYPES["reference_points"])
    assert main(["export", str(tmp_path / "empty")]) == 2
    assert "holds no tracked person" in capsys.readouterr().err
