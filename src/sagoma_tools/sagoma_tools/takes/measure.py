"""Measures a take from its own messages: frame sets, losses, cameras and their backgrounds, persons and their doubt."""

from __future__ import annotations

import hashlib
import logging
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String

from capture_rig.errors import InputError
from capture_rig.files import write_text
from capture_rig.rig import load_rig
from capture_rig.yaml_file import read_mapping
from mocap_packets.fit import DOUBTFUL, LOST
from motion_export.motion import point_deviations, usual_rate
from sagoma_ros.messages import values_of

from ..graph.topics import CAMERA_TOPIC, DIAGNOSTICS_TOPIC, FIRST_BODY_ID, cameras_in
from ..recording.reader import SIDECAR_RIG, BagMessage, open_bag, read_messages, rig_in
from ..recording.recorded_motion import POINTS, ROW_TOPIC, STATE, PersonRows, kind_of
from ..recording.writer import own_version
from .take import REMEDY, Background, CameraRecord, PersonRecord, Quality, Summary, Take, TakeState

FRAME_SETS, FITS, BODY = "/hull/frame_set", "/icp/fit", "/icp/body"
CAMERA_NODE = re.compile(r"^/(?:.+/)?(?P<camera>[^/]+)/camera_client$")
ROUNDED = 4
"""Digits behind the point of shares and millimetres: figures are compared when they are measured again."""


def measure(bag: Path, progress: Callable[[int], None] = lambda messages: None) -> Summary:
    """Read a whole bag once. Raises InputError for one that cannot be read or has no frame set."""
    scan = _Scan()
    for number, message in enumerate(read_messages(bag, _is_wanted)):
        scan.update(message)
        progress(number)
    cameras = {name: scan.camera(name) for name in sorted(scan.silhouettes)}
    return Summary(scan.quality(str(bag)), cameras, scan.persons(), scan.body, digests(bag), own_version())


def digests(bag: Path) -> dict[str, dict[str, Any]]:
    """Return size and SHA-256 of each recorded file of a bag, by name."""
    found = {}
    for path in sorted([*bag.glob("*.mcap"), *bag.glob("*.db3")]):
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        found[path.name] = {"bytes": path.stat().st_size, "sha256": digest}
    return found


def _is_wanted(topic: str) -> bool:
    known = (FRAME_SETS, FITS, BODY, DIAGNOSTICS_TOPIC)
    return topic in known or kind_of(topic) in (POINTS, STATE) or CAMERA_TOPIC.match(topic) is not None


@dataclass
class _Scan:
    """Collects the data of the figures, message by message."""

    set_stamps: list[int] = field(default_factory=list)
    incomplete: int = 0
    answered: set[int] = field(default_factory=set)
    silhouettes: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    reports: dict[str, list[Mapping[str, str]]] = field(default_factory=lambda: defaultdict(list))
    people: dict[str, PersonRows] = field(default_factory=lambda: defaultdict(PersonRows))
    body: str = ""

    def update(self, message: BagMessage) -> None:
        """Add one message."""
        topic = message.topic
        if camera := CAMERA_TOPIC.match(topic):
            self.silhouettes[camera["camera"]].append(message.stamp_ns)
        elif topic == FRAME_SETS:
            self.set_stamps.append(message.stamp_ns)
            self.incomplete += bool(values_of(message.decode(DiagnosticArray).status[0])["missing"])
        elif topic == FITS:
            self.answered.add(message.stamp_ns)
        elif topic == BODY:
            self.body = message.decode(String).data
        elif topic == DIAGNOSTICS_TOPIC:
            self._add_reports(message.decode(DiagnosticArray))
        elif person := ROW_TOPIC.match(topic):
            self.people[person["body_id"] or FIRST_BODY_ID].update(person["kind"], message)

    def _add_reports(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if node := CAMERA_NODE.match(status.name):
                self.reports[node["camera"]].append(values_of(status))

    # figures ----------------------------------------------------------------------------------------------------------

    def stamps(self) -> list[int]:
        """The frame sets' stamps as recorded; of a bag without the hull server's, the first camera's, or persons'."""
        of_cameras = [stamps for _, stamps in sorted(self.silhouettes.items())]
        of_persons = [list(person.points) for person in self.people.values()]
        return next((stamps for stamps in (self.set_stamps, *of_cameras, *of_persons) if stamps), [])

    def quality(self, where: str) -> Quality:
        """Raises InputError when there is no frame set."""
        stamps = np.array(self.stamps(), np.int64)
        if not len(stamps):
            remedy = "Record the graph while its cameras run."
            raise InputError("holds no frame set, silhouette or person", where=where, remedy=remedy)
        order = np.unique(stamps)
        begins_ns, ends_ns, stamps_back = int(order[0]), int(order[-1]), int((np.diff(stamps) < 0).sum())
        rate_hz = round(usual_rate(order), ROUNDED) if len(order) > 1 else 0.0
        unanswered = len(set(self.set_stamps) - self.answered) if self.answered else 0
        return Quality(begins_ns, ends_ns, len(stamps), rate_hz, self.incomplete, unanswered, stamps_back)

    def camera(self, name: str) -> CameraRecord:
        """What is known of one camera; counters are those of the recording's span."""
        reports = self.reports.get(name, [])
        last = reports[-1] if reports else {}
        lost, expected = _increase(reports, ("lost", "incomplete")), _increase(reports, ("expected",))
        serial, model = last.get("camera_serial", ""), last.get("camera_model", "")
        return CameraRecord(len(self.silhouettes[name]), serial, model, _backgrounds(reports), lost, expected)

    def persons(self) -> dict[str, PersonRecord]:
        """Return the record of each tracked person, by id."""
        stamps = np.unique(np.array(self.stamps(), np.int64))
        return {name: _person_record(person, stamps) for name, person in sorted(self.people.items()) if person.points}


def _person_record(person: PersonRows, set_stamps: np.ndarray) -> PersonRecord:
    rows = sorted(person.points)
    states = [person.states[stamp][0] for stamp in rows if stamp in person.states]
    here = int(((set_stamps >= rows[0]) & (set_stamps <= rows[-1])).sum())
    sigmas_mm = 1e3 * np.stack([point_deviations(points.covariance) for points in person.points.values()])
    lost = states.count(LOST)
    coverage, doubtful = min(1.0, (len(rows) - lost) / max(here, 1)), states.count(DOUBTFUL) / len(rows)
    figures = coverage, doubtful, lost / len(rows), *np.percentile(sigmas_mm, (50, 95))
    return PersonRecord(len(rows), *map(_rounded, figures))


def _backgrounds(reports: Sequence[Mapping[str, str]]) -> tuple[Background, ...]:
    """Return a camera's backgrounds, each with its last description: adaptation to light changes the figures."""
    found: dict[tuple[str, str], Background] = {}
    for report in reports:
        if report.get("background"):
            learned, serial = report.get("background_learned", ""), report.get("background_serial", "")
            found[learned, serial] = Background(report["background"], learned, serial)
    return tuple(found.values())


def _increase(reports: Sequence[Mapping[str, str]], keys: Sequence[str]) -> int | None:
    """Return the growth of counters from their first report to the last, across resets."""
    totals = [sum(int(report[key]) for key in keys) for report in reports if all(key in report for key in keys)]
    if not totals:
        return None
    steps = np.diff(totals)
    return int(np.where(steps >= 0, steps, totals[1:]).sum())


def _rounded(value: Any) -> float:
    return round(float(value), ROUNDED)


# the summary beside a bag, take.yaml ----------------------------------------------------------------------------------


SIDECAR_TAKE = "take.yaml"
_log = logging.getLogger("sagoma.takes")


def finish_take(bag: Path, progress: Callable[[int], None] = lambda messages: None) -> Summary | None:
    """Measure a bag that was just closed, and write (or replace) its take.yaml, whole; None where that fails.

    The recording is whole without it: a summary that cannot be made is made later, by `sagoma takes measure`.
    """
    try:
        summary = measure(bag, progress)
        write_text(bag / SIDECAR_TAKE, yaml.safe_dump(summary.document(), sort_keys=False, allow_unicode=True))
    except Exception as error:  # a full disk, a foreign message: the bag itself is closed, and must be reported so
        _log.warning("%s is recorded, but its figures cannot be measured: %s", bag, error)
        return None
    return summary


def read_summary(bag: Path) -> Summary | None:
    """Return the summary beside a bag, None where there is none. Raises InputError for one that cannot be read."""
    path = bag / SIDECAR_TAKE
    return Summary.parse(read_mapping(path, REMEDY), str(path)) if path.is_file() else None


# checks ---------------------------------------------------------------------------------------------------------------


OK, WARNING, ERROR = "ok", "warning", "error"


@dataclass(frozen=True)
class Check:
    """What one check found: ok, warning or error, and a sentence."""

    grade: str
    text: str


def verify(take: Take, progress: Callable[[int], None] = lambda messages: None) -> list[Check]:
    """Return the findings of every check; an unreadable take has one error."""
    if take.state is not TakeState.WHOLE:
        return [Check(ERROR, take.problem)]
    try:
        return [*_messages(take.path, progress), *_rig(take), *_summary(take)]
    except InputError as error:
        return [Check(ERROR, str(error))]
    except Exception as error:  # a broken file may break its reader in any way
        return [Check(ERROR, f"{take.path} cannot be read to its end ({type(error).__name__}: {error})")]


def _messages(bag: Path, progress: Callable[[int], None]) -> Iterator[Check]:
    with open_bag(bag) as reader:
        promised = Counter({connection.topic: connection.msgcount for connection in reader.connections})
        found: Counter[str] = Counter()
        for number, (connection, _, _) in enumerate(reader.messages()):
            found[connection.topic] += 1
            progress(number)
    missing = {topic: count - found[topic] for topic, count in promised.items() if count != found[topic]}
    for topic, count in missing.items():
        yield Check(ERROR, f"{topic}: {count} of the messages that the index promises are missing")
    if not missing:
        yield Check(OK, f"all {found.total()} messages on {len(promised)} topics can be read")


def _rig(take: Take) -> Iterator[Check]:
    if (rig_file := rig_in(take.path)) is None:
        yield Check(WARNING, f"has no {SIDECAR_RIG}: where its cameras stood is not known (record with --rig)")
        return
    unknown = set(cameras_in(take.topics)) - set(load_rig(rig_file).names)
    if unknown:
        yield Check(ERROR, f"{SIDECAR_RIG} does not know {', '.join(sorted(unknown))}")
    else:
        yield Check(OK, f"{SIDECAR_RIG} knows every camera")


def _summary(take: Take) -> Iterator[Check]:
    if take.summary is None:
        yield Check(WARNING, "has no figures: its recorder was killed (`sagoma takes measure` writes them)")
        return
    stored, now = take.summary.files, digests(take.path)
    changed = sorted(name for name in {*stored, *now} if stored.get(name) != now.get(name))
    for name in changed:
        yield Check(ERROR, f"{name} is not what was recorded: its SHA-256 or its size differs")
    if not changed:
        yield Check(OK, f"{', '.join(now)} as recorded (SHA-256)")
