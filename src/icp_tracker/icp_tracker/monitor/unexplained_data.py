"""The data of a frame set that the body without one limb does not explain, within the limb's reach."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from capture_rig.kernel import njit
from stick_figure.body_surface import BodySurface
from stick_figure.least_squares.contour_factor import NORMAL, RayArrays, match_rays, rays_at
from stick_figure.least_squares.contour_factor import TANGENT as ALONG
from stick_figure.least_squares.placed_figure import Figure, place

from .evidence import GATE_M, SLACK_M, ray_cost

# Thresholds: measured by python bench/recovery.py.
COARSE_GATE_M = 2.0 * GATE_M  # the library is coarse: an elbow may be 80 mm off
EXPLAINED_BY_BODY_M = 0.03  # data closer than this to the rest of the body are explained already


class UnexplainedData(NamedTuple):
    """What the rest of the body does not explain, within reach of a limb.

    rays, coarse, fine (n,) : contour rays, and what each costs without the limb at a wide gate and at the usual one.
    """

    rays: RayArrays
    coarse: np.ndarray
    fine: np.ndarray


@njit(cache=True)
def unexplained_data(data, matched, state, figure, limb):
    """Return the data that the body without the limb does not explain."""
    rays, placed, own = data.contour_rays, place(state, part_of(figure, limb, False)), _is_of_limb(figure, limb)
    without, root = _rays_without(rays, matched, placed, own), placed.A[limb.upper].copy()
    reach = figure.lengths[limb.upper] + figure.lengths[limb.lower] + COARSE_GATE_M
    chosen, count = np.empty(without.shape[0], np.int64), 0
    for i in range(without.shape[0]):
        if without[i] > EXPLAINED_BY_BODY_M and _distance_of_ray(rays.rows, i, root) < reach:
            chosen[count] = i
            count += 1
    chosen = chosen[:count]
    left = without[chosen]
    return UnexplainedData(
        RayArrays(rays_at(rays, chosen).rows, np.ones(count)), ray_cost(left, COARSE_GATE_M), ray_cost(left, GATE_M)
    )


@njit(cache=True)
def _rays_without(rays, match, placed, own):
    """Return the separation (n,) of the rays from a body without some of its ``own`` (k,) bool capsules: those that
    were matched to one of them are matched anew."""
    separation, again = match.separation.copy(), np.flatnonzero(own[match.capsule])
    separation[again] = match_rays(rays_at(rays, again), placed, SLACK_M).separation
    return separation


@njit(cache=True)
def _distance_of_ray(rows, i, point):
    """Return the distance of a point from a ray's line."""
    across = rows[NORMAL, i] * point[0] + rows[NORMAL + 1, i] * point[1] + rows[NORMAL + 2, i] * point[2]
    along = rows[ALONG, i] * point[0] + rows[ALONG + 1, i] * point[1] + rows[ALONG + 2, i] * point[2]
    return math.hypot(across - rows[NORMAL + 3, i], along - rows[ALONG + 3, i])


@njit(cache=True)
def _is_of_limb(figure, limb):
    """Return which capsules (k,) bool are the limb's."""
    return (figure.surface.stick == limb.upper) | (figure.surface.stick == limb.lower)


@njit(cache=True)
def part_of(figure, limb, own):
    """Return the figure with the limb's surface alone (``own``), or with all but the limb's."""
    surface, rows = figure.surface, np.flatnonzero(_is_of_limb(figure, limb) == own)
    part = BodySurface(surface.stick[rows], surface.start[rows], surface.end[rows], surface.radii[rows])
    return Figure(figure.lengths, figure.origins, part)
