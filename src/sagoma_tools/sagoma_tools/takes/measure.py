"""Measures a take from its own messages: frame sets, losses, cameras and their backgrounds, persons and their doubt."""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from capture_rig.errors import InputError
from mocap_packets.fit import DOUBTFUL, LOST
from motion_export.motion import point_deviations, usual_rate
from sagoma_ros.packets import read_reference_points

from ..graph.topics import CAMERA_TOPIC, DIAGNOSTICS_TOPIC, FIRST_BODY_ID
from ..recording.reader import BagMessage, read_messages
from ..recording.writer import own_version
from .take import Background, CameraRecord, PersonRecord, Quality, Summary

FRAME_SETS, FITS, BODY = "/hull/frame_set", "/icp/fit", "/icp/body"
PERSON = re.compile(r"^/mocap/(?:bodies/(?P<body_id>[^/]+)/)?(?P<kind>reference_points|state)$")
CAMERA_NODE = re.compile(r"^/(?:.+/)?(?P<camera>[^/]+)/camera_client$")
DIGEST_BYTES = 1 << 20
ROUNDED = 4
"""Digits behind the point of shares and millimetres: figures are compared when they are measured again."""


def measure(bag: Path, progress: Callable[[int], None] = lambda messages: None) -> Summary:
    """Read a whole bag once. Raises InputError for one that cannot be read or has no frame set."""
    scan = _Scan()
    for number, message in enumerate(read_messages(bag, _is_wanted)):
        scan.update(message)
        progress(number)
    return Summary(
        scan.quality(str(bag)),
        {name: scan.camera(name) for name in sorted(scan.silhouettes)},
        scan.persons(),
        scan.body,
        digests(bag),
        own_version(),
    )


def digests(bag: Path) -> dict[str, dict[str, Any]]:
    """Return size and SHA-256 of each recorded file of a bag, by name."""
    found = {}
    for path in sorted([*bag.glob("*.mcap"), *bag.glob("*.db3")]):
        digest = hashlib.sha256()
        with path.open("rb") as file:
            while block := file.read(DIGEST_BYTES):
                digest.update(block)
        found[path.name] = {"bytes": path.stat().st_size, "sha256": digest.hexdigest()}
    return found


def _is_wanted(topic: str) -> bool:
    known = (FRAME_SETS, FITS, BODY, DIAGNOSTICS_TOPIC)
    return topic in known or PERSON.match(topic) is not None or CAMERA_TOPIC.match(topic) is not None


@dataclass
class _Person:
    sigmas_m: dict[int, np.ndarray] = field(default_factory=dict)
    states: dict[int, str] = field(default_factory=dict)


@dataclass
class _Scan:
    """Collects what the figures are made of, message by message."""

    set_stamps: list[int] = field(default_factory=list)
    incomplete: int = 0
    answered: set[int] = field(default_factory=set)
    silhouettes: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    reports: dict[str, list[Mapping[str, str]]] = field(default_factory=lambda: defaultdict(list))
    people: dict[str, _Person] = field(default_factory=lambda: defaultdict(_Person))
    body: str = ""

    def update(self, message: BagMessage) -> None:
        """Add what one message says."""
        topic = message.topic
        if camera := CAMERA_TOPIC.match(topic):
            self.silhouettes[camera["camera"]].append(message.stamp_ns)
        elif topic == FRAME_SETS:
            self.set_stamps.append(message.stamp_ns)
            self.incomplete += bool(_values(deserialize_message(message.data, DiagnosticArray).status[0])["missing"])
        elif topic == FITS:
            self.answered.add(message.stamp_ns)
        elif topic == BODY:
            self.body = deserialize_message(message.data, String).data
        elif topic == DIAGNOSTICS_TOPIC:
            self._add_diagnostics(deserialize_message(message.data, DiagnosticArray))
        elif person := PERSON.match(topic):
            self._add_person(self.people[person["body_id"] or FIRST_BODY_ID], person["kind"], message)

    def _add_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if node := CAMERA_NODE.match(status.name):
                self.reports[node["camera"]].append(_values(status))

    def _add_person(self, person: _Person, kind: str, message: BagMessage) -> None:
        if kind == "state":
            status = deserialize_message(message.data, DiagnosticStatus)
            stamp = _values(status).get("stamp_ns", "")
            if stamp.isdigit():
                person.states[int(stamp)] = status.message
            return
        points = read_reference_points(deserialize_message(message.data, PointCloud2), message.topic)
        person.sigmas_m[message.stamp_ns] = point_deviations(points.covariance)

    # figures ----------------------------------------------------------------------------------------------------------

    def stamps(self) -> list[int]:
        """The frame sets' stamps as recorded; of a bag without the hull server's, the first camera's, or persons'."""
        of_cameras = [stamps for _, stamps in sorted(self.silhouettes.items())]
        of_persons = [list(person.sigmas_m) for person in self.people.values()]
        return next((stamps for stamps in (self.set_stamps, *of_cameras, *of_persons) if stamps), [])

    def quality(self, where: str) -> Quality:
        """Raises InputError when there is no frame set."""
        stamps = np.array(self.stamps(), np.int64)
        if not len(stamps):
            remedy = "Record the graph while its cameras run."
            raise InputError("holds no frame set, silhouette or person", where=where, remedy=remedy)
        order = np.unique(stamps)
        unanswered = len(set(self.set_stamps) - self.answered) if self.answered else 0
        return Quality(
            int(order[0]),
            int(order[-1]),
            len(stamps),
            round(usual_rate(order), ROUNDED) if len(order) > 1 else 0.0,
            self.incomplete,
            unanswered,
            int((np.diff(stamps) < 0).sum()),
        )

    def camera(self, name: str) -> CameraRecord:
        """What is known of one camera; counters are those of the recording's span."""
        reports = self.reports.get(name, [])
        last = reports[-1] if reports else {}
        lost, expected = _increase(reports, ("lost", "incomplete")), _increase(reports, ("expected",))
        return CameraRecord(
            len(self.silhouettes[name]),
            last.get("camera_serial", ""),
            last.get("camera_model", ""),
            _backgrounds(reports),
            lost,
            expected,
        )

    def persons(self) -> dict[str, PersonRecord]:
        """Return the record of each person who was followed, by id."""
        stamps = np.unique(np.array(self.stamps(), np.int64))
        return {
            body_id: _person_record(person, stamps)
            for body_id, person in sorted(self.people.items())
            if person.sigmas_m
        }


def _person_record(person: _Person, set_stamps: np.ndarray) -> PersonRecord:
    rows = sorted(person.sigmas_m)
    states = [person.states.get(stamp, "") for stamp in rows]
    here = int(((set_stamps >= rows[0]) & (set_stamps <= rows[-1])).sum())
    sigmas_mm = 1e3 * np.stack(list(person.sigmas_m.values()))
    lost = states.count(LOST)
    middle, high = np.percentile(sigmas_mm, (50, 95))
    return PersonRecord(
        len(rows),
        _rounded(min(1.0, (len(rows) - lost) / max(here, 1))),
        _rounded(states.count(DOUBTFUL) / len(rows)),
        _rounded(lost / len(rows)),
        _rounded(middle),
        _rounded(high),
    )


def _backgrounds(reports: Sequence[Mapping[str, str]]) -> tuple[Background, ...]:
    """Return a camera's backgrounds, each as it was described last: what follows the light changes its figures."""
    found: dict[tuple[str, str], Background] = {}
    for report in reports:
        if report.get("background"):
            learned, serial = report.get("background_learned", ""), report.get("background_serial", "")
            found[learned, serial] = Background(report["background"], learned, serial)
    return tuple(found.values())


def _increase(reports: Sequence[Mapping[str, str]], keys: Sequence[str]) -> int | None:
    """Return by how much counters grew from the first report that has them to the last; one that began anew counts."""
    totals = [sum(int(report[key]) for key in keys) for report in reports if all(key in report for key in keys)]
    if not totals:
        return None
    steps = np.diff(totals)
    return int(np.where(steps >= 0, steps, totals[1:]).sum())


def _values(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def _rounded(value: Any) -> float:
    return round(float(value), ROUNDED)
