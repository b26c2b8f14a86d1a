"""Limbs that are found, from one set to the next, where no motion leads to.

A torn silhouette, or a hull that shows a phantom for a moment, draws a limb away at once. What leaps farther than limbs
move has either found a place that it had lost, or lost its own. The first explains much more; less than that has to
last, as of any other place, and until then the limb stays where it was expected. Where its hull is gone, it is not
seen.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.least_squares.gauss_newton import Data
from stick_figure.least_squares.placed_figure import Figure
from stick_figure.pose import Pose

from .evidence import Evidence
from .limb_search import NO_POSES, other_places, with_limb
from .pose_library import LIMB_PARTS, LIMB_POINTS, LIMBS, LOWER_STICKS, UPPER_STICKS, Limb, LimbPoses

MOST_M_S, MOST_M_S2 = 20.0, 600.0  # changes of a point's speed: twice what boxers' fists do, in a thirtieth of a second
NEAR_M = 0.1  # what fits err by, besides
LEAP_RAYS = 20.0  # that a place explains beyond the expected one is found again, at once: with fewer it has to last
USUAL_S = 1.0  # over which rays that pass limbs unexplained are: longer than a limb stays wrong
RECENT_S = 0.1  # over which the rays of a limb are averaged: arms pass a trunk in longer
TORN_SHARE, TORN_REACH = 0.6, 0.5  # of its recent rays, of what limbs reach: one that keeps less and is farther is torn


def reach_m(dt: float) -> float:
    """Return how far (m) from its expected place motion brings a point, ``dt`` seconds after it was last seen."""
    return min(MOST_M_S * dt, NEAR_M + 0.5 * MOST_M_S2 * dt * dt)


class RecentRays:
    """How many rays each limb explained lately, and how many near it were left over."""

    def __init__(self) -> None:
        self._explained: np.ndarray | None = None
        self._unexplained = np.zeros(len(LIMBS))

    def add(self, evidence: Evidence, apart_s: float) -> None:
        """One more set, so long after the last."""
        explained, unexplained = rays_of_limbs(evidence), _unexplained(evidence)
        if self._explained is None:
            self._explained, self._unexplained = explained, unexplained
        self._explained = self._explained + (explained - self._explained) * apart_s / (RECENT_S + apart_s)
        self._unexplained = self._unexplained + (unexplained - self._unexplained) * apart_s / (USUAL_S + apart_s)

    def more_unexplained(self, evidence: Evidence) -> np.ndarray:
        """Return by how many rays (4,) more than usual pass near each limb and are not explained."""
        return np.asarray(_unexplained(evidence) - self._unexplained)

    def torn(self, evidence: Evidence, leaps_m: np.ndarray, apart_s: float) -> np.ndarray:
        """Return the limbs (4,) bool that lost their rays when they left (m) their expected places."""
        if self._explained is None:
            return np.zeros(len(LIMBS), bool)
        few = rays_of_limbs(evidence) < TORN_SHARE * self._explained
        return np.asarray(few & (leaps_m > TORN_REACH * reach_m(apart_s)))


def _unexplained(evidence: Evidence) -> np.ndarray:
    return evidence.unexplained[LIMB_PARTS].astype(float)


def rays_of_limbs(evidence: Evidence) -> np.ndarray:
    """Return the rays (4,) that each limb explains."""
    return (evidence.explained[UPPER_STICKS] + evidence.explained[LOWER_STICKS]).astype(float)


def expected_on_trunk(body: Body, pose: Pose, expected: Pose) -> np.ndarray:
    """Return the points (15, 3) m, world, of a pose's trunk with the limbs as they were expected on it."""
    return forward(body, Pose(pose.position_world, pose.R_world_torso, expected.R_joints, expected.hinges))


@njit(cache=True)
def leaps_of_limbs(points, expected):
    """Return how far (4,) m each limb is, elbow or hand, knee or foot, by all points (15, 3) where they are and where
    they were expected on the trunk."""
    leaps = np.zeros(LIMB_POINTS.shape[0])
    for limb in range(LIMB_POINTS.shape[0]):
        for point in LIMB_POINTS[limb]:
            x, y, z = points[point] - expected[point]
            leaps[limb] = max(leaps[limb], np.sqrt(x * x + y * y + z * z))
    return leaps


def kept_limb(body: Body, pose: Pose, expected: Pose, limb: Limb, data: Data) -> Pose | None:
    """Return the pose with one limb about where it was expected, refined there.

    None where the hull does not hold it, or where the place that it leapt to explains LEAP_RAYS more.
    """
    there = LimbPoses(expected.R_joints[None, limb.ball], expected.hinges[None, limb.hinge])
    places = other_places(Figure.of(body), pose, limb, data, NO_POSES, there)
    if len(places.margins) == 0 or places.margins[0] < -LEAP_RAYS:
        return None
    return with_limb(pose, limb, places.poses.R[0], places.poses.flexion[0])
