"""Writes rosbag2 bags (mcap) that ``ros2 bag`` and Foxglove read, with their provenance."""

from __future__ import annotations

import contextlib
import platform
import shutil
import subprocess
import threading
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from capture_rig.errors import InputError
from capture_rig.files import copy_file, describe_os_error
from capture_rig.yaml_file import save_mapping

from .durable import RESERVE, DurableMcap, DurableWriter
from .reader import SIDECAR_PROVENANCE, SIDECAR_RIG, TYPES

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


SYNC_S = 0.5  # the disk has a message after at most twice as long, if it can write at all


class BagWriter:
    """One bag being written; use as a context manager. Methods may be called from any thread.

    Every SYNC_S what came is put on the disk (fsync), so that a power cut costs a second at most. ``metadata.yaml``
    appears in one step when the bag is closed; a bag without it was cut short (``sagoma recover``). When the disk is
    full or fails, writing raises InputError, then and ever after; closing finishes the bag with what was saved.
    """

    def __init__(self, folder: str | Path) -> None:
        """InputError when ``folder`` exists already, or cannot be made."""
        self.folder = require_new(folder)
        self._connections: dict[str, Connection] = {}
        self._last_ns = 0
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self.counts: dict[str, int] = {}
        self.failure: InputError | None = None
        try:
            self._writer = DurableWriter(self.folder)
            self._writer.open()
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise describe_os_error(error, "no bag can be written", self.folder) from None
        self._syncing = threading.Thread(target=self._sync_regularly, name="bag", daemon=True)
        self._syncing.start()

    def add_topic(self, name: str, msgtype: str, qos: Qos = OFFERED) -> None:
        """Announce a topic with its type's definition, once."""
        with self._lock:
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
        with self._lock:
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
        with self._lock:
            if self.failure is not None:
                raise self.failure
            self._last_ns = max(self._last_ns, log_ns)
            try:
                self._writer.write(self._connections[topic], self._last_ns, data)
            except OSError as error:
                raise self._failed(error) from None
            self.counts[topic] += 1

    def describe(self, provenance: Mapping[str, Any], rig: Path | None = None) -> None:
        """Write (or replace) ``sagoma.yaml`` and ``rig.yaml`` in the bag's folder, at the end. Raises InputError."""
        document = {"software": software_versions(), **provenance}
        if self.failure is not None:
            document["ended_early"] = str(self.failure)
        (self.folder / RESERVE).unlink(missing_ok=True)  # a full disk has room for this now
        save_mapping(self.folder / SIDECAR_PROVENANCE, document)
        if rig is not None:
            copy_file(rig, self.folder / SIDECAR_RIG)

    def close(self) -> None:
        """Finish the file, then write metadata.yaml; may be called twice. InputError when the disk fails even then."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._syncing.join()
        with self._lock:
            if self.failure is None:
                self._sync()
            try:
                self._writer.close()
            except OSError as error:
                self._writer.abort()
                what = f"the bag's end cannot be written ({error.strerror}); {self._saved()}"
                remedy = f"Free space on that disk, then run `sagoma recover '{self.folder}'`."
                raise InputError(what, where=str(self.folder), remedy=remedy) from None

    def _sync_regularly(self) -> None:
        while not self._stop.wait(SYNC_S):
            if self.failure is None:
                self._sync()

    def _sync(self) -> None:
        """Put on the disk what came until now; messages are taken meanwhile."""
        try:
            with self._lock:
                self._writer.mcap.close_pending_chunk()
            self._writer.sync()
        except OSError as error:
            self._failed(error)

    def _failed(self, error: OSError) -> InputError:
        """Remember and return why nothing more is written; the counts are then those of what is in the file."""
        with self._lock:
            if self.failure is None:
                saved = self._writer.mcap.channel_stats
                self.counts = {name: saved[connection.id] for name, connection in self._connections.items()}
                what = f"the recording has ended ({error.strerror}); {self._saved()}"
                remedy = "Free space on that disk, or choose another, and record anew."
                self.failure = InputError(what, where=str(self.folder), remedy=remedy)
            return self.failure

    def _saved(self) -> str:
        mcap = self._writer.storage
        span_ns = mcap.message_end_time - mcap.message_start_time if isinstance(mcap, DurableMcap) else 0
        return f"{sum(self.counts.values())} messages, {max(span_ns, 0) / 1e9:.1f} s, are saved"

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
