"""Step 5: detections that contradict the others, and which of them to leave out.

A wrong order of corners, a target that moved between the exposures, corners found on something else: where three or
more cameras saw the target, the one without which the others agree is left out; where two did, both are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_rig.lens import Array

from ..boards.board import TargetDetection
from .adjustment import RAYLEIGH_MEDIAN, ROUGHLY, Adjusted, FreeUnknowns, adjust, normalised_lengths
from .state import Bools, Ints, Layout, Observations

WORST_FIRST = 0.3  # of the worst: what is left out in one round
SINGLE = "its corners do not fit the target's shape (found on something else, or the target is bent)"
ODD_ONE = "contradicts the other cameras in that frame (wrong corners, or moved between the exposures)"
PAIR = "the two cameras contradict each other in that frame (wrong corners, or moved between the exposures)"
ALL = "the cameras contradict one another in that frame (the target moved between the exposures)"


@dataclass(frozen=True)
class Limits:
    """From when on corners are wrong, not imprecise: ``detection``: of the median corner, in standard deviations, and
    ``detection_px``; ``corner``: of a single corner among good ones, and ``corner_px``. ``rounds``: at most."""

    detection: float
    detection_px: float
    corner: float
    corner_px: float
    rounds: int


# Thresholds: RIG_LIMITS chosen with calibration_bundle.py among the benches of commit d6079d2; LENS_LIMITS measured
# by python bench/calibration.py; else judgement.
RIG_LIMITS = Limits(5.0, 0.5, 8.0, 0.0, 12)
"""Lenses that are not quite right and delays may do so much (bench/calibration_bundle.py of commit d6079d2)."""
LENS_LIMITS = Limits(3.5, 0.3, 5.0, 0.3, 2)
"""More rounds would peel off, layer by layer, what a lens model that is too simple cannot explain."""


@dataclass(frozen=True, eq=False)
class RejectedDetection:
    """A detection that took no part, or the ``corners`` (ids) of it that took none, and why."""

    detection: TargetDetection
    reason: str
    corners: tuple[int, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether the whole detection was left out."""
        return not self.corners


def misfits(fit: Adjusted, seen: Observations) -> Array:
    """Compute (s,) the median residual of each detection over what is to be expected: about 1 when all is well."""
    lengths = normalised_lengths(fit.state, seen) / fit.scale
    return np.nanmedian(np.where(seen.weight > 0, lengths, np.nan), axis=1) / RAYLEIGH_MEDIAN


def bad_corners(fit: Adjusted, seen: Observations, limits: Limits) -> Bools:
    """Mark (s, n) corners far off, by the noise of their own detection, in detections that are good otherwise."""
    lengths, misfit = normalised_lengths(fit.state, seen), misfits(fit, seen)[:, None]
    off = (lengths > limits.corner * fit.scale * np.maximum(misfit, 1.0)) & (lengths > limits.corner_px * seen.weight)
    return off & (misfit < limits.detection)


def contradictions(fit: Adjusted, seen: Observations, limits: Limits) -> list[tuple[int, str]]:
    """Find the rows of detections to leave out, with the reason; of one frame, no more than needs be."""
    misfit = misfits(fit, seen)
    found: list[tuple[int, str]] = []
    disputed: list[Ints] = []
    bad = max(
        limits.detection, WORST_FIRST * float(misfit.max(initial=0.0))
    )  # lesser ones may only follow from the worst
    for pose in np.unique(seen.pose[_is_bad(misfit, bad, fit, seen, limits)]):
        rows = np.flatnonzero(seen.pose == pose)
        if len(rows) == 1:
            found.append((int(rows[0]), SINGLE))
        else:
            disputed.append(rows)
    if disputed:
        without = _misfit_without(fit, seen, disputed)
        for rows in disputed:
            found += _to_leave_out(rows, without)
    return sorted(found)


def readmissible(fit: Adjusted, seen: Observations, rows: Ints) -> list[int]:
    """Find rows of detections (of all in ``seen``, ``rows`` of which take part) that fit after all, now that others
    are out."""
    finite = (np.isfinite(normalised_lengths(fit.state, seen))).all(axis=1)  # a pose that nothing tells is no start
    out = np.setdiff1d(np.flatnonzero(finite), rows)
    cases = []
    for pose in np.unique(seen.pose[out]):
        own, used = out[seen.pose[out] == pose], rows[seen.pose[rows] == pose]
        cases += [np.append(used, row) for row in own] if len(used) else [own]
    if not cases:
        return []
    worst = _refit(fit, seen.only(np.concatenate(cases)), _cases(cases)[1])
    fitting = [
        case for case, misfit in zip(cases, worst, strict=True) if len(case) > 1 and misfit < RIG_LIMITS.detection
    ]
    return sorted({int(row) for case in fitting for row in case if row in out})


def _to_leave_out(rows: Ints, without: dict[int, float]) -> list[tuple[int, str]]:
    """Return which of the detections of one pose are left out, and why."""
    odd_one = int(min(rows, key=lambda row: without[row]))
    if len(rows) > 2:
        clear = (
            without[odd_one] < RIG_LIMITS.detection or len(rows) > 3
        )  # else two of three are wrong, and it is open which
        return [(odd_one, ODD_ONE)] if clear else [(int(row), ALL) for row in rows]
    other = int(rows[0] if odd_one == rows[1] else rows[1])
    if without[odd_one] < RIG_LIMITS.detection < without[other]:  # the other one fits the target, this one does not
        return [(odd_one, SINGLE)]
    return [(int(row), PAIR) for row in rows]


def _misfit_without(fit: Adjusted, seen: Observations, disputed: Sequence[Ints]) -> dict[int, float]:
    """For each disputed detection: the worst misfit of the others of its pose when that pose is fitted without it."""
    cases = [(int(row), rows[rows != row]) for rows in disputed for row in rows]
    rows, case = _cases([rest for _, rest in cases])
    worst = _refit(fit, seen.only(rows), case)
    return {row: value for (row, _), value in zip(cases, worst, strict=True)}


def _is_bad(misfit: Array, limit: float, fit: Adjusted, seen: Observations, limits: Limits) -> Bools:
    """Return (s,) misfits beyond a limit and, in pixels, beyond what lenses and delays may do."""
    sigma_px = 1 / np.maximum(seen.weight.max(axis=1), 1e-300)
    return (misfit > limit) & (misfit * fit.scale * sigma_px * RAYLEIGH_MEDIAN > limits.detection_px)


def _cases(rows: Sequence[Ints]) -> tuple[Ints, Ints]:
    return np.concatenate(rows), np.repeat(np.arange(len(rows)), [len(one) for one in rows])


def _refit(fit: Adjusted, taken: Observations, case: Ints) -> list[float]:
    """Fit one pose to the detections of each case, all cameras fixed; the worst misfit in each case."""
    starts = np.flatnonzero(np.diff(case, prepend=-1))
    first, state = taken.pose[starts], fit.state
    start = replace(state, R_pose=state.R_pose[first], position=state.position[first])
    layout = Layout(len(state.centre), len(state.scale))
    free = FreeUnknowns(np.zeros(layout.size, bool), np.ones(len(starts), bool))
    alone = replace(taken, pose=case, weight=taken.weight / fit.scale)
    refitted = adjust(start, alone, layout, free, stop=ROUGHLY)
    return np.maximum.reduceat(misfits(replace(refitted, scale=1.0), alone), starts).tolist()
