"""Hierarchical articulated ICP (thesis 4.3, Algorithm 2), corrected.

The torso first, then every limb from its root to its end: each stick is aligned by ICP to the points nearest to it,
helped by the points of its descendants with a small weight (they fix the rotation about the stick's own axis), and
carries its descendants along. Corrections to the text: model points are moved onto data points (not the reverse); a
lone stick takes the smallest rotation (its Procrustes problem leaves the twist open); and a stick is done when its
increment is small, since with noisy data the mean distance never falls below a threshold.

The X84 rejection rule (eq. 4.11) discards pairs with ``|e - med e| > 3.5 * 1.4826 MAD``, here group by group. Two
corrections: a distance BELOW the median is never an outlier, so the rule is one-sided; and the median absolute
deviation of a nearly perfect set is nearly zero and would discard half of it, so the scale never falls below a floor of
a few millimetres.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit
from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.kinematics import inverse
from stick_figure.least_squares.point_factor import place_feet, prefer_stick
from stick_figure.least_squares.posed_model import STICKS, BodyModel, PoseState, columns
from stick_figure.pose import Pose
from stick_figure.skeleton import PARENT, PREORDER

from .procrustes import weighted_extended_procrustes, weighted_procrustes_about, weighted_swing_about

OWN, DESCENDANT, OTHER = 0, 1, 2
# Thresholds: MIN_OWN_POINTS from Arun et al. 1987: three points fix a rotation; X84 from Hampel et al., "Robust
# Statistics", 1986, and the normal distribution; else judgement.
MAX_ITERATIONS = 30  # of a stick
MIN_OWN_POINTS = 3  # a stick with fewer points of its own stays where it is
ROTATION_TOLERANCE, SHIFT_TOLERANCE_M = 1e-3, 1e-4  # rad, m: a stick, the torso, is done below this increment
DESCENDANT_WEIGHT = 0.2  # the thesis's epsilon
CUT = 3.5  # standard deviations
MAD_TO_SIGMA = 1.4826  # a Gaussian's standard deviation over its median absolute deviation
SIGMA_FLOOR_M = 0.005


def _descendants() -> np.ndarray:
    below = np.zeros((STICKS, STICKS), dtype=np.bool_)
    for stick in range(STICKS):
        ancestor = PARENT[stick]
        while ancestor >= 0:
            below[ancestor, stick] = True
            ancestor = PARENT[ancestor]
    return below


DESCENDANTS = _descendants()
"""(10, 10) bool: [j, k] is true when stick k hangs below stick j."""
_ORDER = np.array(PREORDER)
_LEAF = np.array([not below.any() for below in DESCENDANTS])


def fit_hierarchical(
    body: Body, start: Pose, points_world: np.ndarray, descendant_weight: float = DESCENDANT_WEIGHT
) -> tuple[Pose, int, bool]:
    """Fit the stick figure to ``points_world`` (n, 3) m, starting from ``start``.

    ``descendant_weight`` : of a descendant's point against one of the stick's own.

    Returns the pose, the total of the sticks' iterations, and whether every stick converged.
    """
    state, figure = PoseState.of(start), BodyModel.of(body)
    G, *_ = kernels.place_sticks(state, figure.lengths, figure.origins)
    points = np.ascontiguousarray(points_world, dtype=np.float64)
    iterations, converged = align_sticks(points, G, state.t0, figure, descendant_weight)
    # every joint was free to turn in all directions; the nearest pose with hinges at elbows and knees has these points
    return inverse(body, _reference_points(G, state.t0, figure), start), iterations, converged


def _reference_points(G: np.ndarray, t0: np.ndarray, figure: BodyModel) -> np.ndarray:
    A, B, P = np.empty((STICKS, 3)), np.empty((STICKS, 3)), np.empty((15, 3))
    kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
    kernels.reference_points(A, B, t0, P)
    return P


@njit(cache=True, nogil=True)
def align_sticks(points, G, t0, figure, epsilon):
    """Algorithm 2 on the sticks' world frames ``G`` (10, 3, 3) and the torso centre ``t0``, in place.

    ``epsilon`` : weight of a descendant's point. Returns the iterations spent and whether every stick that had points
    met the tolerance.
    """
    n = points.shape[0]
    xyz = columns(points)
    A, B = np.empty((STICKS, 3)), np.empty((STICKS, 3))
    match = (np.empty(n, np.int64), np.empty(n), np.empty((n, 3)), np.empty(n))
    fixed = (np.empty(n, np.int64), np.empty(n), np.empty(n))
    keep, weight = np.empty(n, np.bool_), np.empty(n)
    spent, converged = 0, True
    for j in _ORDER:  # step 1: preorder; step 2: the current stick
        kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
        match_fixed_sticks(j, xyz, A, B, fixed)
        done = False
        for _ in range(MAX_ITERATIONS):
            spent += 1
            match_moving_sticks(j, xyz, A, B, fixed, match)  # step 3
            if weight_points(j, match, epsilon, keep, weight) < MIN_OWN_POINTS:  # steps 4 and 5
                done = True
                break
            angle, shift = move_stick(j, points, match[2], weight, A, B, G, t0)  # steps 6 and 7
            kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
            if angle < ROTATION_TOLERANCE and shift < SHIFT_TOLERANCE_M:  # step 8
                done = True
                break
        converged = converged and done
    return spent, converged


@njit(cache=True, nogil=True)
def match_fixed_sticks(j, xyz, A, B, fixed):
    """Find the nearest of the sticks that stay while stick j is aligned, for every point."""
    stick, along, squared = fixed
    stick[:] = -1
    along[:] = 0.0
    squared[:] = np.inf
    for k in range(STICKS):
        if k != j and not DESCENDANTS[j, k]:
            prefer_stick(k, xyz[0], xyz[1], xyz[2], A[k], B[k], stick, along, squared)


@njit(cache=True, nogil=True)
def match_moving_sticks(j, xyz, A, B, fixed, match):
    """Foot points on all sticks: the fixed ones' from ``fixed``, stick j's and its descendants' computed anew."""
    stick, along, feet, squared = match
    stick[:] = fixed[0]
    along[:] = fixed[1]
    squared[:] = fixed[2]
    for k in range(STICKS):
        if k == j or DESCENDANTS[j, k]:
            prefer_stick(k, xyz[0], xyz[1], xyz[2], A[k], B[k], stick, along, squared)
    place_feet(A, B, stick, along, feet)


@njit(cache=True, nogil=True)
def move_stick(j, points, feet, weight, A, B, G, t0):
    """Step 6: WEOPP for the torso, WOPP for limbs, the smallest rotation for lone sticks; step 7: apply it."""
    R, t = np.empty((3, 3)), np.zeros(3)
    if j == 0:
        angle = weighted_extended_procrustes(feet, points, weight, R, t)
    elif _LEAF[j]:
        angle = weighted_swing_about(A[j], B[j] - A[j], feet, points, weight, R)
    else:
        angle = weighted_procrustes_about(A[j], feet, points, weight, R)
    return angle, apply_motion(j, R, t, G, t0)


@njit(cache=True, nogil=True)
def weight_points(j, match, epsilon, keep, weight):
    """Weights (n,): own points 1, descendants' below, rejected (X84 in either group) and foreign points 0.

    Returns the number of stick j's own points before rejection.
    """
    stick, _, _, squared = match
    n = stick.shape[0]
    distances, group = np.empty(n), np.empty(n, np.int64)
    own = 0
    for i in range(n):
        group[i] = OWN if stick[i] == j else (DESCENDANT if DESCENDANTS[j, stick[i]] else OTHER)
        distances[i] = np.sqrt(squared[i])
        own += group[i] == OWN
    x84_keep(distances, group, 2, SIGMA_FLOOR_M, keep)
    for i in range(n):
        weight[i] = 0.0
        if not keep[i]:
            continue
        weight[i] = 1.0 if group[i] == OWN else epsilon
    return own


@njit(cache=True, nogil=True)
def apply_motion(j, R, t, G, t0):
    """Turn stick j and everything below it; the torso also moves. Returns the length of its shift (m)."""
    shift = 0.0
    if j == 0:
        x, y, z = t0[0], t0[1], t0[2]
        for p in range(3):
            moved = R[p, 0] * x + R[p, 1] * y + R[p, 2] * z + t[p]
            shift += (moved - t0[p]) ** 2
            t0[p] = moved
    column = np.empty(3)
    for k in range(STICKS):
        if k != j and not DESCENDANTS[j, k]:
            continue
        for q in range(3):
            column[0], column[1], column[2] = G[k, 0, q], G[k, 1, q], G[k, 2, q]
            for p in range(3):
                G[k, p, q] = R[p, 0] * column[0] + R[p, 1] * column[1] + R[p, 2] * column[2]
    return np.sqrt(shift)


@njit(cache=True)
def x84_threshold(distances, floor=SIGMA_FLOOR_M):
    """Return the largest distance (m) that is kept of ``distances`` (n,), m; infinite for an empty set."""
    if distances.shape[0] == 0:
        return np.inf
    centre = np.median(distances)
    sigma = MAD_TO_SIGMA * np.median(np.abs(distances - centre))
    return centre + CUT * max(sigma, floor)


@njit(cache=True)
def x84_keep(distances, group, groups, floor, keep):
    """Apply the rule to each group on its own; groups outside 0..groups-1 are not kept.

    ``distances`` (n,) m, ``group`` (n,) int, ``keep`` (n,) bool is written; returns the number kept.
    """
    n = distances.shape[0]
    keep[:] = False
    members = np.empty(n)
    kept = 0
    for g in range(groups):
        count = 0
        for i in range(n):
            if group[i] == g:
                members[count] = distances[i]
                count += 1
        limit = x84_threshold(members[:count], floor)
        for i in range(n):
            if group[i] == g and distances[i] <= limit:
                keep[i] = True
                kept += 1
    return kept
