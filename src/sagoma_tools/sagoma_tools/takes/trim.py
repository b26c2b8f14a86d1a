"""Cuts a part out of a take into a new one: whole frame sets by their stamps, everything else by when it was logged."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import deserialize_message

from capture_rig.errors import InputError

from ..graph.topics import DIAGNOSTICS_TOPIC, OUTPUT_TOPICS, type_of
from ..recording.reader import SIDECAR_RIG, BagMessage, open_bag, read_messages, read_provenance
from ..recording.recorded_motion import STATE, kind_of
from ..recording.recorder import has_header
from ..recording.writer import BagWriter, own_version
from .folder import TakesFolder, move_new, remove_folder
from .measure import finish_take, measure, values_of
from .take import Summary, Take, TakeState

OF_A_CAMERA = re.compile(r"^/[^/]+/(silhouette/compressed|camera_info|preview/compressed|image_raw)$")
LATCHED = {topic.name for topic in OUTPUT_TOPICS if topic.latched} | {"/tf_static", "/robot_description"}


def trim(
    takes: TakesFolder,
    name: str,
    new_name: str,
    from_s: float = 0.0,
    to_s: float | None = None,
    progress: Callable[[int], None] = lambda messages: None,
) -> Path:
    """Write the part of a take from one second to another (from its first frame set's stamp) as a new take.

    It is written beside, and gets its name when it is whole. Raises InputError for a part that holds no frame set, and
    for a name that is taken.
    """
    take = takes.find(name)
    if take.state is not TakeState.WHOLE:
        raise InputError(f"'{name}' cannot be trimmed: {take.problem}", where=str(take.path))
    target = takes.new_path(new_name)
    begins_ns, ends_ns = _part(take.summary or measure(take.path), from_s, to_s, str(take.path))
    workshop = Path(tempfile.mkdtemp(prefix=".trim-", dir=takes.path))
    beside = workshop / target.name
    try:
        with BagWriter(beside) as writer:
            _copy(take.path, writer, begins_ns, ends_ns, progress)
            rig = take.path / SIDECAR_RIG
            writer.describe(_provenance(take, from_s, to_s), rig if rig.is_file() else None)
        finish_take(beside)
        move_new(beside, target)
    finally:
        remove_folder(workshop)
    return target


def _part(summary: Summary, from_s: float, to_s: float | None, where: str) -> tuple[int, int]:
    """The stamps between which frame sets are kept."""
    quality = summary.quality
    end_s = quality.seconds if to_s is None else to_s
    if not 0.0 <= from_s < end_s or from_s > quality.seconds:
        remedy = f"Give seconds between 0 and {quality.seconds:.2f}, the first below the second."
        raise InputError(f"there is no part from {from_s:g} s to {end_s:g} s", where=where, remedy=remedy)
    return quality.begins_ns + round(from_s * 1e9), quality.begins_ns + round(end_s * 1e9)


def _copy(bag: Path, writer: BagWriter, begins_ns: int, ends_ns: int, progress: Callable[[int], None]) -> None:
    """Copy the messages' bytes. A latched topic begins with the last message from before the cut."""

    def kept(stamp_ns: int | None) -> bool:
        return stamp_ns is not None and begins_ns <= stamp_ns <= ends_ns

    logged = [message.log_ns for message in read_messages(bag, _has_stamp) if kept(_stamp_ns(message))]
    if not logged:
        raise InputError("the part holds no frame set", where=str(bag), remedy="Give a longer part.")
    first_ns, last_ns = min(logged), max(logged)
    with open_bag(bag) as reader:
        for connection in reader.connections:
            writer.add_topic_like(connection, connection.topic)
    before = {m.topic: m for m in read_messages(bag, LATCHED.__contains__) if m.log_ns < first_ns}
    for message in before.values():
        writer.write(message.topic, first_ns, message.data)
    for number, message in enumerate(read_messages(bag)):
        progress(number)
        stamp = _stamp_ns(message)
        if kept(stamp) if stamp is not None else first_ns <= message.log_ns <= last_ns:
            writer.write(message.topic, message.log_ns, message.data)


@cache  # of a few topics, asked of every message
def _has_stamp(topic: str) -> bool:
    """Return whether a topic's messages name the frame set that they belong to: the graph's, but what is kept for later
    subscribers, and diagnostics."""
    if kind_of(topic) == STATE or OF_A_CAMERA.match(topic):
        return True
    kind = type_of(topic)
    return kind is not None and topic not in LATCHED and topic != DIAGNOSTICS_TOPIC and has_header(kind)


def _stamp_ns(message: BagMessage) -> int | None:
    """The stamp of the frame set that a message belongs to, None where it names none."""
    if kind_of(message.topic) == STATE:
        stamp = values_of(deserialize_message(message.data, DiagnosticStatus)).get("stamp_ns", "")
        return int(stamp) if stamp.isdigit() else None
    return message.stamp_ns if _has_stamp(message.topic) else None


def _provenance(take: Take, from_s: float, to_s: float | None) -> dict[str, Any]:
    """Return the take's own provenance, and what the part is of."""
    provenance = dict(read_provenance(take.path))
    origin: dict[str, Any] = {"take": take.name, "from_s": from_s, "to_s": to_s, "by": own_version()}
    if take.summary is not None:
        origin["files"] = {name: dict(file) for name, file in take.summary.files.items()}
    if take.trimmed_from is not None:
        origin["trimmed_from"] = dict(take.trimmed_from)
    return {"software": {}, **provenance, "trimmed_from": origin}
