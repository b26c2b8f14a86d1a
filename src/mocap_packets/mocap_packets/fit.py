"""The tracker's result for the filter: 15 reference points with a covariance each, and the quality of the fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from stick_figure.pose import Pose

from .table import ZEROS, Columns, Flags

GOOD, DOUBTFUL, LOST = "good", "doubtful", "lost"
PART_NAMES = ("trunk", "left arm", "right arm", "left leg", "right leg")
PART_POINTS = ((0, 1, 2, 3, 4, 5, 6), (7, 11), (8, 12), (9, 13), (10, 14))
"""Reference points that only this part of the body holds."""
PART_OF_POINT = np.array([next(part for part, own in enumerate(PART_POINTS) if point in own) for point in range(15)])
"""(15,) the part that holds each reference point."""
FIRST_PERSON = 1
"""The person whose topics are those of a single one; the others are 2, 3, ..."""
GONE_AFTER_S = 1.0
"""Seconds without a sight of a person after which the person has left: people turn, and pass behind things."""


@dataclass(frozen=True, eq=False)
class ReferencePoints(Columns):
    """The 15 reference points in the order of `stick_figure.skeleton.POINT_NAMES`; world frame.

    points_world : (15, 3) m. covariance : (15, 3, 3) m^2. visible : (15,) bool, measured points. doubtful : (15,) bool,
    points of a part of the body that may be elsewhere; moved : (15,) bool, points of a corrected part, whose
    displacement is not a motion. Both default to none.
    """

    points_world: Annotated[np.ndarray, "x y z"]
    covariance: Annotated[np.ndarray, "cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz"]
    visible: Flags
    doubtful: Flags = ZEROS
    moved: Flags = ZEROS

    def __iter__(self) -> Iterator[np.ndarray]:
        """Points, covariance, visibility, doubt, which were found elsewhere."""
        return iter((self.points_world, self.covariance, self.visible, self.doubtful, self.moved))


NOTHING_SEEN = ReferencePoints(np.zeros((15, 3)), np.zeros((15, 3, 3)), np.zeros(15, bool))


@dataclass(frozen=True)
class TrackQuality:
    """Quality of a fit, by the cameras' contour rays.

    state : "good", "doubtful" or "lost", of the whole body; reason : why, empty when good.
    parts (5,) states of PART_NAMES; explained : share of the contour rays that the pose explains;
    hypothesis_margin : rays that the best other pose explains more, over several sets; None without another pose.
    log_odds (5,) : that each limb is elsewhere than it is tracked, or unseen; -inf for unknown.
    """

    state: str
    reason: str
    parts: tuple[str, ...]
    explained: float
    hypothesis_margin: float | None = None
    log_odds: tuple[float, ...] = (-math.inf,) * len(PART_NAMES)


UNKNOWN = TrackQuality(GOOD, "", (GOOD,) * 5, 1.0)
"""The quality of a fit that was not examined."""


class Solution(NamedTuple):
    """The solver's figures of a fit.

    points, inliers : data points given, and those within the robust gate. rms_m : root mean square distance of the
    inliers to their sticks. converged : the last step was below the tolerance within the iterations allowed.
    """

    points: int
    inliers: int
    rms_m: float
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class Fit:
    """The stick figure of one person fitted to one frame set.

    state : "acquiring", "tracking", "doubtful" or "lost"; started_from : "nothing", "initial", "own", or the stamp (ns)
    of the filter's state that the fit started from; reason : why there is no fit, or why it is doubtful, else empty;
    dropped_points : centerline points that were not finite.
    reference_points_world (15, 3) m, covariance (15, 3, 3) m^2, visible (15,): zeros, huge and False before the first
    pose; the unmoved prediction, huge and False when the set has too few points; not visible when lost.
    solution : the solver's figures, None without a fit. quality : by the contour rays; recovered : parts found again in
    this set, in words, else empty; moved (5,) : the same as flags. person : its number, 1, 2, ...
    """

    stamp_ns: int
    state: str
    started_from: str
    reason: str
    dropped_points: int
    reference_points_world: np.ndarray
    covariance: np.ndarray
    visible: np.ndarray
    pose: Pose | None
    solution: Solution | None
    quality: TrackQuality = UNKNOWN
    recovered: str = ""
    moved: tuple[bool, ...] = (False,) * len(PART_NAMES)
    person: int = FIRST_PERSON

    @property
    def reference_points(self) -> ReferencePoints:
        """What travels on to the filter; each covariance exactly symmetric, as its six numbers in a message are."""
        doubtful = points_of_parts([state != GOOD for state in self.quality.parts])
        covariance = np.triu(self.covariance) + np.triu(self.covariance, 1).transpose(0, 2, 1)
        visible, moved = np.asarray(self.visible, bool), points_of_parts(self.moved)
        return ReferencePoints(self.reference_points_world, covariance, visible, doubtful, moved)


def points_of_parts(parts: Sequence[bool] | np.ndarray) -> np.ndarray:
    """Return (15,) bool: the reference points of the chosen parts (5,) of the body."""
    return np.array(parts, bool)[PART_OF_POINT]
