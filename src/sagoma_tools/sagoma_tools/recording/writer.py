"""Writes rosbag2 bags (mcap) that ``ros2 bag`` and Foxglove read, with their provenance; recovers those cut short."""

from __future__ import annotations

import contextlib
import os
import platform
import shutil
import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.well_known import MessageEncoding, Profile
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.typesys import TypesysError

from capture_rig.errors import InputError
from capture_rig.files import copy_file, describe_os_error, sync_folder, write_text
from capture_rig.yaml_file import save_mapping

from .reader import METADATA, SIDECAR_PROVENANCE, SIDECAR_RIG, TYPES

INFINITE = QosTime(9223372036, 854775807)
# the QoS of every publisher of the graph (sagoma_ros.qos)
_QUEUE = (QosHistory.KEEP_LAST, 20, QosReliability.RELIABLE, QosDurability.VOLATILE)
OFFERED = Qos(*_QUEUE, INFINITE, INFINITE, QosLiveliness.AUTOMATIC, INFINITE, False)
OFFERED_LATCHED = OFFERED._replace(depth=1, durability=QosDurability.TRANSIENT_LOCAL)
CHUNK_BYTES = 1 << 20
SYNC_S = 0.5  # the disk has a message after at most twice as long, if it can write at all
VERSIONED = ("rclpy", "numpy", "opencv-python-headless", "numba", "rosbags", "mcap")


def require_new(folder: str | Path) -> Path:
    """Return the path of a new bag. Raises InputError when it exists: a recording never replaces another."""
    if Path(folder).exists():
        raise InputError("exists already", where=str(folder), remedy="Give the bag another name, or move it away.")
    return Path(folder)


class BagWriter:
    """One bag being written; use as a context manager. Methods may be called from any thread.

    Messages are flushed to the disk every SYNC_S (fsync), so that a power cut costs a second at most; every chunk has a
    checksum. ``metadata.yaml`` appears in one step when the bag is closed; a bag without it was cut short (``sagoma
    recover``), as is one whose disk was full or failed: writing raises InputError from then on.
    """

    def __init__(self, folder: str | Path) -> None:
        """InputError when ``folder`` exists already, or cannot be made."""
        self.folder = require_new(folder)
        self._channels: dict[str, int] = {}
        self._described: dict[str, Mapping[str, Any]] = {}  # topic by topic, for metadata.yaml
        self._schemas: dict[str, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self.counts: dict[str, int] = {}
        self.failure: InputError | None = None
        try:
            self.folder.mkdir(parents=True)
            self._file = (self.folder / f"{self.folder.name}.mcap").open("xb")
            self._mcap = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE)
            self._mcap.start(profile=Profile.ROS2)
            self._sync()
            sync_folder(self.folder)
            sync_folder(self.folder.parent)
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise describe_os_error(error, "no bag can be written", self.folder) from None
        self._syncing = threading.Thread(target=self._sync_regularly, name="bag", daemon=True)
        self._syncing.start()

    def add_topic(self, name: str, msgtype: str, qos: Qos = OFFERED) -> None:
        """Announce a topic with its type's definition, once."""
        if name not in self._channels:
            definition, _ = TYPES.generate_msgdef(msgtype, ros_version=2)
            self._add_channel(name, msgtype, definition, TYPES.hash_rihs01(msgtype), [qos])

    def add_topic_like(self, connection: Connection) -> None:
        """Announce a topic as another bag has it, once: with that bag's definition of its type, hash and QoS."""
        name = connection.topic
        offered = getattr(connection.ext, "offered_qos_profiles", ())
        if not (connection.msgdef.data and connection.digest):  # old sqlite3 bags have none
            self.add_topic(name, connection.msgtype, *offered[:1])
        elif name not in self._channels:
            self._add_channel(name, connection.msgtype, connection.msgdef.data, connection.digest, offered)

    def _add_channel(self, name: str, msgtype: str, definition: str, digest: str, offered: Sequence[Qos]) -> None:
        """Announce a topic as rosbag2 does: QoS and the hash of the type (REP-2011) are metadata of the channel."""
        qos: Any = dump_qos_v9(list(offered))
        idl = definition.startswith("=" * 80 + "\nIDL: ")
        with self._lock:
            if msgtype not in self._schemas:
                encoding = "ros2idl" if idl else "ros2msg"
                self._schemas[msgtype] = self._mcap.register_schema(msgtype, encoding, definition.encode())
            metadata = {"offered_qos_profiles": _yaml(qos), "topic_type_hash": digest}
            self._channels[name] = self._mcap.register_channel(
                name, MessageEncoding.CDR, self._schemas[msgtype], metadata
            )
            described = {"name": name, "type": msgtype, "serialization_format": "cdr"}
            self._described[name] = {**described, "offered_qos_profiles": qos, "type_description_hash": digest}
            self.counts[name] = 0

    def write(self, topic: str, log_ns: int, data: bytes) -> None:
        """Append one serialized message; a clock that steps back cannot put it before its predecessor."""
        with self._lock:
            if self.failure is not None:
                raise self.failure
            self._last_ns = max(self._last_ns, log_ns)
            if self._first_ns is None:
                self._first_ns = self._last_ns
            self.counts[topic] += 1
            with self._failing():
                self._mcap.add_message(self._channels[topic], self._last_ns, data, self._last_ns)

    def describe(self, provenance: Mapping[str, Any], rig: Path | None = None) -> None:
        """Write (or replace) ``sagoma.yaml`` and ``rig.yaml`` in the bag's folder, at the end. Raises InputError, but
        not for a disk that had no room for the bag either."""
        document = {"software": software_versions(), **provenance}
        if self.failure is not None:
            document["ended_early"] = str(self.failure)
        try:
            save_mapping(self.folder / SIDECAR_PROVENANCE, document)
            if rig is not None:
                copy_file(rig, self.folder / SIDECAR_RIG)
        except InputError:
            if self.failure is None:
                raise

    def close(self) -> None:
        """Finish the file, then write metadata.yaml; may be called twice. InputError when the disk fails only then."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._syncing.join()
        if not (failed := self.failure is not None):
            with self._failing():
                information = self._information()
                self._mcap.add_metadata("rosbag2", {"serialized_metadata": _yaml(information)})
                self._mcap.finish()
                self._sync()
                write_text(self.folder / METADATA, _yaml({"rosbag2_bagfile_information": information}) + "\n")
        with contextlib.suppress(OSError):
            self._file.close()
        if self.failure is not None and not failed:
            raise self.failure

    def _information(self) -> dict[str, Any]:
        """Return the bag's metadata.yaml, version 9 of rosbag2."""
        name, first_ns = f"{self.folder.name}.mcap", self._last_ns if self._first_ns is None else self._first_ns

        def contents() -> dict[str, Any]:
            return {
                "starting_time": {"nanoseconds_since_epoch": first_ns},
                "duration": {"nanoseconds": self._last_ns - first_ns},
                "message_count": sum(self.counts.values()),
            }

        return {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [name],
            **contents(),
            "topics_with_message_count": [
                {"topic_metadata": described, "message_count": self.counts[topic]}
                for topic, described in self._described.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": name, **contents()}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }

    def _sync(self) -> None:
        """Flush the file to the disk. Raises OSError."""
        self._file.flush()
        os.fsync(self._file.fileno())

    def _sync_regularly(self) -> None:
        while self.failure is None and not self._stop.wait(SYNC_S):
            with self._failing(), self._lock:
                self._mcap.flush()
                self._file.flush()
            with self._failing():
                os.fsync(self._file.fileno())

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        """Remember once why nothing more is written: the disk is full, or failed."""
        try:
            yield
        except (OSError, InputError) as error:
            with self._lock:
                span_ns = self._last_ns - (self._first_ns or self._last_ns)
                saved = f"{sum(self.counts.values())} messages, {span_ns / 1e9:.1f} s, but for a second at most"
                what = f"the recording has ended ({getattr(error, 'strerror', error)}); {saved}, are saved"
                remedy = f"Free space on that disk, then run `sagoma recover '{self.folder}'`."
                self.failure = self.failure or InputError(what, where=str(self.folder), remedy=remedy)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _yaml(document: Any) -> str:
    return yaml.safe_dump(document, sort_keys=False).strip()


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
        number = "unknown version"
    commit = _git(package, "rev-parse", "--short=12", "HEAD")
    if not commit:
        return number
    return f"{number} ({commit}{', modified' if _git(package, 'status', '--porcelain') else ''})"


def _git(folder: Path, *arguments: str) -> str:
    try:
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""  # no git, or no checkout


# recovery -------------------------------------------------------------------------------------------------------------


@dataclass
class Recovery:
    """What came of it: messages by topic; chunks left out because they are damaged; bytes behind the break, unread."""

    counts: dict[str, int] = field(default_factory=dict)
    damaged_chunks: int = 0
    unread_bytes: int = 0

    def __str__(self) -> str:
        """Return it in a sentence."""
        notes = [f"{self.damaged_chunks} damaged chunks (a second or less each) left out"] * (self.damaged_chunks > 0)
        notes += [f"{self.unread_bytes} bytes at the end cannot be read"] * (self.unread_bytes > 0)
        return "; ".join([f"{sum(self.counts.values())} messages recovered", *notes])


def recover_bag(bag: str | Path, target: str | Path) -> Recovery:
    """Copy every message that can still be read from ``bag`` into the new bag ``target``.

    The mcap file of a bag whose writer was killed, whose disk was full, or whose bytes were damaged has no index, or a
    wrong one: it is read record by record up to where it breaks off. A chunk that is cut, or whose checksum does not
    fit its bytes, is left out whole, as its damaged messages are unknown. Raises InputError for anything but an mcap
    bag.
    """
    files = sorted(Path(bag).glob("*.mcap"))
    if len(files) != 1:
        what = f"holds {len(files) or 'no'} .mcap files" if Path(bag).is_dir() else "there is no such folder"
        raise InputError(what, where=str(bag), remedy="Give the folder that holds one .mcap file.")
    recovery = Recovery()
    with BagWriter(target) as writer:
        topics = _add_topics(_records(files[0], Recovery()), writer)
        for record in _records(files[0], recovery):
            if isinstance(record, Message) and record.channel_id in topics:
                writer.write(topics[record.channel_id], record.log_time, record.data)
    recovery.counts = dict(writer.counts)
    for sidecar in (SIDECAR_RIG, SIDECAR_PROVENANCE):
        if (Path(bag) / sidecar).exists():
            copy_file(Path(bag) / sidecar, Path(target) / sidecar)
    return recovery


def _add_topics(records: Iterator[McapRecord], writer: BagWriter) -> dict[int, str]:
    """Announce the topics that the file describes anywhere; return them by channel."""
    types: dict[int, str] = {}
    topics: dict[int, str] = {}
    for record in records:
        if isinstance(record, Schema):
            types[record.id] = record.name
        elif isinstance(record, Channel) and record.schema_id in types:
            try:
                writer.add_topic(record.topic, types[record.schema_id])
            except (TypesysError, KeyError):
                continue  # of a damaged record; those behind it are read all the same
            topics[record.id] = record.topic
    return topics


def _records(path: Path, recovery: Recovery) -> Iterator[McapRecord]:
    """Yield the file's records, those inside chunks included, up to where it breaks off."""
    size, whole = path.stat().st_size, 0
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=size).records:
                whole = file.tell()
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    records = breakup_chunk(record, validate_crc=True)
                except Exception:  # zstd and lz4 have errors of their own, damaged numbers and texts raise others
                    recovery.damaged_chunks += 1
                else:
                    yield from records
        except Exception:  # cut, or damaged where a record is described
            recovery.unread_bytes = size - whole
