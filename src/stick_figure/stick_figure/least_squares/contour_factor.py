"""Contour rays against the body: every ray along a silhouette's outline touches the body's surface.

A visual hull of few cameras is much wider than the body, and its surface and centerline with it. The rays that bound
it are not: each one touches the body's own surface, to a fraction of a pixel, at a place along it that only the figure
determines (contour generators: Kutulakos & Seitz, IJCV 2000; "bounding edges": Cheung, Baker & Kanade, CVPR 2003).
So the residual is the distance between ray and surface, along the outline's normal:

    e = n . (q - c) - r,    c on a capsule's axis and q on the ray, where they pass each other nearest

which is zero when the capsule of radius r shows its own outline there. The ray belongs to the capsule that explains it
best: nearest across the ray, on the right side of it, and not outside the stretch where the ray touches the hull.

The trunk's bend (`trunk_bend`) is solved for about a fit that has converged. Its seven numbers and the pose explain the
same rays, so their equations are solved as one; the pose's part of the step is left to the next fit, which starts with
the new bend. Rays of hands and feet, which turn by themselves, are left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.small_matrices import robust_weight, solve_positive

from ..body import BEND_NUMBERS
from ..body_surface import CAPSULES, BodySurface
from .extremities import CAPSULE as CAPSULE_OF_EXTREMITY
from .extremities import COUNT, STIFF, add_extremity
from .normal_equations import (
    CHAIN_COLUMNS,
    ENDS,
    add_capsule,
    add_pose_sums,
    add_to_sums,
    mirror_upper,
    no_sums,
    pose_columns,
)
from .normal_equations import TANGENT as POSE
from .posed_model import BodyModel, place

NORMAL, TANGENT, DIRECTION = 0, 4, 8  # rows of three coordinates each, followed by their offset
HALF_LENGTH, ROWS = 12, 13
CAPSULE, ALONG, DISTANCE, SEPARATION = range(4)
IS_EXTREMITY = np.isin(np.arange(CAPSULES), CAPSULE_OF_EXTREMITY)  # which capsules are hands and feet
POSE_AND_BEND = POSE + BEND_NUMBERS
SURFACE_GATE_M = 0.06  # of a ray or a voxel from the body's surface, at which its weight has fallen to 1/4
SLACK_M = 0.05  # the body may touch a ray this far from the stretch where the ray touches the hull
PARALLEL_M2 = 1e-12  # keeps an axis that the ray sees as a point from dividing by zero


class RayArrays(NamedTuple):
    """Contour rays (n), laid out for the matching kernel.

    rows (13, n) : unit normal across the outline, tangent = normal x direction along it, and direction of each ray,
    each with its scalar product with the ray's middle (m); last half the length (m) of the stretch where the ray
    touches the hull. information (n,) : 1/m^2.
    """

    rows: np.ndarray
    information: np.ndarray

    @staticmethod
    def of(
        points: np.ndarray,
        directions: np.ndarray,
        normals: np.ndarray,
        half_lengths: np.ndarray,
        information: np.ndarray,
    ) -> RayArrays:
        """Lay out rays given by their middles, unit directions and normals (n, 3), world frame, metres."""
        rows, columns = np.empty((ROWS, len(information))), (points, directions, normals, half_lengths)
        _lay_out(*(np.ascontiguousarray(column, np.float64) for column in columns), rows)
        return RayArrays(rows, np.ascontiguousarray(information, dtype=np.float64))

    def chosen(self, which: np.ndarray, information: np.ndarray) -> RayArrays:
        """Return some of the rays, by index or mask, with other information."""
        return RayArrays(np.ascontiguousarray(self.rows[:, which]), information)


@njit(cache=True, nogil=True)
def _lay_out(points, directions, normals, half_lengths, rows):
    """Fill the ``rows`` (13, n) of :class:`RayArrays`."""
    for i in range(rows.shape[1]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d0, d1, d2 = directions[i, 0], directions[i, 1], directions[i, 2]
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        t0, t1, t2 = n1 * d2 - n2 * d1, n2 * d0 - n0 * d2, n0 * d1 - n1 * d0
        for first, (a, b, c) in ((NORMAL, (n0, n1, n2)), (TANGENT, (t0, t1, t2)), (DIRECTION, (d0, d1, d2))):
            rows[first, i], rows[first + 1, i], rows[first + 2, i] = a, b, c
            rows[first + 3, i] = a * x + b * y + c * z
        rows[HALF_LENGTH, i] = half_lengths[i]


@njit(cache=True)
def rays_at(rays, rows):
    """Return the rays of some rows (m,), by number."""
    chosen = np.empty((ROWS, rows.shape[0]))
    for k in range(ROWS):
        chosen[k] = rays.rows[k][rows]
    return RayArrays(chosen, rays.information[rows])


class RayMatch(NamedTuple):
    """The capsule (n,) that explains each ray, the place along its axis (n,), the residual ``distance`` e (n,) m, and
    the ``separation`` (n,) m: e with the gaps along the outline and beyond the stretch where the ray may touch."""

    capsule: np.ndarray
    along: np.ndarray
    distance: np.ndarray
    separation: np.ndarray


@njit(cache=True)
def match_at(match, rows):
    """Return the match of some rays (m,), by number."""
    return RayMatch(match.capsule[rows], match.along[rows], match.distance[rows], match.separation[rows])


@njit(cache=True)
def add_contour(rays, match, posed, gate, ends, H, g):
    """Add the distances of all rays from their matched capsules to upper H and g, Geman-McClure with a ``gate`` (m),
    the turns of hands and feet eliminated."""
    if rays.information.shape[0] == 0:
        return
    sums = no_sums(posed.P.shape[0], ENDS)
    sum_rays(rays, match, gate, sums)
    _add_extremities(sums, posed, ends, H, g)
    add_pose_sums(sums, posed, H, g)


@njit(cache=True)
def linearise_extremities(rays, match, posed, ends):
    """Linearise the turns of hands and feet about the rays matched to them, the pose held."""
    own = np.flatnonzero(IS_EXTREMITY[match.capsule])
    sums = no_sums(posed.P.shape[0], ENDS)
    sum_rays(rays_at(rays, own), match_at(match, own), SURFACE_GATE_M, sums)
    _add_extremities(sums, posed, ends, np.zeros((POSE, POSE)), np.zeros(POSE))


@njit(cache=True)
def _add_extremities(sums, posed, ends, H, g):
    """Add the sums of hands and feet, their turns eliminated, and clear these sums."""
    for e in range(COUNT):
        add_extremity(sums, e, posed, ends, H, g)
        sums.pulls[CAPSULE_OF_EXTREMITY[e]] = 0.0


@njit(cache=True, error_model="numpy")
def sum_rays(rays, match, gate, sums):
    """Add the rays' residuals to the sums of their capsules, with Geman-McClure weights."""
    weight = np.empty(match.separation.shape[0])
    for i in range(weight.shape[0]):
        weight[i] = robust_weight(rays.information[i], (match.separation[i] / gate) ** 2)
    add_to_sums(sums, match.capsule, match.along, rays.rows[NORMAL : NORMAL + 3], weight, match.distance)


@njit(cache=True, nogil=True)
def match_rays(rays, posed, slack):
    """Find the capsule that explains each ray best; ``slack`` (m) lengthens the stretch where a ray may touch."""
    return ray_match(best_of_all(rays, posed, slack))


@njit(cache=True)
def best_of_all(rays, posed, slack):
    """Offer all capsules; returns the best (4, n)."""
    best = no_match(rays)
    offer_capsules(np.arange(posed.P.shape[0]), rays, posed, slack, best)
    return best


@njit(cache=True)
def match_turned(rays, posed, slack, stiff):
    """Match the rays by the best (4, n) of the ``stiff`` capsules and by hands and feet, which have turned since."""
    best = stiff.copy()
    offer_capsules(CAPSULE_OF_EXTREMITY, rays, posed, slack, best)
    return ray_match(best)


@njit(cache=True)
def best_of_stiff(rays, posed, slack, best):
    """Return the best (4, n) of all capsules but hands and feet, from the best of all: only rays of these change."""
    stiff, own = best.copy(), np.flatnonzero(IS_EXTREMITY[best[CAPSULE].astype(np.int64)])
    rays_of_extremities = rays_at(rays, own)
    others = no_match(rays_of_extremities)
    offer_capsules(STIFF, rays_of_extremities, posed, slack, others)
    for i in range(own.shape[0]):
        stiff[:, own[i]] = others[:, i]
    return stiff


@njit(cache=True)
def no_match(rays):
    """Return the empty best (4, n) of rays: capsule, place along it, distance and infinite squared separation."""
    best = np.zeros((4, rays.rows.shape[1]))
    best[SEPARATION] = np.inf
    return best


@njit(cache=True)
def offer_capsules(chosen, rays, posed, slack, best):
    """Offer some capsules to all rays, in place."""
    radii = posed.surface.radii
    for k in chosen:
        match_capsule(k, posed.P[k], posed.Q[k], radii[k, 0], radii[k, 1] - radii[k, 0], slack, rays.rows, best)


@njit(cache=True)
def ray_match(best):
    """Return the match of the best capsules that were offered."""
    capsule, separation = np.empty(best.shape[1], np.int64), np.empty(best.shape[1])
    for i in range(capsule.shape[0]):
        capsule[i], separation[i] = int(best[CAPSULE, i]), np.sqrt(best[SEPARATION, i])
    return RayMatch(capsule, best[ALONG], best[DISTANCE], separation)


@kernel
def match_capsule(k, start, end, r0, dr, slack, rows, best):
    """Offer one capsule to all rays. ``rows`` (13, n) is read, ``best`` (4, n) improved: of more arrays the compiler
    could not prove that they do not overlap."""
    P0, P1, P2 = start[0], start[1], start[2]
    s0, s1, s2 = end[0] - P0, end[1] - P1, end[2] - P2
    number = float(k)
    for i in range(rows.shape[1]):
        # the axis as the ray sees it: across the outline (a, p), along it (b, q), in depth (c, s)
        a = rows[0, i] * P0 + rows[1, i] * P1 + rows[2, i] * P2 - rows[3, i]
        b = rows[4, i] * P0 + rows[5, i] * P1 + rows[6, i] * P2 - rows[7, i]
        c = rows[8, i] * P0 + rows[9, i] * P1 + rows[10, i] * P2 - rows[11, i]
        p = rows[0, i] * s0 + rows[1, i] * s1 + rows[2, i] * s2
        q = rows[4, i] * s0 + rows[5, i] * s1 + rows[6, i] * s2
        s = rows[8, i] * s0 + rows[9, i] * s1 + rows[10, i] * s2
        u = -(a * p + b * q) / (p * p + q * q + PARALLEL_M2)
        u = u if u > 0.0 else 0.0
        u = u if u < 1.0 else 1.0
        across = -(a + u * p) - (r0 + u * dr)
        aside = b + u * q
        depth = abs(c + u * s) - (rows[HALF_LENGTH, i] + slack)
        depth = depth if depth > 0.0 else 0.0
        squared = across * across + aside * aside + depth * depth
        better = squared < best[SEPARATION, i]
        best[CAPSULE, i] = number if better else best[CAPSULE, i]
        best[ALONG, i] = u if better else best[ALONG, i]
        best[DISTANCE, i] = across if better else best[DISTANCE, i]
        best[SEPARATION, i] = squared if better else best[SEPARATION, i]


# --- the trunk's bend


@njit(cache=True, nogil=True)
def bend_step(rays, match, state, figure, derivatives, pose_information, information, pull):
    """Return the Gauss-Newton step (7,) of the bend on the rays' distances from their matched capsules.

    pose_information (24,) holds the pose where it is; information (7,) and pull (7,) are the prior's of the bend.
    """
    H, g = np.zeros((POSE_AND_BEND, POSE_AND_BEND)), np.zeros(POSE_AND_BEND)
    posed = place(state, figure)
    sums = no_sums(posed.P.shape[0], ENDS)
    sum_rays(rays, match, SURFACE_GATE_M, sums)
    for k in CAPSULE_OF_EXTREMITY:
        sums.pulls[k] = 0.0
    wide = CHAIN_COLUMNS + BEND_NUMBERS
    M, slots = np.empty((2 * ENDS, wide)), np.empty(wide, np.int64)
    work = np.empty((2 * ENDS + 1, 2 * ENDS))
    for k in range(posed.P.shape[0]):
        if sums.pulls[k].any():
            n = pose_columns(k, posed, M, slots)
            bend_columns(k, posed, derivatives, M[:, n:], ENDS)
            for s in range(BEND_NUMBERS):
                slots[n + s] = POSE + s
            add_capsule(sums, k, M, slots, n + BEND_NUMBERS, work, H, g)
    mirror_upper(H)
    for i in range(POSE):
        H[i, i] += pose_information[i]
    for s in range(BEND_NUMBERS):
        H[POSE + s, POSE + s] += information[s]
        g[POSE + s] += pull[s]
    L, step = np.empty_like(H), np.empty(POSE_AND_BEND)
    solve_positive(H, g, L, step)
    return step[POSE:].copy()


@kernel
def bend_columns(k, posed, derivatives, M, second):
    """Fill M (6 or 8, 7 or more) with the derivatives of capsule k's ends, world, with respect to the bend; those of
    its end begin at row ``second``."""
    j = posed.surface.stick[k]
    origin = j if j < 6 else j - 4  # the stick on the torso that carries it
    for s in range(BEND_NUMBERS):
        for i in range(3):
            start, end = 0.0, 0.0
            for q in range(3):
                turned = posed.R0[i, q]
                start += turned * (derivatives.origins[origin, q, s] + derivatives.starts[k, q, s])
                end += turned * (derivatives.origins[origin, q, s] + derivatives.ends[k, q, s])
            M[i, s], M[second + i, s] = start, end


@njit(cache=True)
def bent_figure(figure, derivatives, bend):
    """Return a model with the ``bend`` (7,) of its trunk."""
    origins = figure.origins + (derivatives.origins * bend).sum(axis=2)
    start = figure.surface.start + (derivatives.starts * bend).sum(axis=2)
    end = figure.surface.end + (derivatives.ends * bend).sum(axis=2)
    return BodyModel(figure.lengths, origins, BodySurface(figure.surface.stick, start, end, figure.surface.radii))
