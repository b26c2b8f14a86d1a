"""The normal equations of the adjustment, the targets' poses eliminated (Schur complement).

Every corner depends on what is shared (cameras, lenses, scales: tens of unknowns) and on one pose of one target
(hundreds of poses, six unknowns each, none of which meets another): with U, V and W the blocks of J^T J by shared, by
pose and mixed,  (U - sum W V^-1 W^T) d_shared = g_shared - sum W V^-1 g_pose  (Triggs et al. 2000, section 6.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .observations import Layout, Observations
from .projection import Linearised
from .rigid import Array

TINY = 1e-10  # keeps the turn of a wand about itself, which no picture shows, from being divided by zero

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Free:
    """What may move: shared (d,) unknowns and poses (m,) of targets. What fixes the frame is not free."""

    shared: Bools
    poses: Bools


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """U (d, d), W (m, d, 6), V (m, 6, 6), and the right sides g_shared (d,), g_poses (m, 6)."""

    U: Array
    W: Array
    V: Array
    g_shared: Array
    g_poses: Array


@dataclass(frozen=True, eq=False)
class Reduced:
    """The same after elimination: S (f, f) and b (f,) of the free shared unknowns, and V^-1 (m, 6, 6)."""

    S: Array
    b: Array
    V_inverse: Array


def normal_equations(linear: Linearised, seen: Observations, layout: Layout, poses: int) -> NormalEquations:
    """Sums of all sightings, which are few enough in width to multiply one by one."""
    J = np.concatenate([linear.by_shared, linear.by_pose, linear.residual[..., None]], axis=2)
    products = np.swapaxes(J, 1, 2) @ J
    k = layout.width + 1
    columns, size = layout.columns(seen.camera, seen.target), layout.size
    U, W, V = np.zeros((size, size)), np.zeros((poses, size, 6)), np.zeros((poses, 6, 6))
    g_shared, g_poses = np.zeros(size), np.zeros((poses, 6))
    np.add.at(U, (columns[:, :, None], columns[:, None, :]), products[:, :k, :k])
    np.add.at(W, (seen.pose[:, None], columns), products[:, :k, k : k + 6])
    np.add.at(V, seen.pose, products[:, k : k + 6, k : k + 6])
    np.add.at(g_shared, columns, products[:, :k, -1])
    np.add.at(g_poses, seen.pose, products[:, k : k + 6, -1])
    return NormalEquations(U, W, V, g_shared, g_poses)


def reduce(equations: NormalEquations, free: Free, damping: float = 0.0) -> Reduced:
    """Eliminate the poses; ``damping`` as in Levenberg-Marquardt, relative to the diagonals."""
    V = equations.V.copy()
    diagonal = np.arange(6)
    floor = TINY * np.trace(V, axis1=1, axis2=2)[:, None] + 1e-300
    V[:, diagonal, diagonal] += damping * V[:, diagonal, diagonal] + floor
    V_inverse = np.asarray(np.linalg.inv(V) * free.poses[:, None, None], float)
    W = equations.W[:, free.shared]
    U = equations.U[np.ix_(free.shared, free.shared)]
    flat = np.swapaxes(W, 0, 1).reshape(W.shape[1], 6 * len(V))
    weighted = np.swapaxes(W @ V_inverse, 0, 1).reshape(W.shape[1], 6 * len(V))
    S = U + damping * np.diag(np.diag(U)) - weighted @ flat.T
    return Reduced(S, equations.g_shared[free.shared] - weighted @ equations.g_poses.ravel(), V_inverse)


def step(equations: NormalEquations, free: Free, damping: float) -> tuple[Array, Array]:
    """The damped Gauss-Newton step: shared (d,), poses (m, 6)."""
    reduced = reduce(equations, free, damping)
    shared = np.zeros(len(free.shared))
    shared[free.shared] = np.linalg.lstsq(reduced.S, reduced.b, rcond=None)[0]
    rest = equations.g_poses - np.swapaxes(equations.W, 1, 2) @ shared
    return shared, (reduced.V_inverse @ rest[..., None])[..., 0]
