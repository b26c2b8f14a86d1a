"""The filter's measurement: 15 reference points with a covariance each (thesis eq. 5.48), and their prediction.

The measurement function h gives the 15 points of a pose (thesis Table 5.2), H is its Jacobian (Table 5.8). The pose's
state arrays (t0, R0, RJ, hinges) are those of `stick_figure.kernels`. A point depends on at most eleven of the 24
tangent slots, and only those columns of its Jacobian are kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from capture_rig.errors import InputError
from capture_rig.kernel import njit
from capture_rig.small_matrices import inverse3, positive3
from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_NAMES, POINT_STICK

POINTS = len(POINT_NAMES)
# Thresholds: rounding from arithmetic.
ASYMMETRY_M2 = 1e-9
"""m^2: more than rounding of float32 leaves between the two triangles of a covariance."""
WIDTH = 11
"""Columns that are kept of a point: at most ten are used, one is spare for `kernels.point_jacobian`."""


class Measurement(NamedTuple):
    """z and R of one frame set.

    points_world : (15, 3) metres
    covariance : (15, 3, 3) m^2, each positive definite; points are taken as independent of each other
    visible : (15,) bool, the points that were measured
    """

    points_world: np.ndarray
    covariance: np.ndarray
    visible: np.ndarray

    @classmethod
    def checked(
        cls, points_world: np.ndarray, covariance: np.ndarray, visible: np.ndarray, sd_floor: float
    ) -> Measurement:
        """Return a measurement whose points have at least the standard deviation ``sd_floor`` (m) in every direction.

        Numbers of points that are not visible are ignored. Raises InputError for numbers that are not finite, and
        covariances that are not symmetric or not positive.
        """
        points_world = np.ascontiguousarray(points_world, float)
        covariance = np.ascontiguousarray(covariance, float)
        visible = np.ascontiguousarray(visible, bool)
        z, R = np.zeros((POINTS, 3)), np.zeros((POINTS, 3, 3))
        bad = _copy_visible(points_world, covariance, visible, sd_floor**2, z, R)
        if bad >= 0:
            what = f"point '{POINT_NAMES[bad]}' is not finite, or its covariance not symmetric and positive"
            raise InputError(what, remedy="Mark points that could not be measured as not visible.")
        return cls(z, R, visible.copy())


class Sizes(NamedTuple):
    """A body for the kernels: lengths (10,) m of the sticks, origins (10, 3) m of those that start on the torso."""

    lengths: np.ndarray
    origins: np.ndarray

    @staticmethod
    def of(body: Body) -> Sizes:
        """Return its arrays."""
        return Sizes(body.lengths, body.stick_origins_torso)


class Linearised(NamedTuple):
    """The points at a pose, and their derivatives.

    h (15, 3) : the points, m, world (thesis Table 5.2)
    J (15, 3, 11) : of point i the columns J[i, :, :columns[i]] of H, for the tangent slots slots[i, :columns[i]]
        (thesis Table 5.8, p1's row corrected: p1 is the torso's position and nothing else)
    """

    h: np.ndarray
    J: np.ndarray
    slots: np.ndarray
    columns: np.ndarray


def linearised(body: Body, pose: Pose) -> Linearised:
    """Return the measurement function and its Jacobian at a pose."""
    at = empty_linearised()
    linearise(pose.arrays, Sizes.of(body), at)
    return at


# --- kernels ---------------------------------------------------------------------------------------------------------


@njit(cache=True)
def _copy_visible(points_world, covariance, visible, floor, z, R):
    """z and R <- the visible points, the floor (m^2) added to each variance; returns the last invalid point, or -1."""
    bad = -1
    for point in range(POINTS):
        good = True
        if visible[point]:
            z[point] = points_world[point]
            R[point] = covariance[point]
        for i in range(3):
            good = good and math.isfinite(z[point, i])
            for j in range(i):
                good = good and abs(R[point, i, j] - R[point, j, i]) < ASYMMETRY_M2
            R[point, i, i] += floor
        if not (good and positive3(R[point])):
            bad = point
    return bad


@njit(cache=True)
def empty_linearised():
    """Arrays to be filled."""
    slots, columns = np.empty((15, WIDTH), np.int64), np.empty(15, np.int64)
    return Linearised(np.empty((15, 3)), np.empty((15, 3, WIDTH)), slots, columns)


@njit(cache=True)
def linearise(pose, sizes, at):
    """at <- points and Jacobian at the pose (t0, R0, RJ, hinges) of a body."""
    t0 = pose[0]
    _, axes, A, B = kernels.place_sticks(pose, sizes.lengths, sizes.origins)
    kernels.reference_points(A, B, t0, at.h)
    for point in range(15):
        at.columns[point] = kernels.point_jacobian(
            POINT_STICK[point], at.h[point], t0, A, axes, at.J[point], at.slots[point]
        )


@njit(cache=True)
def moved(at, point, step):
    """Return the point (x, y, z) after a step (24,), to first order."""
    x, y, z = at.h[point]
    for a in range(at.columns[point]):
        d = step[at.slots[point, a]]
        x += at.J[point, 0, a] * d
        y += at.J[point, 1, a] * d
        z += at.J[point, 2, a] * d
    return x, y, z


@njit(cache=True)
def point_covariance(at, point, P, C):
    """C (3, 3) <- H P H' of one point, P (>= 24, >= 24) with the pose first."""
    n = at.columns[point]
    J, slots = at.J[point], at.slots[point]
    HP = np.zeros((3, WIDTH))
    for a in range(n):
        row = P[slots[a]]
        for b in range(n):
            entry = row[slots[b]]
            for i in range(3):
                HP[i, b] += J[i, a] * entry
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for b in range(n):
                total += HP[i, b] * J[j, b]
            C[i, j] = total
            C[j, i] = total


@njit(cache=True, nogil=True)
def squared_distances(estimate, sizes, z):
    """Return (15,) squared Mahalanobis distance of each visible point from its prediction; 0 for the others.

    Each is chi-square with 3 degrees of freedom while model and covariances are right.
    """
    pose, _, P = estimate
    distances, at = np.zeros(15), empty_linearised()
    linearise(pose, sizes, at)
    S, inverse, y = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for point in range(15):
        if not z.visible[point]:
            continue
        point_covariance(at, point, P, S)
        for i in range(3):
            y[i] = z.points_world[point, i] - at.h[point, i]
            for j in range(3):
                S[i, j] += z.covariance[point, i, j]
        inverse3(S, inverse)
        for i in range(3):
            for j in range(3):
                distances[point] += y[i] * inverse[i, j] * y[j]
    return distances


@njit(cache=True)
def add_information(at, point, weight, y, information, gradient):
    """information (24, 24) += J' W J and gradient (24,) += J' W y of one point with W = weight (3, 3), y (3,)."""
    n = at.columns[point]
    J, slots = at.J[point], at.slots[point]
    WJ = np.empty((3, WIDTH))
    for b in range(n):
        for i in range(3):
            WJ[i, b] = weight[i, 0] * J[0, b] + weight[i, 1] * J[1, b] + weight[i, 2] * J[2, b]
    for a in range(n):
        gradient[slots[a]] += WJ[0, a] * y[0] + WJ[1, a] * y[1] + WJ[2, a] * y[2]
        row = information[slots[a]]
        for b in range(n):
            row[slots[b]] += J[0, a] * WJ[0, b] + J[1, a] * WJ[1, b] + J[2, a] * WJ[2, b]
