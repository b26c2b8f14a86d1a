"""Files appear whole or not at all, also when the disk is full or the writer is killed."""

import os
import signal
import subprocess
import sys

import pytest

from capture_rig.errors import InputError
from capture_rig.files import make_folder, replaced_file, write_bytes, write_text

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


def test_an_error_while_writing_leaves_the_old_content(tmp_path) -> None:
    path = tmp_path / "rig.yaml"
    write_text(path, "old")
    with pytest.raises(ZeroDivisionError), replaced_file(path) as file:
        file.write(b"new")
        raise ZeroDivisionError
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


def test_a_new_file_follows_the_users_mask(tmp_path) -> None:
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "rig.yaml", "new")
    finally:
        os.umask(before)
    assert (tmp_path / "rig.yaml").stat().st_mode & 0o777 == 0o640


def test_what_cannot_be_written_is_an_error_with_a_remedy(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    for path, says in (
        (tmp_path / "absent" / "rig.yaml", r"cannot be written \(No such file or directory\). Check the path"),
        (tmp_path / ("x" * 300), r"cannot be written \(File name too long\). Give a shorter path"),
        (tmp_path, r"cannot be written \(Is a directory\). Give the path of a file"),
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
