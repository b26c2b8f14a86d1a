"""The unknowns of the refinement: the sizes of a body and its build."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from capture_rig.kernel import njit
from stick_figure.body import BEND_NUMBERS, BUILD_NUMBERS, Body
from stick_figure.body_surface import BodySurface
from stick_figure.least_squares.contour_factor import bend_columns, match_rays, sum_rays
from stick_figure.least_squares.extremities import ANGLES, COUNT, extremity_of_capsule, turn_columns, turned_frame
from stick_figure.least_squares.normal_equations import (
    CHAIN_COLUMNS,
    TANGENT,
    WHOLE,
    add_whole_capsule,
    mirror_upper,
    no_sums,
    pose_columns,
)
from stick_figure.least_squares.posed_model import STICKS, BodyModel
from stick_figure.skeleton import STICK_AXIS, STICK_SIGN
from stick_figure.trunk_bend import BendDerivatives, bend_derivatives

from ..initialization.body_sizes import SIZES, BodyEstimate, body_of_sizes

UNKNOWNS = len(SIZES) + BUILD_NUMBERS
SIZE = slice(0, len(SIZES))
BUILD = slice(len(SIZES), UNKNOWNS)
BENT = TANGENT + BEND_NUMBERS
POSE = BENT + COUNT * ANGLES  # a keyframe's own unknowns: pose, the trunk's bend, turns of hands and feet
FARTHEST_SD = 3.0  # standard deviations of the prior to which sizes and bend are clipped
STEP = 1e-4  # of the finite differences, m and per unit


class ShapeDerivatives(NamedTuple):
    """Derivatives of the body's model with respect to the unknowns.

    capsules (k, 8, UNKNOWNS) : start (3), end (3) in the stick's frame and both radii. origins (10, 3, UNKNOWNS) and
    lengths (10, UNKNOWNS) : the sticks'.
    """

    capsules: np.ndarray
    origins: np.ndarray
    lengths: np.ndarray


class ShapeArrays(NamedTuple):
    """The body's model as a linear function of the unknowns (UNKNOWNS,), sizes in metres, build in standard deviations,
    about ``centre``; ``bends`` : derivatives by the trunk's bend. Sizes alone enter linearly; the product of build and
    size is taken at the centre, which costs half a per cent of a radius where both are far off.

    stick (k,) : that each capsule is fixed to. capsules (k, 8), origins (10, 3), lengths (10,) : as in the
    derivatives.
    """

    centre: np.ndarray
    stick: np.ndarray
    capsules: np.ndarray
    origins: np.ndarray
    lengths: np.ndarray
    derivatives: ShapeDerivatives
    bends: BendDerivatives

    @classmethod
    def of(cls, centre: np.ndarray) -> ShapeArrays:
        """Linearise the model about its unknowns' values (UNKNOWNS,)."""
        parts, columns = _parts(centre), []
        for k in range(UNKNOWNS):
            values = centre.copy()
            values[k] += STEP
            columns.append([(there - here) / STEP for there, here in zip(_parts(values), parts, strict=True)])
        stacked = (np.ascontiguousarray(np.stack(part, axis=-1)) for part in zip(*columns, strict=True))
        body = body_of(centre)
        stick, bends = BodySurface.of(body).stick, bend_derivatives(body)
        return cls(centre, stick, *parts, ShapeDerivatives(*stacked), bends)


@njit(cache=True)
def figure_at(model, values):
    """Return the model of a shape's values (UNKNOWNS,)."""
    step, by = values - model.centre, model.derivatives
    capsules = model.capsules + (by.capsules * step).sum(axis=2)
    start, end, radii = capsules[:, :3].copy(), capsules[:, 3:6].copy(), capsules[:, 6:].copy()
    lengths, origins = model.lengths + (by.lengths * step).sum(axis=1), model.origins + (by.origins * step).sum(axis=2)
    return BodyModel(lengths, origins, BodySurface(model.stick, start, end, radii))


def figure_change(model: ShapeArrays, values: np.ndarray, before: np.ndarray) -> float:
    """Return the largest difference, m, of two shapes: of a stick's length or start, of a capsule's end or radius."""
    return float(_largest_change(model, values, before))


@njit(cache=True)
def _largest_change(model, values, before):
    now, then = figure_at(model, values), figure_at(model, before)
    sticks = max(np.abs(now.lengths - then.lengths).max(), np.abs(now.origins - then.origins).max())
    starts = np.abs(now.surface.start - then.surface.start).max()
    ends = np.abs(now.surface.end - then.surface.end).max()
    return max(sticks, starts, ends, np.abs(now.surface.radii - then.surface.radii).max())


def body_of(values: np.ndarray) -> Body:
    """Return the stick figure of the unknowns' values (UNKNOWNS,)."""
    return replace(body_of_sizes(values[SIZE]), build=values[BUILD])


def _parts(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    body = body_of(values)
    surface = BodySurface.of(body)
    parts = np.concatenate([surface.start, surface.end, surface.radii], axis=1)
    return parts, body.stick_origins_torso, body.lengths


@dataclass(frozen=True, eq=False)
class ShapePrior:
    """Gaussian prior: mean (UNKNOWNS,) and covariance (UNKNOWNS, UNKNOWNS) of the unknowns."""

    mean: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, estimate: BodyEstimate) -> ShapePrior:
        """Return the prior of estimated sizes and an average build."""
        covariance = np.diag(np.ones(UNKNOWNS))
        covariance[SIZE, SIZE] = estimate.covariance
        return cls(np.concatenate([estimate.sizes, np.zeros(BUILD_NUMBERS)]), covariance)

    def clipped(self, values: np.ndarray) -> np.ndarray:
        """Return the values, none farther from the mean than FARTHEST_SD."""
        reach = FARTHEST_SD * np.sqrt(np.diag(self.covariance))
        return np.minimum(np.maximum(values, self.mean - reach), self.mean + reach)


# --- normal equations of the contour rays of one pose for pose and shape together

_AXIS = np.array(STICK_AXIS, dtype=np.int64)
_SIGN = np.array(STICK_SIGN, dtype=np.float64)


@njit(cache=True)
def contour_system(rays, posed, turns, model, robust, H, g):
    """Fill the normal equations H d = g of the rays' distances, n = POSE + unknowns; return the explained share.

    ``turns`` (4, 2) rad : of hands and feet in ``posed``. ``robust`` = gate, slack, separation up to which a ray is
    explained, metres.
    """
    gate, slack, explained = robust
    unknowns, match = H.shape[0] - POSE, match_rays(rays, posed, slack)
    sums = no_sums(posed.P.shape[0], WHOLE)
    sum_rays(rays, match, gate, sums)
    starts = start_columns(posed.G, model.derivatives)
    wide = CHAIN_COLUMNS + BEND_NUMBERS + ANGLES + unknowns
    M, slots = np.empty((2 * WHOLE, wide)), np.empty(wide, np.int64)
    work = np.empty((2 * WHOLE + 1, 2 * WHOLE))
    H[:] = 0.0
    g[:] = 0.0
    for k in range(posed.P.shape[0]):
        n = pose_columns(k, posed, M, slots)
        bend_columns(k, posed, model.bends, M[:, n:], WHOLE)
        for s in range(BEND_NUMBERS):
            slots[n + s] = TANGENT + s
        n += BEND_NUMBERS
        e = extremity_of_capsule(k)
        if e >= 0:
            turn_columns(e, posed, M[:, n:], WHOLE)
            for a in range(ANGLES):
                slots[n + a] = BENT + ANGLES * e + a
            n += ANGLES
        M[3, :n] = 0.0  # neither pose, bend nor turn changes a radius
        M[7, :n] = 0.0
        shape_columns(k, posed, turns, starts, model.derivatives, M[:, n:])
        add_whole_capsule(sums, k, M, slots, n, unknowns, work, H, g)
    mirror_upper(H)
    return np.sum(match.separation < explained) / max(match.separation.shape[0], 1)


@njit(cache=True)
def start_columns(G, derivatives):
    """Return the derivatives (10, 3, unknowns) of the sticks' starts, world, with respect to the shape's unknowns."""
    unknowns = derivatives.lengths.shape[1]
    starts = np.zeros((STICKS, 3, unknowns))
    for j in range(STICKS):
        for i in range(3):
            for s in range(unknowns):
                if j < 6:  # starts on the torso
                    for q in range(3):
                        starts[j, i, s] += G[0, i, q] * derivatives.origins[j, q, s]
                else:  # starts where the upper limb ends
                    upper = j - 4
                    axis = G[upper, i, _AXIS[upper]] * _SIGN[upper]
                    starts[j, i, s] = starts[upper, i, s] + axis * derivatives.lengths[upper, s]
    return starts


@njit(cache=True)
def shape_columns(k, posed, turns, starts, derivatives, M):
    """Fill M (8, unknowns) with the derivatives of capsule k with respect to the shape's unknowns.

    Beyond a wrist or an ankle they are taken in the turned frame.
    """
    j, e = posed.surface.stick[k], extremity_of_capsule(k)
    G, E = posed.G[j], posed.G[j]
    if e >= 0:
        E = turned_frame(e, posed, turns)
    for s in range(starts.shape[2]):
        for end in range(2):
            for i in range(3):
                change = starts[j, i, s]
                for q in range(3):
                    number, pivot = derivatives.capsules[k, 3 * end + q, s], 0.0
                    if e >= 2:
                        pivot = _SIGN[j] * derivatives.lengths[j, s] if q == _AXIS[j] else 0.0
                    elif e >= 0:
                        pivot = derivatives.capsules[k, q, s]
                    change += G[i, q] * pivot + E[i, q] * (number - pivot)
                M[WHOLE * end + i, s] = change
            M[WHOLE * end + 3, s] = derivatives.capsules[k, 6 + end, s]
