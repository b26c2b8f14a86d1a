"""Why nobody is tracked: what the tracker said of each frame set, the most frequent reasons, and one remedy."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray

from capture_rig.errors import InputError
from mocap_packets.fit import PART_NAMES
from mocap_packets.state import Tracking
from sagoma_ros.messages import values_of

from ..recording.reader import read_messages

if TYPE_CHECKING:  # bags are read without it
    from mocap_pipeline.pipeline import Step

FIT_TOPIC, STATE = "/icp/fit", "state"
SHOWN = 3
NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?")
"""Not the one in a camera's name."""
VARYING = re.compile(rf": step .*|{NUMBER.pattern}")
"""What may differ between two sets of which the same is said: numbers, and which way to step."""
NEXT = re.compile(rf"; (?=(?:body \d+|{'|'.join(PART_NAMES)}): )")
"""Between what is said of one body, or of one part of the body, and of the next."""
OF_A_BODY = re.compile(r"^body \d+: ")

WAIT = (
    "Let the person be seen for longer: from a T-pose the start takes five frame sets, from any other posture "
    "icp_tracker.initial_pose.motion.watch_s."
)
ELSE = "See what the tracker asks for before it begins: docs/tracking.md."
DOCTOR = "sagoma doctor --session SESSION says what is wrong with footage and rig."
REMEDIES = (
    (("watched for", "hold it ("), WAIT),
    (
        ("not see ", "outside the volume", "in the volume is seen", "volume is too small", "beyond what the cameras"),
        "Film where all cameras see the whole person, hands and feet included, inside the volume of rig.yaml; or aim "
        "the cameras so, and calibrate again.",
    ),
    (
        ("no hull", "nobody in the volume", "no outlines", "centerline points"),
        f"See that somebody is in the volume of rig.yaml, and that the backgrounds are of this room; {DOCTOR}",
    ),
    (
        ("no adult's height",),
        "See that rig.yaml is in metres with its floor at z = 0, that an adult stands in the volume, and that nothing "
        "hides a part of them from several cameras.",
    ),
    (("alike",), "Walk a step at the beginning, or begin in a T-pose with the feet in view."),
    (
        ("nobody upright", "first pose explains"),
        f"Begin with somebody who stands or walks upright, away from furniture; if that is so, {DOCTOR}",
    ),
    (
        ("explain", "rays", "other poses", "perhaps back"),
        "See how the skeleton lies in the silhouettes (sagoma view): these, or the calibration, are off.",
    ),
    (
        ("no T-pose", "stand still"),
        "Begin in a T-pose and hold it for five frame sets; any posture does with initial_pose.source=auto.",
    ),
)
"""Words of a reason, and what helps; the first that fits. docs/tracking.md has every reason."""


@dataclass(frozen=True)
class Reason:
    """Something that the tracker said of so many frame sets; ``text`` with the numbers of a typical one."""

    text: str
    sets: int


def reasons_of_step(step: Step) -> tuple[str, ...]:
    """Return why the fits of one set are not quite believed, or there is none."""
    return tuple(person.fit.reason for person in step.people if person.fit.state != Tracking.TRACKING)


def reasons_of_bag(bag: str | Path, wanted: Callable[[int], bool] = lambda stamp_ns: True) -> list[tuple[str, ...]]:
    """Return the same of each frame set of a wanted stamp in a bag; none of a bag without fits."""
    found = []
    for message in read_messages(bag, FIT_TOPIC.__eq__):
        if wanted(message.stamp_ns):
            statuses = message.decode(DiagnosticArray).status
            troubled = [s for s in statuses if values_of(s).get(STATE) != Tracking.TRACKING]
            found.append(tuple(status.message for status in troubled))
    return found


def rank_reasons(sets: Sequence[Sequence[str]]) -> list[Reason]:
    """Count in how many sets each reason was given, whatever its numbers; the most frequent first."""
    texts: dict[str, list[str]] = defaultdict(list)
    for reasons in sets:
        clauses = {OF_A_BODY.sub("", clause) for reason in reasons for clause in NEXT.split(reason)}
        for kind, clause in sorted({VARYING.sub("#", clause): clause for clause in sorted(clauses)}.items()):
            texts[kind].append(clause)
    ranked = sorted(texts.values(), key=len, reverse=True)
    numbers = {text: [float(number) for number in NUMBER.findall(text)] for same in ranked for text in same}
    return [Reason(sorted(same, key=numbers.__getitem__)[len(same) // 2], len(same)) for same in ranked]


def explain(sets: Sequence[Sequence[str]]) -> tuple[str, str]:
    """Return the most frequent reasons as one clause, and the remedy for the first of all that has one."""
    ranked = rank_reasons(sets)
    said = ", ".join(f'"{reason.text}" in {reason.sets}' for reason in ranked[:SHOWN])
    remedies = [remedy_of(reason.text) for reason in ranked]
    remedy = next((remedy for remedy in remedies if remedy not in (WAIT, ELSE)), WAIT if WAIT in remedies else ELSE)
    return f"of {len(sets)} frame sets the tracker said {said or 'nothing'}", remedy


def remedy_of(reason: str) -> str:
    """Return what helps against one reason."""
    return next((remedy for words, remedy in REMEDIES if any(word in reason for word in words)), ELSE)


def nobody_tracked(what: str, where: str, sets: Sequence[Sequence[str]]) -> InputError:
    """Return the error of a session or bag in which nobody was tracked."""
    said, remedy = explain(sets)
    return InputError(f"{what}: {said}", where=where, remedy=remedy)
