"""Writes rosbag2 bags (mcap) that ``ros2 bag`` and Foxglove read, with what made them beside the messages."""

from __future__ import annotations

import contextlib
import platform
import shutil
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Any
from xml.etree import ElementTree

import yaml
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer

from capture_rig.errors import InputError

from .bags import SIDECAR_PROVENANCE, SIDECAR_RIG
from .cdr import TYPES

INFINITE = QosTime(9223372036, 854775807)
# what every publisher of the graph offers (sagoma_ros.qos)
OFFERED = Qos(
    QosHistory.KEEP_LAST,
    20,
    QosReliability.RELIABLE,
    QosDurability.VOLATILE,
    INFINITE,
    INFINITE,
    QosLiveliness.AUTOMATIC,
    INFINITE,
    False,
)
OFFERED_LATCHED = OFFERED._replace(depth=1, durability=QosDurability.TRANSIENT_LOCAL)
GIT_TIMEOUT_S = 5.0
VERSIONED = ("rclpy", "numpy", "opencv-python-headless", "numba", "rosbags")


def require_new(folder: str | Path) -> Path:
    """The path, when nothing is there yet; InputError otherwise: a recording never replaces another."""
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
        """Announce a topic with its type's definition; a second time does nothing."""
        if name not in self._connections:
            self._connections[name] = self._writer.add_connection(
                name, msgtype, typestore=TYPES, offered_qos_profiles=(qos,)
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def software_versions() -> dict[str, str]:
    """Versions of ours (with the commit, in a checkout) and of what the results depend on, as far as installed."""
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
