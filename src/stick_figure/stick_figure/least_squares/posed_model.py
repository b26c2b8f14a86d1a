"""The body's model in a pose, as the arrays that every residual term of a fit reads.

A pose becomes a :class:`PoseState` that a solver moves in place, a body a :class:`BodyModel`; :func:`place` gives the
:class:`PosedModel` of both. All are NamedTuples of float64, C-contiguous arrays, which compiled kernels take whole.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from capture_rig.kernel import njit

from .. import kernels
from ..body import Body
from ..body_surface import BodySurface, nearest_capsule, place_capsules
from ..pose import Pose
from ..trunk_bend import bend_derivatives

STICKS, POINTS = 10, 15


class PoseState(NamedTuple):
    """A pose that a solver changes in place.

    t0 (3,) torso centre, world, m; R0 (3, 3) torso to world; RJ (5, 3, 3) ball joints, stick to torso;
    hinges (4,) rad.
    """

    t0: np.ndarray
    R0: np.ndarray
    RJ: np.ndarray
    hinges: np.ndarray

    @staticmethod
    def of(pose: Pose) -> PoseState:
        """Copy a pose's arrays."""
        return PoseState(*(part.copy() for part in pose.arrays))

    def pose(self) -> Pose:
        """Return the pose that these arrays describe (copied)."""
        return Pose(*self)


class BodyModel(NamedTuple):
    """A body: lengths (10,) m of the sticks, origins (10, 3) m of those that start on the torso, and its surface."""

    lengths: np.ndarray
    origins: np.ndarray
    surface: BodySurface

    @staticmethod
    @lru_cache(maxsize=8)
    def of(body: Body) -> BodyModel:
        """Return the model of a body with the surface of its build and the bend of its trunk."""
        if body.unbent is None:
            return BodyModel(body.lengths, body.stick_origins_torso, BodySurface.of(body))
        rest, (_, starts, ends) = BodyModel.of(body.unbent), bend_derivatives(body.unbent)
        surface = rest.surface._replace(
            start=rest.surface.start + starts @ body.bend, end=rest.surface.end + ends @ body.bend
        )
        return BodyModel(rest.lengths, body.stick_origins_torso, surface)


class PosedModel(NamedTuple):
    """A body's model in a pose, world frame, metres.

    t0, R0, RJ, hinges : of the state. G (10, 3, 3) : sticks to world. axes (18, 3) : the joints' axes (tangent slots 6
    to 23). A, B (10, 3) : the sticks' starts and ends. P, Q (k, 3) : the capsules' ends. surface : the capsules in
    their sticks' frames.
    """

    t0: np.ndarray
    R0: np.ndarray
    RJ: np.ndarray
    hinges: np.ndarray
    G: np.ndarray
    axes: np.ndarray
    A: np.ndarray
    B: np.ndarray
    P: np.ndarray
    Q: np.ndarray
    surface: BodySurface


@njit(cache=True)
def place(state, figure):
    """Pose a body's model; the state's arrays are shared, not copied."""
    G, axes, A, B = kernels.place_sticks(state, figure.lengths, figure.origins)
    P, Q = np.empty(figure.surface.start.shape), np.empty(figure.surface.start.shape)
    place_capsules(figure.surface, G, A, P, Q)
    return PosedModel(state.t0, state.R0, state.RJ, state.hinges, G, axes, A, B, P, Q, figure.surface)


@njit(cache=True)
def reference_points(posed):
    """Return the 15 reference points (15, 3)."""
    points = np.empty((POINTS, 3))
    kernels.reference_points(posed.A, posed.B, posed.t0, points)
    return points


@njit(cache=True, nogil=True)
def surface_distances(points, posed):
    """Compare points (m, 3) with the body's surface.

    Returns the nearest capsule (m,), the place along its axis (m,) from 0 to 1, and the signed distance (m,) from its
    surface, m, negative inside.
    """
    m = points.shape[0]
    x, y, z = columns(points)
    capsule, along, distance = np.zeros(m, np.int64), np.zeros(m), np.empty(m)
    nearest_capsule(x, y, z, posed.P, posed.Q, posed.surface.radii, capsule, along, distance)
    return capsule, along, distance


@njit(cache=True)
def columns(points):
    """Return the coordinates of ``points`` (n, 3) as three contiguous arrays (n,)."""
    n = points.shape[0]
    x, y, z = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        x[i], y[i], z[i] = points[i, 0], points[i, 1], points[i, 2]
    return x, y, z
