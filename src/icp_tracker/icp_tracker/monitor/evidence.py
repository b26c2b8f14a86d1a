"""Evidence for a pose, counted in contour rays.

A contour ray touches the body somewhere, so a ray that misses the surface of a pose speaks against it. The cost of a
pose is the number of such rays (Geman-McClure: a ray far off counts 1, one on the surface 0) plus a penalty of joints
beyond their ranges. It separates poses far better than the number of explained rays: a body that faces backward
explains most of the outline too. Joints that a detector found count as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from capture_rig.kernel import njit
from stick_figure.body import Body
from stick_figure.joint_limits import joint_excess
from stick_figure.least_squares.contour_factor import SLACK_M, RayMatch, match_rays
from stick_figure.least_squares.contour_factor import SURFACE_GATE_M as GATE_M
from stick_figure.least_squares.gauss_newton import Data
from stick_figure.least_squares.keypoint_factor import ALL_STICKS, keypoint_support
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place
from stick_figure.pose import Pose

from ..articulated_fit import GUESS, ArticulatedSettings, minimise

PARTS = 5
TRUNK, LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG = range(PARTS)

# Thresholds: measured by python bench/recovery.py.
EXPLAINED_M = 0.04  # a ray this near to the surface is explained
WORSE_RAY_WEIGHT = 1.5  # of a ray that another pose explains worse, against 1 of a ray that it explains better
LIMIT_RAD = 0.5  # an angle this far beyond its range costs one ray, twice as far four
RAYS_PER_NAT = 2.0  # rays worth a nat, and rays that count as one full independent sample (cell of a limb's surface)
SAME_M = 0.12  # poses or places whose points all lie closer than this are the same: the width of a limb
GUESS_ITERATIONS = 12  # of a fit that starts from a guess


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of one set for and against a pose.

    costs (n,) : of each ray, 0 to 1. beyond : cost of joints beyond their ranges less the support of detected joints,
    in rays. share : of the rays' information that the pose explains; 1 without rays. matched : the rays' match.
    """

    costs: np.ndarray
    beyond: float
    share: float
    matched: RayMatch

    @property
    def cost(self) -> float:
        """Total cost, in rays; lower is better."""
        return float(self.costs.sum()) + self.beyond

    def margin_of(self, other: Evidence) -> float:
        """Rays that another pose explains better, less WORSE_RAY_WEIGHT times those that it explains worse.

        The weight keeps an arm from leaving its own outline for something else (a bent hand, a coat's hem), which gains
        and loses much; an arm that was lost has little to lose.
        """
        better, besides = self.costs - other.costs, self.beyond - other.beyond
        return float(np.where(better > 0.0, better, WORSE_RAY_WEIGHT * better).sum()) + besides


def evidence_of(figure: BodyModel, pose: Pose, data: Data, matched: RayMatch | None = None) -> Evidence:
    """Weigh a pose against the contour rays and keypoints of a set, and its angles against their joints' ranges.

    ``matched`` : the rays' match, if known.
    """
    state = PoseState(*pose.arrays)
    matched = matched or match_to(figure, state, data)
    costs, share, excess = _weigh(state, matched.separation, data.contour_rays.information)
    beyond = float(((excess / LIMIT_RAD) ** 2).sum())
    if len(data.keypoints.score):
        beyond -= RAYS_PER_NAT * keypoint_support(data.keypoints, place(state, figure), ALL_STICKS)
    return Evidence(costs, beyond, share, matched)


@njit(cache=True, nogil=True)
def match_to(figure, state, data):
    """Match the rays of a set to a body in a pose."""
    return match_rays(data.contour_rays, place(state, figure), SLACK_M)


@dataclass(frozen=True, eq=False)
class Observation:
    """One frame set against which poses of a body are assessed, ``dt_s`` after the one before."""

    dt_s: float
    body: Body
    data: Data
    settings: ArticulatedSettings
    guess_iterations: ClassVar[int] = GUESS_ITERATIONS

    def evidence_of(self, pose: Pose, matched: RayMatch | None = None) -> Evidence:
        """Return the evidence for a pose; ``matched`` : the rays' match, if known."""
        return evidence_of(BodyModel.of(self.body), pose, self.data, matched)

    def fitted(self, pose: Pose, guess: bool = False) -> Pose:
        """Return the pose that the fit reaches from another one; from a ``guess`` with a wider prior."""
        settings = replace(self.settings, prior=GUESS, max_iterations=self.guess_iterations) if guess else self.settings
        return minimise(self.body, pose, self.data, settings)[0]


@njit(cache=True, nogil=True)
def _weigh(state, separation, information):
    """Return each ray's cost (n,), the explained share of their information (n,), and each angle's excess over its
    range (18,) rad."""
    excess, explained, every = np.empty(18), 0.0, 0.0
    joint_excess(state.RJ, state.hinges, 0.0, np.empty(5), excess)
    for i in range(separation.shape[0]):
        every += information[i]
        if separation[i] < EXPLAINED_M:
            explained += information[i]
    return ray_cost(separation, GATE_M), explained / every if every > 0.0 else 1.0, excess


@njit(cache=True, error_model="numpy")
def ray_cost(separation, gate):
    """Return the Geman-McClure cost of rays: 0 on the surface, a half at the gate, 1 far off."""
    g = separation * separation / (gate * gate)
    return g / (1.0 + g)
