"""How well a pose explains what the cameras saw, counted in contour rays.

A contour ray touches the body somewhere. One that passes the surface of a pose at a distance says that something is
elsewhere; the cost of a pose is how many such rays there are (Geman-McClure: a ray far off counts 1, one on the surface
0), and stick points that lie outside the hull. Centerline points that no stick passes and voxels of the hull's surface
far from the body's count, too: an arm that left its own volume leaves them over. It compares poses with each other far
better than the number of explained rays alone: a body that faces backward explains most of the outline too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_rig.kernel import njit
from stick_figure.body import Body
from stick_figure.joint_limits import joint_excess
from stick_figure.kinematics import forward
from stick_figure.least_squares.contour_factor import match_rays
from stick_figure.least_squares.gauss_newton import Data, DataMatch
from stick_figure.least_squares.hull_samples import nearest_sample
from stick_figure.least_squares.placed_figure import STICKS, Figure, State, place, surface_distances
from stick_figure.least_squares.surface_factor import point_on_stick
from stick_figure.pose import Pose

from ..articulated_fit import CONTOUR_SLACK_M as SLACK_M
from ..articulated_fit import ArticulatedSettings, minimise

PARTS = 5
TRUNK, LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG = range(PARTS)

# Thresholds: measured by python bench/recovery.py.
# a limb in full view has about 80 rays, 25 centerline points and 60 voxels: these weigh like rays, but less, because a
# hull of few cameras is fat; checked on which changes of place were right (bench/doubt.py)
RAYS_PER_POINT, RAYS_PER_VOXEL = 2.0, 0.2
POINT_GATE_M = 0.08  # a centerline point so far from the nearest stick costs a half: that of the fit
GATE_M = 0.06  # a ray this far off costs a half
EXPLAINED_M = 0.04  # a ray this near to the surface is explained
SAMPLES = 3  # points along each stick that must lie in the hull
OUTSIDE_SLACK_M, OUTSIDE_MOST_M = 0.045, 0.2  # spacing of the hull's samples; farther out is no worse
RAYS_PER_OUTSIDE_M = 30.0  # a hand 0.1 m outside the hull weighs as much as three rays
LOSS = 1.5  # a ray that another pose explains worse counts so much more than one that it explains better
LIMIT_RAD = 0.5  # so far beyond a joint's range costs one ray, twice as far four
SAME_M = 0.10  # poses whose 15 points are so near to each other are one
GUESS_ITERATIONS = 12  # of a fit that starts from a guess


@dataclass(frozen=True, eq=False)
class Evidence:
    """What speaks for and against a pose.

    costs (n,) : what each ray costs, 0 to 1; beyond : what points outside the hull and joints beyond their ranges cost,
    in rays; volume : what centerline points and voxels cost that the pose does not explain, in rays. explained : rays
    that the pose explains. matched : what the rays and voxels were matched to.
    """

    costs: np.ndarray
    beyond: float
    volume: float
    explained: int
    matched: DataMatch

    @property
    def rays(self) -> int:
        """Rays looked at."""
        return len(self.costs)

    @property
    def cost(self) -> float:
        """Of outlines and what is beyond, in rays; lower is better. Volume compares poses of one set alone."""
        return float(self.costs.sum()) + self.beyond

    def margin_of(self, other: Evidence) -> float:
        """Rays that another pose explains better, less LOSS times those that it explains worse.

        An arm that leaves its own outline to explain something else (a bent hand, a coat's hem) gains and loses much;
        one that was lost had little to lose.
        """
        better, besides = self.costs - other.costs, self.beyond + self.volume - other.beyond - other.volume
        return float(np.where(better > 0.0, better, LOSS * better).sum()) + besides

    @property
    def share(self) -> float:
        """Share of the rays that the pose explains; 1 when there are none."""
        return self.explained / self.rays if self.rays else 1.0


def evidence_of(figure: Figure, pose: Pose, data: Data, matched: DataMatch | None = None) -> Evidence:
    """Weigh a pose against contour rays, centerline and hull of a set, and its angles against their joints' ranges.

    ``matched`` : what rays and voxels are matched to, when that is known.
    """
    matched = matched or match_to(figure, State(*pose.arrays), data)
    costs, explained, beyond, volume, excess = _weigh(figure, State(*pose.arrays), data, matched)
    if excess.any():
        beyond += float(((excess / LIMIT_RAD) ** 2).sum())
    return Evidence(costs, beyond, volume, explained, matched)


@njit(cache=True, nogil=True)
def match_to(figure, state, data):
    """Match rays and surface voxels of a set to a figure in a pose."""
    placed = place(state, figure)
    return DataMatch(match_rays(data.contour_rays, placed, SLACK_M), surface_distances(data.voxels, placed))


@dataclass(frozen=True, eq=False)
class Observation:
    """One frame set as the monitor assesses it, ``dt_s`` after the one before."""

    dt_s: float
    body: Body
    data: Data
    settings: ArticulatedSettings

    def evidence_of(self, pose: Pose, matched: DataMatch | None = None) -> Evidence:
        """Return the evidence about a pose; ``matched`` : as of `evidence_of`."""
        return evidence_of(Figure.of(self.body), pose, self.data, matched)

    def fitted(self, pose: Pose, guess: bool = False) -> Pose:
        """Return the pose that the fit reaches from another one, with more iterations if that is only a guess."""
        settings = replace(self.settings, max_iterations=GUESS_ITERATIONS) if guess else self.settings
        return minimise(self.body, pose, self.data, settings)[0]

    def apart_m(self, pose: Pose, other: Pose) -> float:
        """Return how far apart (m) two poses' reference points are at most."""
        return float(np.linalg.norm(forward(self.body, pose) - forward(self.body, other), axis=1).max())


@njit(cache=True, nogil=True)
def _weigh(figure, state, data, matched):
    """Return what each ray costs (n,); the number of explained rays; what points outside the hull cost, and what is
    unexplained of the hull; by how much (18,) rad angles are beyond their joints' ranges."""
    placed, match = place(state, figure), matched.rays
    costs, explained = ray_cost(match.separation, GATE_M), 0
    for separation in match.separation:
        explained += separation < EXPLAINED_M
    excess = np.empty(18)
    joint_excess(state.RJ, state.hinges, 0.0, np.empty(5), excess)
    beyond = _cost_outside(placed, data.hull)
    volume = _unexplained_volume(placed, data, matched.voxels[2])
    return costs, explained, beyond, volume, excess


@njit(cache=True)
def _unexplained_volume(placed, data, voxel_distances):
    """Return the rays that centerline points and voxels, (m,) m from its surface, are worth which the body does not
    explain."""
    cost = 0.0  # of all at once, added one by one: divisions are the work
    for one in RAYS_PER_POINT * ray_cost(stick_distances(data.points, placed, np.arange(STICKS)), POINT_GATE_M):
        cost += one
    for one in RAYS_PER_VOXEL * ray_cost(voxel_distances, GATE_M):
        cost += one
    return cost


@njit(cache=True)
def stick_distances(points, placed, sticks):
    """Return how far (n,) m points (n, 3) lie from the nearest of some sticks."""
    distances = np.full(points.shape[0], np.inf)
    for j in sticks:
        A = placed.A[j]
        along = placed.B[j] - A
        length2 = along @ along
        for i in range(points.shape[0]):
            x, y, z = points[i, 0] - A[0], points[i, 1] - A[1], points[i, 2] - A[2]
            u = min(max((x * along[0] + y * along[1] + z * along[2]) / length2, 0.0), 1.0)
            squared = (x - u * along[0]) ** 2 + (y - u * along[1]) ** 2 + (z - u * along[2]) ** 2
            distances[i] = min(distances[i], squared)
    return np.sqrt(distances)


@njit(cache=True)
def _cost_outside(placed, hull):
    """Return what the points of sticks 1 to 9 that lie outside the hull cost, in rays."""
    cost, point = 0.0, np.empty(3)
    if hull.points.shape[0] == 0:
        return cost
    for j in range(1, STICKS):
        for s in range(SAMPLES):
            point_on_stick(placed, j, (s + 1.0) / SAMPLES, point)
            _, distance = nearest_sample(hull, point, OUTSIDE_SLACK_M)
            cost += RAYS_PER_OUTSIDE_M * max(min(distance - OUTSIDE_SLACK_M, OUTSIDE_MOST_M), 0.0)
    return cost


@njit(cache=True, error_model="numpy")
def ray_cost(separation, gate):
    """Return what a ray, or each of them, costs: 0 on the surface, a half at the gate, 1 far off."""
    g = separation * separation / (gate * gate)
    return g / (1.0 + g)
