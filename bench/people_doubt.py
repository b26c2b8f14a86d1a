"""Whether doubt is right: wrong limbs that are called, clear ones that are not, and ellipsoids of doubtful limbs."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any

from report import Table

import numpy as np
from clips import Recorded
from people_sets import States, follower_of, states_of

from mocap_packets.fit import PART_NAMES, PART_POINTS
from sagoma_tools.evaluation.scores import INSIDE_95, PartCalls, nees_of, number, share
from sagoma_tools.evaluation.track import Track

SHOWN = (
    *("wrong_frames", "wrong_parts", "wrong_called", "wrong_inside"),
    *("clear_frames", "clear_called", "called_inside", "ms"),
)
PROBABILITIES = (0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7)


@dataclass(frozen=True, eq=False)
class Calls(PartCalls):
    """What is said of the parts of the body in the frames that have a truth and a track.

    inside : (F, 5) bool, all points of the part lie inside their own ellipsoids. log_odds : (F, 5), that the
    part is elsewhere or unseen.
    """

    inside: np.ndarray
    log_odds: np.ndarray

    def figures(self) -> dict[str, Any]:
        """Shares, None where there is nothing of the kind."""
        return {
            "frames": len(self.clear),
            "wrong_frames": number(share(self.wrong.any(axis=1))),
            "wrong_parts": int(self.wrong.sum()),
            "wrong_called": number(self.flagged_of_bad),
            "wrong_inside": number(share(self.inside[self.wrong])),
            "clear_frames": int(self.clear.sum()),
            "clear_called": number(self.false_alarms),
            "called_inside": number(share(self.inside[self.called])),
            "parts_inside": number(share(self.inside)),
        }

    @classmethod
    def of_states(cls, what: Recorded, states: States) -> Calls:
        """Compare what was published of the first person with the truth."""
        truth = what.truths[0]
        known = [row for row in states if np.isfinite(truth[row[0]]).all()]
        track = Track.of_states([(frame, state) for frame, state, _ in known])
        errors = track.points_world - truth[track.frames]
        inside = nees_of(errors, track.covariance) <= INSIDE_95
        of_parts = np.stack([inside[:, list(points)].all(axis=1) for points in PART_POINTS], axis=1)
        log_odds = np.array([odds for *_, odds in known]).reshape(-1, len(PART_NAMES))
        said = PartCalls.of(1e3 * np.linalg.norm(errors, axis=2), track.parts)
        return cls(said.wrong, said.called, said.clear, of_parts, log_odds)

    @classmethod
    def together(cls, several: Sequence[Calls]) -> Calls:
        """The frames of several sets as one."""
        return cls(*(np.concatenate([getattr(one, field.name) for one in several]) for field in fields(cls)))


def curve(calls: Calls) -> list[dict[str, float | None]]:
    """What these probabilities alone would call."""
    return [
        {
            "probability": p,
            "wrong_called": number(share((calls.log_odds > np.log(p / (1.0 - p)))[calls.wrong])),
            "clear_called": number(share((calls.log_odds > np.log(p / (1.0 - p)))[calls.clear].any(axis=1))),
        }
        for p in PROBABILITIES
    ]


def doubt(sets: Iterable[Recorded], settings: dict[str, Any]) -> dict[str, Any]:
    """Track the sets with one person in them. A part of the body (trunk, arms, legs) is wrong in a frame with one of
    its points more than 200 mm off; a frame is clear with all points under 100 mm. A part is called when its published
    state is doubtful or lost.

    Columns: frames with a part over 200 mm, %; parts wrong, of them called, %; of them with all points inside their own
    95 % ellipsoids, %; clear frames, and those with any part called, %; parts called with all points inside, %;
    processor time of fit and filter, ms a set. The second table is the curve behind the choice of
    limb_filter.UNFOUND_LOG_PRIOR: what would be called if the probability of another place of a limb, or of none, alone
    decided, at that probability.
    """
    table = Table(
        "set:<40 | > 200:>7.1% | wrong:>6d | called:>7.0% | inside:>7.0% | clear:>6d | also called:>12.2%"
        " | called inside:>14.0% | ms:>5.2f"
    )
    every, found = list[Calls](), dict[str, dict[str, Any]]()
    for what in sets:
        if len(what.truths) != 1:
            continue
        follower, began = follower_of(what, settings), time.process_time()
        states = states_of(what, follower)
        ms = 1e3 * (time.process_time() - began) / max(len(what.products), 1)
        every.append(Calls.of_states(what, states))
        found[what.name] = {**every[-1].figures(), "ms": round(ms, 2)}
        table.row(what.name, *[found[what.name][key] for key in SHOWN])
    if not every:
        return {}
    whole = Calls.together(every)
    figures = {**whole.figures(), "ms": round(float(np.mean([one["ms"] for one in found.values()])), 2)}
    table.row("all", *[figures[key] for key in SHOWN])
    points, shown = curve(whole), Table("probability:>12.2f | wrong called:>12.0% | clear called:>12.2%")
    for point in points:
        shown.row(*point.values())
    return {"all": figures, "curve": points, "sets": found}
