"""Files appear whole or not at all, also when the disk is full or the writer is killed; damaged or hostile YAML is an
error with file, line and remedy, and is found at once."""

import os
import signal
import subprocess
import sys

import pytest

from capture_rig.errors import InputError
from capture_rig.files import make_folder, write_bytes, write_text
from capture_rig.yaml_file import MOST_YAML_BYTES, format_mapping, parse_mapping, read_mapping, save_mapping

KILLED_WRITER = """
import os, signal, sys
from capture_rig.files import replaced_file
with replaced_file(sys.argv[1]) as file:
    file.write(b"half of the new con")
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""
FULL_DISK = """
import resource, signal, sys
from capture_rig.errors import InputError
from capture_rig.files import write_bytes
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
try:
    write_bytes(sys.argv[1], bytes(5000))
except InputError as error:
    print(error)
"""


def test_a_writer_killed_midway_leaves_the_old_content(tmp_path) -> None:
    path = tmp_path / "rig.yaml"
    write_text(path, "old")
    ended = subprocess.run([sys.executable, "-c", KILLED_WRITER, str(path)])
    assert ended.returncode == -signal.SIGKILL
    assert path.read_text() == "old"


def test_a_full_disk_leaves_the_old_content_and_nothing_beside_it(tmp_path) -> None:
    path = tmp_path / "rig.yaml"
    write_text(path, "old")
    said = subprocess.run([sys.executable, "-c", FULL_DISK, str(path)], capture_output=True, text=True, check=True)
    assert said.stdout.startswith(f"{path}: cannot be written (File too large)")
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["rig.yaml"]


def test_the_content_is_on_the_disk_before_the_name_points_to_it(tmp_path, monkeypatch) -> None:
    order = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda descriptor: (order.append("fsync"), fsync(descriptor)))
    monkeypatch.setattr(os, "replace", lambda old, new: (order.append("rename"), replace(old, new)))
    write_bytes(tmp_path / "rig.yaml", b"new")
    assert order == ["fsync", "rename", "fsync"]  # the last one of the folder


def test_a_link_stays_and_its_file_is_replaced(tmp_path) -> None:
    (tmp_path / "there").mkdir()
    write_text(tmp_path / "there" / "rig.yaml", "old")
    (tmp_path / "rig.yaml").symlink_to(tmp_path / "there" / "rig.yaml")
    write_text(tmp_path / "rig.yaml", "new")
    assert (tmp_path / "rig.yaml").is_symlink() and (tmp_path / "there" / "rig.yaml").read_text() == "new"


def test_what_cannot_be_written_is_an_error_with_a_remedy(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    for path, says in (
        (tmp_path / "absent" / "rig.yaml", r"cannot be written \(No such file or directory\). Check the path"),
        (tmp_path, r"cannot be written \(Is a directory\). Check the path"),
    ):
        with pytest.raises(InputError, match=says):
            write_text(path, "new")
    with pytest.raises(InputError, match="cannot be made"):
        make_folder(tmp_path / "file" / "folder")


def test_a_pipe_that_nobody_writes_into_is_refused_at_once(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    command = [sys.executable, "-c", f"from capture_rig.files import read_text; read_text({str(tmp_path / 'pipe')!r})"]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
    assert "is not a regular file" in said.stderr


# --- YAML within limits -----------------------------------------------------------------------------------------------

REMEDY = "Mend it."
ALIASES = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "\n".join(
    f"{name}: &{name} [{', '.join(['*' + before] * 9)}]" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: " + "[" * 1000 + "]" * 1000, "recursion"),
        (ALIASES, "line 5.* more than 100000 values"),
        ("a: &a [*a]", "more than 100000 values"),
        ("b: 0\na: 1\na: 2", r"line 3, column 1: key 'a' appears twice"),
        ("? [1, 2]\n: 3", "a key is a list"),
        ("a: 1" + "0" * 30, "whole number of 31 digits"),
        ("a: " + "9" * 6000, "a value cannot be read"),
        ("a: 2001-99-99", "a value cannot be read"),
        ("a: !!timestamp soon", "a value cannot be read"),
        ("a: !!python/object/apply:os.getcwd []", "could not determine a constructor"),
        ("a: \0", "unacceptable character"),
        ("a: [1", "line 1"),
        ("a: 1\n---\nb: 2", "line 2.*single document"),
        ("just text", "is not a mapping"),
    ],
)
def test_damaged_or_hostile_yaml_is_refused_with_its_place(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as refused:
        parse_mapping(text, "some.yaml", REMEDY)
    assert str(refused.value).startswith("some.yaml: ") and str(refused.value).endswith(REMEDY)
    assert len(str(refused.value)) < 400


def test_what_a_document_holds_twice_is_written_twice_and_an_alias_is_followed() -> None:
    shared = [1, 2]
    text = format_mapping({"a": shared, "b": shared}, default_flow_style=None)
    assert text == "a: [1, 2]\nb: [1, 2]\n"
    assert parse_mapping("a: &x [1, 2]\nb: *x", "", REMEDY) == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"a: 1\nb: \xff\n", "line 2: invalid start byte"), (b"#" * (MOST_YAML_BYTES + 1), "is larger than 4 MiB")],
)
def test_a_file_that_is_no_text_or_too_large_is_refused(tmp_path, content: bytes, says: str) -> None:
    path = tmp_path / "some.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says) as refused:
        read_mapping(path, REMEDY)
    assert str(path) in str(refused.value) and REMEDY in str(refused.value)


def test_a_file_that_cannot_be_opened_is_refused(tmp_path) -> None:
    for path, says in (
        (tmp_path / "absent.yaml", "No such file"),
        (tmp_path, "directory|regular"),
        (tmp_path / ("x" * 5000), "File name too long"),
        (tmp_path / "nu\0ll", "is not a path"),
        ("/dev/zero", "is not a regular file"),
    ):
        with pytest.raises(InputError, match=says) as refused:
            read_mapping(path, REMEDY)
        assert len(str(refused.value)) < 500


def test_what_is_written_is_read_back(tmp_path) -> None:
    document = {"b": [1.5, 2.0], "a": {"name": "Küche", "on": True}}
    save_mapping(tmp_path / "some.yaml", document, "a heading")
    assert read_mapping(tmp_path / "some.yaml", REMEDY) == document
    assert (tmp_path / "some.yaml").read_text(encoding="utf-8").startswith("# a heading\nb:")
