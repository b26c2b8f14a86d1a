"""How well a pose explains what the cameras saw, counted in rays of the silhouettes' rims.

A ray along a rim grazes the body somewhere. One that passes the flesh of a pose at a distance says that something is
elsewhere; the cost of a pose is how many such rays there are (Geman-McClure: a ray far off counts 1, one on the flesh
0), and of stick points that stick out of the hull. It compares poses with each other far better than the number of
explained rays alone: a body that faces backward explains most of the outline too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.body_surface import BodySurface, place_capsules
from stick_figure.least_squares.contour_factor import match_contour_rays
from stick_figure.least_squares.gauss_newton import ContourArrays
from stick_figure.least_squares.placed_figure import Figure, State
from stick_figure.least_squares.surface_factor import nearest_voxel
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW

TRUNK, LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG = range(5)
PART_NAMES = ("trunk", "left arm", "right arm", "left leg", "right leg")
LIMBS_OF_STICKS = (LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG)
PART_OF_STICK = np.array((TRUNK, TRUNK, *LIMBS_OF_STICKS, *LIMBS_OF_STICKS))
PART_POINTS = ((0, 1, 2, 3, 4, 5, 6), (7, 11), (8, 12), (9, 13), (10, 14))
"""Reference points that only this part holds."""

GATE_M = 0.06  # a ray this far off costs a half
EXPLAINED_M = 0.04  # a ray this near to the flesh is explained
SLACK_M = 0.05  # the flesh may touch a ray this far from the stretch where the ray touches the hull
SAMPLES = 3  # points along each stick that must lie in the hull
OUTSIDE_SLACK_M, OUTSIDE_MOST_M = 0.045, 0.2  # spacing of the hull's samples; farther out is no worse
RAYS_PER_OUTSIDE_M = 30.0  # a hand 0.1 m outside the hull weighs as much as three rays
LOSS = 2.0  # a ray that another pose explains worse counts so much more than one that it explains better
LIMIT_RAD = 0.5  # so far beyond a joint's range costs one ray, twice as far four


@dataclass(frozen=True, eq=False)
class Evidence:
    """What speaks for and against a pose.

    costs (n,) : what each ray costs, 0 to 1; beyond : what points outside the hull and joints beyond their ranges cost,
    in rays. explained, unexplained (5,) rays of each part of the body,
    in the order of PART_NAMES (an unexplained one counts for the part it passes nearest).
    outside (5,) : points of the part's sticks that lie outside the hull, each part of a limb having six.
    """

    costs: np.ndarray
    beyond: float
    explained: np.ndarray
    unexplained: np.ndarray
    outside: np.ndarray

    @property
    def rays(self) -> int:
        """Rays looked at."""
        return len(self.costs)

    @property
    def cost(self) -> float:
        """In rays, lower is better."""
        return float(self.costs.sum()) + self.beyond

    def margin_of(self, other: Evidence) -> float:
        """Rays that another pose explains better, less LOSS times those that it explains worse.

        An arm that leaves its own outline to explain something else (a bent hand, a coat's hem) gains and loses much;
        one that was lost had little to lose.
        """
        better = self.costs - other.costs
        return float(np.where(better > 0.0, better, LOSS * better).sum()) + self.beyond - other.beyond

    @property
    def share(self) -> float:
        """Share of the rays that the pose explains; 1 when there are none."""
        return float(self.explained.sum()) / self.rays if self.rays else 1.0


def evidence_of(
    body: Body, capsules: BodySurface, pose: Pose, contour_rays: ContourArrays, hull: np.ndarray
) -> Evidence:
    """The evidence about a pose from rims and from samples (m, 3) of the hull, world frame, metres."""
    explained, unexplained, outside = np.zeros(5, np.int64), np.zeros(5, np.int64), np.zeros(5, np.int64)
    costs = np.empty(len(contour_rays.information))
    beyond = _count_evidence(
        *State.of(pose), Figure.of(body), capsules, contour_rays, hull, costs, explained, unexplained, outside
    )
    return Evidence(costs, beyond + beyond_limits(pose), explained, unexplained, outside)


def beyond_limits(pose: Pose) -> float:
    """What angles beyond their joints' ranges cost, in rays."""
    angles = pose.angles()
    excess = np.maximum(angles - ANGLE_HIGH, 0.0) + np.maximum(ANGLE_LOW - angles, 0.0)
    return float(((excess / LIMIT_RAD) ** 2).sum())


@njit(cache=True)
def _count_evidence(t0, R0, RJ, hinges, figure, capsules, contour_rays, hull, costs, explained, unexplained, outside):
    k, n = capsules.stick.shape[0], contour_rays.information.shape[0]
    A, B, P, Q = np.empty((10, 3)), np.empty((10, 3)), np.empty((k, 3)), np.empty((k, 3))
    place(t0, R0, RJ, hinges, figure, capsules, A, B, P, Q)
    capsule, separation = np.zeros(n, np.int64), np.empty(n)
    match_contour_rays(contour_rays, P, Q, capsules.radii, SLACK_M, (capsule, np.zeros(n), np.empty(n), separation))
    for i in range(n):
        part = PART_OF_STICK[capsules.stick[capsule[i]]]
        costs[i] = ray_cost(separation[i], GATE_M)
        if separation[i] < EXPLAINED_M:
            explained[part] += 1
        elif separation[i] > GATE_M:
            unexplained[part] += 1
    return _outside(A, B, hull, outside)


@njit(cache=True)
def _outside(A, B, hull, outside):
    """Counts the points of sticks 1 to 9 that lie outside the hull; returns what they cost, in rays."""
    cost, point = 0.0, np.empty(3)
    if hull.shape[0] == 0:
        return cost
    for j in range(1, 10):
        for s in range(SAMPLES):
            for q in range(3):
                point[q] = A[j, q] + (s + 1.0) / SAMPLES * (B[j, q] - A[j, q])
            _, distance = nearest_voxel(hull, point, OUTSIDE_SLACK_M)
            beyond = min(distance - OUTSIDE_SLACK_M, OUTSIDE_MOST_M)
            if beyond > 0.0:
                cost += RAYS_PER_OUTSIDE_M * beyond
            if beyond > OUTSIDE_SLACK_M:
                outside[PART_OF_STICK[j]] += 1
    return cost


@njit(cache=True)
def place(t0, R0, RJ, hinges, figure, capsules, A, B, P, Q):
    """Stick ends A, B (10, 3) and capsule ends P, Q (k, 3) of a pose, world, metres."""
    G, axes = np.empty((10, 3, 3)), np.empty((18, 3))
    kernels.stick_frames(R0, RJ, hinges, G, axes)
    kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
    place_capsules(capsules, G, A, P, Q)


@njit(cache=True)
def ray_cost(separation, gate):
    """0 for a ray on the flesh, a half at the gate, 1 far off."""
    g = separation * separation / (gate * gate)
    return g / (1.0 + g)
