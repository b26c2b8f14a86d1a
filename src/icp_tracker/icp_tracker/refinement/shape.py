"""The unknowns of the refinement: the sizes of a body and how thick its limbs are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.body_surface import BodySurface, place_capsules
from stick_figure.least_squares.contour_factor import contour_weights, match_contour_rays
from stick_figure.least_squares.placed_figure import Figure
from stick_figure.least_squares.point_factor import CHAIN_COLUMNS, STICKS, TANGENT
from stick_figure.skeleton import STICK_AXIS, STICK_SIGN

from ..acquisition.body_sizes import SIZES, BodyEstimate, LimbGirths, body_of_sizes

THICK = ("upper_arm", "forearm", "thigh", "calf", "trunk")
UNKNOWNS = len(SIZES) + len(THICK)
SIZE = slice(0, len(SIZES))
THICKNESS = slice(len(SIZES), UNKNOWNS)
STEP = 1e-4  # of the differences that stand for derivatives, m and per unit


class ShapeDerivatives(NamedTuple):
    """How figure and flesh change with the unknowns.

    capsules (k, 8, UNKNOWNS) : start (3), end (3) in the stick's frame and both radii. origins (10, 3, UNKNOWNS) and
    lengths (10, UNKNOWNS) : the sticks'.
    """

    capsules: np.ndarray
    origins: np.ndarray
    lengths: np.ndarray


class ShapeModel:
    """Figure and flesh as functions of the unknowns (UNKNOWNS,): sizes in metres, thickness over the average.

    Linear about ``centre``. Sizes alone enter linearly; a thickness times a size is taken at the centre, which costs
    half a per cent of a radius where both are far off.
    """

    def __init__(self, centre: np.ndarray) -> None:
        self.centre = centre
        self._stick = BodySurface.of(body_of(centre)).stick
        self._parts, columns = _parts(centre), []
        for k in range(UNKNOWNS):
            values = centre.copy()
            values[k] += STEP
            columns.append([(there - here) / STEP for there, here in zip(_parts(values), self._parts, strict=True)])
        self.derivatives = ShapeDerivatives(
            *(np.ascontiguousarray(np.stack(part, axis=-1)) for part in zip(*columns, strict=True))
        )

    def at(self, values: np.ndarray) -> tuple[Figure, BodySurface]:
        """The figure and its flesh for other values."""
        step = values - self.centre
        capsules, origins, lengths = (a + d @ step for a, d in zip(self._parts, self.derivatives, strict=True))
        start, end, radii = (np.ascontiguousarray(capsules[:, a:b]) for a, b in ((0, 3), (3, 6), (6, 8)))
        return Figure(lengths, origins), BodySurface(self._stick, start, end, radii)


def body_of(values: np.ndarray) -> Body:
    """The stick figure of the unknowns' values (UNKNOWNS,)."""
    return body_of_sizes(values[SIZE])


def girths_of(values: np.ndarray) -> LimbGirths:
    """The thicknesses among the unknowns' values (UNKNOWNS,)."""
    return LimbGirths.of(dict(zip(THICK, values[THICKNESS].tolist(), strict=True)))


def _parts(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    body = body_of(values)
    figure, capsules = Figure.of(body), girths_of(values).on(BodySurface.of(body))
    return np.concatenate([capsules.start, capsules.end, capsules.radii], axis=1), figure.origins, figure.lengths


@dataclass(frozen=True, eq=False)
class ShapePrior:
    """What is known before: mean (UNKNOWNS,) and covariance (UNKNOWNS, UNKNOWNS) of the unknowns."""

    mean: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, estimate: BodyEstimate, thickness_sd: float) -> ShapePrior:
        """Sizes as the T-pose showed them, thickness as people have it."""
        covariance = np.diag(np.full(UNKNOWNS, thickness_sd**2))
        covariance[SIZE, SIZE] = estimate.covariance
        return cls(np.concatenate([estimate.sizes, np.ones(len(THICK))]), covariance)

    def clipped(self, values: np.ndarray, farthest_sd: float) -> np.ndarray:
        """The values, none farther from the mean than so many standard deviations."""
        reach = farthest_sd * np.sqrt(np.diag(self.covariance))
        return np.clip(values, self.mean - reach, self.mean + reach)


# --- What the rims of one pose say about the pose and the body's shape at once.
#
# A ray's distance from its capsule (rim_term.py) is linear in what a capsule consists of, start P, end Q and two radii:
#
#     e = n . (q - (1-u) P - u Q) - (1-u) r_P - u r_Q,    de = v . d(P, Q, r_P, r_Q),    v = -((1-u) n, u n, 1-u, u)
#
# so the rays of a capsule enter through sums w v v^T (8, 8) and w v e (8,), and the normal equations of any unknowns
# follow from the capsules' derivatives: H = sum_k M_k^T V_k M_k.

OF_CAPSULE = 8
_AXIS = np.array(STICK_AXIS, dtype=np.int64)
_SIGN = np.array(STICK_SIGN, dtype=np.float64)


@njit(cache=True)
def rim_system(contour_rays, t0, R0, RJ, hinges, figure, capsules, derivatives, robust, H, g):
    """Fill H (n, n) and g (n,), n = 24 + unknowns, such that H d = g lessens the distances; return the explained share.

    ``robust`` = gate, slack, misfit up to which a ray is explained, metres.
    """
    k, rays = capsules.stick.shape[0], contour_rays.information.shape[0]
    gate, slack, explained = robust
    G, axes = np.empty((STICKS, 3, 3)), np.empty((18, 3))
    A, B = np.empty((STICKS, 3)), np.empty((STICKS, 3))
    P, Q = np.empty((k, 3)), np.empty((k, 3))
    kernels.stick_frames(R0, RJ, hinges, G, axes)
    kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
    place_capsules(capsules, G, A, P, Q)
    match = (np.zeros(rays, np.int64), np.zeros(rays), np.empty(rays), np.empty(rays))
    weight = np.empty(rays)
    match_contour_rays(contour_rays, P, Q, capsules.radii, slack, match)
    contour_weights(match[3], contour_rays.information, gate, weight)
    V, b = np.zeros((k, OF_CAPSULE, OF_CAPSULE)), np.zeros((k, OF_CAPSULE))
    sum_over_capsules(contour_rays.normals, match, weight, V, b)
    M = np.zeros((k, OF_CAPSULE, H.shape[0]))
    pose_columns(capsules.stick, P, Q, t0, A, axes, M)
    shape_columns(capsules.stick, G, derivatives, M)
    gather(M, V, b, H, g)
    return np.sum(match[3] < explained) / max(rays, 1)


@njit(cache=True)
def sum_over_capsules(normals, match, weight, V, b):
    """Sums w v v^T into V (k, 8, 8) and w v e into b (k, 8)."""
    capsule, along, distance, _ = match
    v = np.empty(OF_CAPSULE)
    for i in range(capsule.shape[0]):
        k, u = capsule[i], along[i]
        for q in range(3):
            v[q], v[3 + q] = -(1.0 - u) * normals[q, i], -u * normals[q, i]
        v[6], v[7] = -(1.0 - u), -u
        for p in range(OF_CAPSULE):
            a = weight[i] * v[p]
            b[k, p] += a * distance[i]
            for q in range(OF_CAPSULE):
                V[k, p, q] += a * v[q]


@njit(cache=True)
def pose_columns(stick, P, Q, t0, A, axes, M):
    """Derivatives of the capsules' ends with respect to the pose's tangent, into M (k, 8, :24)."""
    J, slots = np.empty((3, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS, np.int64)
    for k in range(stick.shape[0]):
        for end in range(2):
            n = kernels.point_jacobian(stick[k], P[k] if end == 0 else Q[k], t0, A, axes, J, slots)
            for m in range(n):
                for i in range(3):
                    M[k, 3 * end + i, slots[m]] = J[i, m]


@njit(cache=True)
def shape_columns(stick, G, derivatives, M):
    """Derivatives of the capsules with respect to the shape's unknowns, into M (k, 8, 24:)."""
    unknowns = derivatives.lengths.shape[1]
    dA = np.zeros((STICKS, 3, unknowns))
    for j in range(STICKS):
        for i in range(3):
            for s in range(unknowns):
                if j < 6:  # starts on the torso
                    for q in range(3):
                        dA[j, i, s] += G[0, i, q] * derivatives.origins[j, q, s]
                else:  # starts where the upper limb ends
                    upper = j - 4
                    axis = G[upper, i, _AXIS[upper]] * _SIGN[upper]
                    dA[j, i, s] = dA[upper, i, s] + axis * derivatives.lengths[upper, s]
    for k in range(stick.shape[0]):
        j = stick[k]
        for s in range(unknowns):
            for i in range(3):
                for end in range(2):
                    change = dA[j, i, s]
                    for q in range(3):
                        change += G[j, i, q] * derivatives.capsules[k, 3 * end + q, s]
                    M[k, 3 * end + i, TANGENT + s] = change
            M[k, 6, TANGENT + s] = derivatives.capsules[k, 6, s]
            M[k, 7, TANGENT + s] = derivatives.capsules[k, 7, s]


@njit(cache=True)
def gather(M, V, b, H, g):
    """H = sum M^T V M and g = -sum M^T b over the capsules; most of a capsule's columns are empty."""
    n = H.shape[0]
    H[:] = 0.0
    g[:] = 0.0
    used, half = np.empty(n, np.int64), np.empty(OF_CAPSULE)
    for k in range(M.shape[0]):
        count = 0
        for c in range(n):
            for p in range(OF_CAPSULE):
                if M[k, p, c] != 0.0:
                    used[count] = c
                    count += 1
                    break
        for m in range(count):
            c = used[m]
            for q in range(OF_CAPSULE):
                half[q] = 0.0
                for p in range(OF_CAPSULE):
                    half[q] += M[k, p, c] * V[k, p, q]
            for p in range(OF_CAPSULE):
                g[c] -= M[k, p, c] * b[k, p]
            for d in range(m, count):
                total = 0.0
                for q in range(OF_CAPSULE):
                    total += half[q] * M[k, q, used[d]]
                H[c, used[d]] += total
                if d > m:
                    H[used[d], c] += total
