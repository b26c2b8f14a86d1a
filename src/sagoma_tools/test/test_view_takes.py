"""The takes of a folder, and names for new ones."""

import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from capture_rig.errors import InputError
from sagoma_tools.recording.writer import BagWriter
from sagoma_tools.view.takes import new_take, takes_in


def write_bag(folder, begin_s: int, messages: int) -> None:
    with BagWriter(folder) as bag:
        bag.add_topic("/said", "std_msgs/msg/String")
        for k in range(messages):
            bag.write("/said", (begin_s + k) * 1_000_000_000, serialize_message(String(data="x")))


def test_takes_are_listed_with_their_lengths_the_newest_first(tmp_path):
    write_bag(tmp_path / "old", 1000, 3)
    write_bag(tmp_path / "new", 2000, 5)
    (tmp_path / "no take").mkdir()
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "cut.mcap").write_bytes(b"")
    takes = {take.name: take for take in takes_in(tmp_path)}
    assert list(takes) == ["new", "old", "cut"]
    assert takes["new"].seconds == pytest.approx(4.0) and takes["new"].counts == {"/said": 5}
    assert "recover" in takes["cut"].problem


def test_a_folder_that_is_not_there_holds_no_takes(tmp_path):
    assert takes_in(tmp_path / "none") == []


def test_a_new_take_overwrites_nothing_and_stays_in_its_folder(tmp_path):
    assert new_take(tmp_path / "takes", " Anna walks ").name == "Anna walks"
    assert new_take(tmp_path / "takes", "").name.startswith("take-")
    (tmp_path / "takes" / "mine").mkdir()
    with pytest.raises(InputError, match="already"):
        new_take(tmp_path / "takes", "mine")
    for name in ("../up", "a/b", ".hidden", "x" * 100, "a\nb"):
        with pytest.raises(InputError, match="no name"):
            new_take(tmp_path / "takes", name)
