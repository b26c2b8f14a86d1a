"""How the trunk is bent, from contour rays: solved for together with the pose, about a fit that has converged.

The bend's seven numbers (`trunk_bend`) and the pose explain the same rays, so their equations are solved as one; the
pose's part of the step is left to the next fit, which starts with the bend that was found. Hands and feet, which turn
by themselves, say nothing about the trunk.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.small_matrices import solve_positive

from ..body import BEND_NUMBERS, Body
from ..body_surface import BodySurface
from ..trunk_bend import bend_derivatives
from .contour_factor import sum_rays
from .free_ends import CAPSULE as CAPSULE_OF_END
from .normal_equations import CHAIN_COLUMNS, ENDS, TANGENT, add_capsule, mirror_upper, no_sums, pose_columns
from .placed_figure import Figure, place

UNKNOWNS = TANGENT + BEND_NUMBERS


class BendDerivatives(NamedTuple):
    """As `bend_derivatives` has them: origins (10, 3, 7) of sticks, starts and ends (k, 3, 7) of capsules."""

    origins: np.ndarray
    starts: np.ndarray
    ends: np.ndarray

    @staticmethod
    def of(body: Body) -> BendDerivatives:
        """Of a body's rest."""
        return BendDerivatives(*bend_derivatives(body.straight))


@njit(cache=True, nogil=True)
def bend_step(rays, match, state, figure, derivatives, gate, pose_information, information, pull):
    """Return the step (7,) of the bend that lessens the rays' distances from the capsules that they were matched to.

    ``gate`` : of the rays, m. pose_information (24,) holds the pose where it is; information (7,) and pull (7,) are
    those of what is known of the bend without rays.
    """
    H, g = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    placed = place(state, figure)
    sums = no_sums(placed.P.shape[0], ENDS)
    sum_rays(rays, match, gate, sums)
    for k in CAPSULE_OF_END:
        sums.pulls[k] = 0.0
    wide = CHAIN_COLUMNS + BEND_NUMBERS
    M, slots = np.empty((2 * ENDS, wide)), np.empty(wide, np.int64)
    work = np.empty((2 * ENDS + 1, 2 * ENDS))
    for k in range(placed.P.shape[0]):
        if sums.pulls[k].any():
            n = pose_columns(k, placed, M, slots)
            bend_columns(k, placed, derivatives, M[:, n:], ENDS)
            for s in range(BEND_NUMBERS):
                slots[n + s] = TANGENT + s
            add_capsule(sums, k, M, slots, n + BEND_NUMBERS, work, H, g)
    mirror_upper(H)
    for i in range(TANGENT):
        H[i, i] += pose_information[i]
    for s in range(BEND_NUMBERS):
        H[TANGENT + s, TANGENT + s] += information[s]
        g[TANGENT + s] += pull[s]
    L, step = np.empty_like(H), np.empty(UNKNOWNS)
    solve_positive(H, g, L, step)
    return step[TANGENT:].copy()


@kernel
def bend_columns(k, placed, derivatives, M, second):
    """Fill M (6 or 8, 7 or more) with the derivatives of capsule k's ends, world, with respect to the bend; those of
    its end begin at row ``second``."""
    j = placed.surface.stick[k]
    origin = j if j < 6 else j - 4  # the stick on the torso that carries it
    for s in range(BEND_NUMBERS):
        for i in range(3):
            start, end = 0.0, 0.0
            for q in range(3):
                turned = placed.R0[i, q]
                start += turned * (derivatives.origins[origin, q, s] + derivatives.starts[k, q, s])
                end += turned * (derivatives.origins[origin, q, s] + derivatives.ends[k, q, s])
            M[i, s], M[second + i, s] = start, end


@njit(cache=True)
def bent_figure(figure, derivatives, bend):
    """Return a figure with its trunk bent so (7,)."""
    origins, start, end = figure.origins.copy(), figure.surface.start.copy(), figure.surface.end.copy()
    for s in range(BEND_NUMBERS):
        origins += bend[s] * derivatives.origins[:, :, s]
        start += bend[s] * derivatives.starts[:, :, s]
        end += bend[s] * derivatives.ends[:, :, s]
    return Figure(figure.lengths, origins, BodySurface(figure.surface.stick, start, end, figure.surface.radii))
