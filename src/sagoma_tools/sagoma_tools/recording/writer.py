"""Writes rosbag2 bags (mcap) that ``ros2 bag`` and Foxglove read, with their provenance; recovers damaged ones."""

from __future__ import annotations

import contextlib
import platform
import shutil
import struct
import subprocess
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, BinaryIO
from xml.etree import ElementTree

import yaml
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer

from capture_rig.errors import InputError

from .reader import SIDECAR_PROVENANCE, SIDECAR_RIG, TYPES, open_bag

INFINITE = QosTime(9223372036, 854775807)
# what every publisher of the graph offers (sagoma_ros.qos)
_QUEUE = (QosHistory.KEEP_LAST, 20, QosReliability.RELIABLE, QosDurability.VOLATILE)
OFFERED = Qos(*_QUEUE, INFINITE, INFINITE, QosLiveliness.AUTOMATIC, INFINITE, False)
OFFERED_LATCHED = OFFERED._replace(depth=1, durability=QosDurability.TRANSIENT_LOCAL)
GIT_TIMEOUT_S = 5.0
VERSIONED = ("rclpy", "numpy", "opencv-python-headless", "numba", "rosbags")


def require_new(folder: str | Path) -> Path:
    """Return the path of a new bag. Raises InputError when it exists: a recording never replaces another."""
    if Path(folder).exists():
        raise InputError("exists already", where=str(folder), remedy="Give the bag another name, or move it away.")
    return Path(folder)


class BagWriter:
    """One bag being written; use as a context manager.

    ``metadata.yaml`` appears in one step when the bag is closed; a bag without it was cut short (``sagoma recover``).
    """

    def __init__(self, folder: str | Path) -> None:
        """InputError when ``folder`` exists already."""
        self.folder = require_new(folder)
        self._writer = Writer(self.folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._connections: dict[str, Connection] = {}
        self._last_ns = 0
        self.counts: dict[str, int] = {}

    def add_topic(self, name: str, msgtype: str, qos: Qos = OFFERED) -> None:
        """Announce a topic with its type's definition, once."""
        if name not in self._connections:
            self._connections[name] = self._writer.add_connection(
                name, msgtype, typestore=TYPES, offered_qos_profiles=(qos,)
            )
            self.counts[name] = 0

    def add_topic_like(self, connection: Connection, name: str) -> None:
        """Announce a topic as another bag has it, once: with that bag's definition of its type, hash and QoS."""
        if name in self._connections:
            return
        offered = getattr(connection.ext, "offered_qos_profiles", ())
        if not (connection.msgdef.data and connection.digest):  # sqlite3 bags of before have none
            self.add_topic(name, connection.msgtype, *offered[:1])
            return
        self._connections[name] = self._writer.add_connection(
            name,
            connection.msgtype,
            msgdef=connection.msgdef.data,
            rihs01=connection.digest,
            offered_qos_profiles=offered,
        )
        self.counts[name] = 0

    def write(self, topic: str, log_ns: int, data: bytes) -> None:
        """Append one serialized message; a clock that steps back cannot put it before its predecessor."""
        self._last_ns = max(self._last_ns, log_ns)
        self._writer.write(self._connections[topic], self._last_ns, data)
        self.counts[topic] += 1

    def describe(self, provenance: Mapping[str, Any], rig: Path | None = None) -> None:
        """Write (or replace) ``sagoma.yaml`` and ``rig.yaml`` in the bag's folder."""
        document = {"software": software_versions(), **provenance}
        (self.folder / SIDECAR_PROVENANCE).write_text(yaml.safe_dump(document, sort_keys=False))
        if rig is not None:
            shutil.copyfile(rig, self.folder / SIDECAR_RIG)

    def close(self) -> None:
        """Finish the file, then write metadata.yaml."""
        self._writer.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def software_versions() -> dict[str, str]:
    """Versions of sagoma (with the commit, in a checkout) and of the packages on which results depend."""
    found = {"sagoma": own_version(), "python": platform.python_version()}
    for package in VERSIONED:
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def own_version() -> str:
    """``0.1.0``, or ``0.1.0 (COMMIT)``, or ``0.1.0 (COMMIT, modified)``."""
    package = Path(__file__).resolve().parents[1]
    try:
        number = version("sagoma_tools")
    except PackageNotFoundError:  # run from a checkout that is not installed
        number = ElementTree.parse(package / "package.xml").findtext("version", "unknown")
    commit = _git(package, "rev-parse", "--short=12", "HEAD")
    if not commit:
        return number
    return f"{number} ({commit}{', modified' if _git(package, 'status', '--porcelain') else ''})"


def _git(folder: Path, *arguments: str) -> str:
    try:
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""  # no git, or no checkout


# A damaged bag has no index and no metadata.yaml: its mcap file is read record by record, up to where it breaks off,
# and copied into a new bag (mcap.dev/spec: one byte opcode, 64-bit length, body; chunks hold records).

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x03, 0x04, 0x05, 0x06
CHUNK_HEAD_BYTES = 8 + 8 + 8 + 4  # start, end, uncompressed size, checksum

Record = tuple[int, memoryview]


def recover_bag(bag: str | Path, target: str | Path) -> dict[str, int]:
    """Copy every message that can still be read from ``bag`` into the new bag ``target``; messages by topic."""
    files = sorted(Path(bag).glob("*.mcap"))
    if len(files) != 1:
        raise InputError(f"holds {len(files)} mcap files", where=str(bag), remedy="Give the folder of one mcap bag.")
    if _is_readable(bag):
        raise InputError("is complete", where=str(bag), remedy="It needs no recovery: it can be read as it is.")
    with files[0].open("rb") as file, BagWriter(target) as writer:
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError("is no mcap file", where=str(files[0]), remedy="Nothing can be recovered from it.")
        _copy(_flat_records(file, str(files[0])), writer)
    for sidecar in (SIDECAR_RIG, SIDECAR_PROVENANCE):
        if (Path(bag) / sidecar).exists():
            shutil.copyfile(Path(bag) / sidecar, Path(target) / sidecar)
    return dict(writer.counts)


def _is_readable(bag: str | Path) -> bool:
    try:
        with open_bag(bag):
            return True
    except InputError:
        return False


def _copy(records: Iterator[Record], writer: BagWriter) -> None:
    types: dict[int, str] = {}
    topics: dict[int, str] = {}
    for opcode, body in records:
        if opcode == SCHEMA:
            types[struct.unpack_from("<H", body)[0]] = _text(body, 2)[0]
        elif opcode == CHANNEL:
            channel, schema = struct.unpack_from("<HH", body)
            topics[channel] = _text(body, 4)[0]
            writer.add_topic(topics[channel], types[schema])
        elif opcode == MESSAGE:
            channel, _sequence, log_ns = struct.unpack_from("<HIQ", body)
            writer.write(topics[channel], log_ns, bytes(body[22:]))


def _flat_records(file: BinaryIO, where: str) -> Iterator[Record]:
    """Yield the records of the file, those inside chunks included, up to where it breaks off."""
    while (record := _read_record(file)) is not None:
        if record[0] == CHUNK:
            yield from _chunk_records(record[1], where)
        else:
            yield record


def _read_record(file: BinaryIO) -> Record | None:
    head = file.read(9)
    if len(head) < 9:
        return None
    opcode, length = struct.unpack("<BQ", head)
    body = file.read(length)
    return (opcode, memoryview(body)) if len(body) == length else None


def _chunk_records(body: memoryview, where: str) -> Iterator[Record]:
    compression, position = _text(body, CHUNK_HEAD_BYTES)
    if compression:
        remedy = "Use the mcap command line's `mcap recover` for this bag."
        raise InputError(f"its chunks are compressed ({compression})", where=where, remedy=remedy)
    position += 8  # the length of what follows
    while position < len(body):
        opcode, length = struct.unpack_from("<BQ", body, position)
        yield opcode, body[position + 9 : position + 9 + length]
        position += 9 + length


def _text(body: memoryview, position: int) -> tuple[str, int]:
    """Return a string with its 32-bit length before it, and the position behind it."""
    (length,) = struct.unpack_from("<I", body, position)
    start = position + 4
    return bytes(body[start : start + length]).decode(), start + length
