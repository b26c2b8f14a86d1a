"""Who is who after persons could not be told apart: their sizes decide, if they differ enough.

Two persons who part after a hug go on where motion says that each of them is. For a while both bodies are then fitted
to both places. The assignment that leaves fewer contour rays unexplained is right, once the difference is clear;
people of one size stay undecided, and keep the numbers that their motion gave them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import combinations

import numpy as np

from ..acquisition.body_sizes import BodyEstimate
from ..tracker import NS_PER_S, IcpTracker

TOGETHER_S = 0.2  # persons who shared a part of the hull for so long may have been taken for each other
APART_S = 0.3  # so long after it their sizes are compared: by then neither hides much of the other
EVERY_SETS = 3  # neighbouring sets err alike
LEAST_LOOKS, MOST_LOOKS = 6, 20
CLEAR_RAYS = 4.0  # mean over the looks, of two persons' some 1000 rays: twice what chance leaves of persons alike
SIZES_ERR_M = 0.01  # of two measurements of one person beyond what their covariances say: clothes, posture
ALIKE = 25.0  # squared Mahalanobis distance of ten sizes that one person's stay below in 99.5 % of the cases


class Verdict(StrEnum):
    """What the sizes say of two persons."""

    OPEN = "open"
    RIGHT = "right"
    EXCHANGED = "exchanged"
    ALIKE = "alike"


@dataclass
class IdentityCheck:
    """Two persons, the second of whom may be away, while it is found out whether they are taken for each other."""

    first: int
    second: int
    _sets: int = 0
    _margins: list[float] = field(default_factory=list)

    def concerns(self, person: int) -> bool:
        """Whether it is about this person."""
        return person in (self.first, self.second)

    def look(self, first: IcpTracker, second: IcpTracker, second_is_away: bool) -> Verdict:
        """Compare the two assignments in the set that both trackers have fitted last."""
        self._sets += 1
        if self._sets % EVERY_SETS or not first.has_outline or not (second_is_away or second.has_outline):
            return Verdict.OPEN
        margin = _margin(first, second)
        if not second_is_away:
            margin += _margin(second, first)
        self._margins.append(margin)
        return self._verdict()

    def _verdict(self) -> Verdict:
        if len(self._margins) < LEAST_LOOKS:
            return Verdict.OPEN
        mean = float(np.mean(self._margins))
        if abs(mean) >= CLEAR_RAYS:
            return Verdict.RIGHT if mean > 0.0 else Verdict.EXCHANGED
        return Verdict.OPEN if len(self._margins) < MOST_LOOKS else Verdict.ALIKE


class OcclusionEvents:
    """Which persons share, or shared a moment ago, a part of the hull."""

    def __init__(self) -> None:
        self._events: dict[tuple[int, int], tuple[int, int]] = {}  # from when until when, of each pair

    def update(self, stamp_ns: int, shared: Iterable[Sequence[int]]) -> list[IdentityCheck]:
        """Take note of the persons who share each part; return whom to compare now, some time after they parted."""
        for persons in shared:
            for pair in combinations(persons, 2):
                began_ns, _ = self._events.get(pair, (stamp_ns, stamp_ns))
                self._events[pair] = began_ns, stamp_ns
        checks = []
        for pair, (began_ns, until_ns) in sorted(self._events.items()):
            if stamp_ns - until_ns >= APART_S * NS_PER_S:
                del self._events[pair]
                if until_ns - began_ns >= TOGETHER_S * NS_PER_S:
                    checks.append(IdentityCheck(*pair))
        return checks


def sizes_apart(first: BodyEstimate, second: BodyEstimate) -> float:
    """Return the squared Mahalanobis distance of two measurements of sizes."""
    difference = first.sizes - second.sizes
    covariance = first.covariance + second.covariance + SIZES_ERR_M**2 * np.eye(len(difference))
    return float(difference @ np.linalg.solve(covariance, difference))


def _margin(there: IcpTracker, other: IcpTracker) -> float:
    """Rays by which the body that is followed ``there`` explains that place better than the other one does."""
    assert there.body is not None and other.body is not None and there.pose is not None
    return there.cost_of(other.body, there.pose) - there.cost_of(there.body, there.pose)
