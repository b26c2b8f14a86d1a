"""Step 5: detections that contradict the others, and which of them to leave out.

A wrong order of corners, a target that moved between the exposures, corners found on something else: what fits no pose
of the target is left out for that; of three or more cameras that saw the target, the one farthest off; of two, both.
"""

from __future__ import annotations

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


def contradictions(fit: Adjusted, seen: Observations, alone_px: Array, limits: Limits) -> list[tuple[int, str]]:
    """Find the rows of detections to leave out, with the reason; of one pose of a target, no more than needs be.

    ``alone_px`` (s,): the rms distance of the corners of each detection under the pose that fits it best alone.
    """
    misfit, sigma_px = misfits(fit, seen), fit.scale / np.maximum(seen.weight.max(axis=1), 1e-300)
    off_alone = alone_px > np.sqrt(2.0) * np.maximum(limits.detection * sigma_px, limits.detection_px)
    # lesser ones may only follow from the worst
    limit = max(limits.detection, WORST_FIRST * float(misfit.max(initial=0.0)))
    found: list[tuple[int, str]] = []
    for pose in np.unique(seen.pose[(misfit > limit) & (misfit * sigma_px * RAYLEIGH_MEDIAN > limits.detection_px)]):
        rows = np.flatnonzero(seen.pose == pose)
        own = rows[off_alone[rows]]
        if len(own) or len(rows) == 1:
            found += [(int(row), SINGLE) for row in (own if len(own) else rows)]
        elif len(rows) == 2:
            found += [(int(row), PAIR) for row in rows]
        else:  # the others outvote it: Huber's loss grows like the distance, and they agree
            found.append((int(rows[np.argmax(misfit[rows])]), ODD_ONE))
    return sorted(found)


def readmissible(fit: Adjusted, seen: Observations, rows: Ints, limits: Limits) -> Ints:
    """Find rows of detections (of all in ``seen``, ``rows`` of which take part) that fit after all, now that others are
    out: those that agree with another one of their pose when all poses are fitted anew, the cameras held fixed."""
    reached = np.flatnonzero(np.isfinite(normalised_lengths(fit.state, seen)).all(axis=1))  # else no pose to start from
    if np.isin(reached, rows).all():
        return reached[:0]
    alone = seen.only(reached).weighted(np.array(1 / fit.scale))
    layout = Layout(len(fit.state.centre), len(fit.state.scale))
    free = FreeUnknowns(np.zeros(layout.size, bool), np.ones(len(fit.state.position), bool))
    refitted = adjust(fit.state, alone, layout, free, stop=ROUGHLY)
    fitting = misfits(replace(refitted, scale=1.0), alone) < limits.detection
    agreeing = np.bincount(alone.pose, fitting)[alone.pose] > 1
    return np.setdiff1d(reached[fitting & agreeing], rows)
