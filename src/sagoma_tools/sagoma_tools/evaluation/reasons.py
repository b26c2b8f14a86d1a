"""Why nobody is tracked: what the tracker said of each frame set, the most frequent reasons first."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
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
VARYING = re.compile(r": step .*|(?<![\w.])[+-]?\d+(?:\.\d+)?")
"""What may differ between two sets of which the same is said: which way to step, and numbers but a camera's name's."""
NEXT = re.compile(rf"; (?=(?:body \d+|{'|'.join(PART_NAMES)}): )")
"""Between what is said of one body, or of one part of the body, and of the next."""
OF_A_BODY = re.compile(r"^body \d+: ")
REMEDY = (
    "What to do about each: docs/tracking.md, 'Why it refuses'; what is wrong with the rig, sagoma doctor --rig says."
)


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


def rank_reasons(sets: Sequence[Sequence[str]]) -> list[tuple[str, int]]:
    """Return each reason, with the numbers of the middle one of its sets, and in how many it was given; the most
    frequent first."""
    texts: dict[str, list[str]] = defaultdict(list)
    for reasons in sets:
        clauses = [OF_A_BODY.sub("", clause) for reason in reasons for clause in NEXT.split(reason)]
        for kind, clause in {VARYING.sub("#", clause): clause for clause in clauses}.items():
            texts[kind].append(clause)
    return [(same[len(same) // 2], len(same)) for same in sorted(texts.values(), key=len, reverse=True)]


def explain(sets: Sequence[Sequence[str]]) -> str:
    """Return the most frequent reasons as one clause."""
    said = ", ".join(f'"{text}" in {count}' for text, count in rank_reasons(sets)[:SHOWN])
    return f"of {len(sets)} frame sets the tracker said {said or 'nothing'}"


def nobody_tracked(what: str, where: str, sets: Sequence[Sequence[str]]) -> InputError:
    """Return the error of a session or bag in which nobody was tracked."""
    return InputError(f"{what}: {explain(sets)}", where=where, remedy=REMEDY)
