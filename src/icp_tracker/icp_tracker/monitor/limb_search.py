"""Other places for one limb: every pose of its library against the rays that the rest of the body leaves over."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from capture_rig.small_matrices import solve_positive
from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.body_surface import BodySurface
from stick_figure.least_squares.contour_factor import match_contour_rays
from stick_figure.least_squares.gauss_newton import ContourArrays
from stick_figure.least_squares.placed_figure import Figure, State
from stick_figure.pose import Pose

from .evidence import GATE_M, SLACK_M, place, ray_cost
from .pose_library import Limb, LimbPoses

# --- The hull as a coarse map of cells, so that hundreds of poses can be asked whether they lie in it.

CELL_M = 0.05  # a cell and its neighbours count as hull: within 0.05 to 0.1 m of a sample


class HullMap(NamedTuple):
    """low (3,) m: corner of the first cell, world; cells (x, y, z) bool: hull here or in a neighbouring cell."""

    low: np.ndarray
    cells: np.ndarray

    @staticmethod
    def of(samples_world: np.ndarray) -> HullMap:
        """The map of samples (m, 3) of the hull, m > 0."""
        low = samples_world.min(axis=0) - 2.0 * CELL_M
        size = np.ceil((samples_world.max(axis=0) - low) / CELL_M).astype(int) + 2
        cells = np.zeros(size, np.bool_)
        _mark(samples_world, low, cells)
        return HullMap(low, cells)


@njit(cache=True)
def _mark(samples, low, cells):
    for n in range(samples.shape[0]):
        i = int((samples[n, 0] - low[0]) / CELL_M)
        j = int((samples[n, 1] - low[1]) / CELL_M)
        k = int((samples[n, 2] - low[2]) / CELL_M)
        cells[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2] = True


@njit(cache=True)
def in_hull(low, cells, x, y, z):
    """Whether a point lies in a cell of hull."""
    a, b, c = (x - low[0]) / CELL_M, (y - low[1]) / CELL_M, (z - low[2]) / CELL_M
    if a < 0.0 or b < 0.0 or c < 0.0 or a >= cells.shape[0] or b >= cells.shape[1] or c >= cells.shape[2]:
        return False
    return cells[int(a), int(b), int(c)]


# --- A limb moved to where the rays are: Gauss-Newton over its four joint angles alone, a few iterations a guess.

ITERATIONS = 4
ANGLES = 4  # three of the ball joint, one of the hinge
LIMB_GATE_M = 0.08
STIFFNESS_M2 = 2.0 * 0.3**2  # rays that hold an angle at its guess, times their lever squared
STEP_MOST = 0.4  # rad
HELD_AT = (0.5, 1.0)  # where along upper and lower limb the hull is asked
HELD_LEAST = 3  # of those four points, that must lie in the hull


@njit(cache=True)
def refine_limb(R0, shoulder, own, upper, lengths, is_arm, contour_rays, R, flexion, room):
    """Move R (3, 3), upper limb to torso, and ``flexion`` toward the rays, in place; returns the flexion.

    ``own`` flesh of the limb; lengths (2,) m of its sticks; room = match, frames, elbow, P, Q: arrays to work in.
    """
    match, frames, ends, P, Q = room
    H, g, L, step = np.empty((ANGLES, ANGLES)), np.empty(ANGLES), np.empty((ANGLES, ANGLES)), np.empty(ANGLES)
    row, E, T = np.empty(ANGLES), np.empty((3, 3)), np.empty((3, 3))
    for _ in range(ITERATIONS):
        place_limb(R0, R, flexion, is_arm, shoulder, lengths, own, upper, frames, ends, P, Q)
        match_contour_rays(contour_rays, P, Q, own.radii, SLACK_M, match)
        H[:], g[:] = 0.0, 0.0
        for a in range(ANGLES):
            H[a, a] = STIFFNESS_M2
        _add_rays(contour_rays, own, upper, match, R0, frames, shoulder, ends, is_arm, P, Q, row, H, g)
        solve_positive(H, g, L, step)
        size = max(np.abs(step).max(), 1e-12)
        scale = min(1.0, STEP_MOST / size)
        kernels.rotation_exp(scale * step[0], scale * step[1], scale * step[2], E)
        T[:] = R
        for i in range(3):
            for j in range(3):
                R[i, j] = E[i, 0] * T[0, j] + E[i, 1] * T[1, j] + E[i, 2] * T[2, j]
        flexion += scale * step[3]
    place_limb(R0, R, flexion, is_arm, shoulder, lengths, own, upper, frames, ends, P, Q)
    match_contour_rays(contour_rays, P, Q, own.radii, SLACK_M, match)
    return flexion


@njit(cache=True)
def _add_rays(contour_rays, own, upper, match, R0, frames, shoulder, ends, is_arm, P, Q, row, H, g):
    """The rays' part of the normal equations: how each one's distance to its capsule changes with the four angles."""
    capsule, along, distance, separation = match
    hinge = 2 if is_arm else 1
    for i in range(capsule.shape[0]):
        k, u = capsule[i], along[i]
        ratio = 1.0 + (separation[i] / LIMB_GATE_M) ** 2
        w = 1.0 / (ratio * ratio)
        n0, n1, n2 = contour_rays.normals[0, i], contour_rays.normals[1, i], contour_rays.normals[2, i]
        c0 = P[k, 0] + u * (Q[k, 0] - P[k, 0])
        c1 = P[k, 1] + u * (Q[k, 1] - P[k, 1])
        c2 = P[k, 2] + u * (Q[k, 2] - P[k, 2])
        r0, r1, r2 = c0 - shoulder[0], c1 - shoulder[1], c2 - shoulder[2]
        # n . (a x r) = a . (r x n)
        t0, t1, t2 = r1 * n2 - r2 * n1, r2 * n0 - r0 * n2, r0 * n1 - r1 * n0
        for a in range(3):
            row[a] = R0[0, a] * t0 + R0[1, a] * t1 + R0[2, a] * t2
        row[3] = 0.0
        if own.stick[k] != upper:
            r0, r1, r2 = c0 - ends[0, 0], c1 - ends[0, 1], c2 - ends[0, 2]
            t0, t1, t2 = r1 * n2 - r2 * n1, r2 * n0 - r0 * n2, r0 * n1 - r1 * n0
            row[3] = frames[0, 0, hinge] * t0 + frames[0, 1, hinge] * t1 + frames[0, 2, hinge] * t2
        for a in range(ANGLES):
            g[a] += w * row[a] * distance[i]
            for b in range(ANGLES):
                H[a, b] += w * row[a] * row[b]


@njit(cache=True)
def place_limb(R0, R, flexion, is_arm, shoulder, lengths, own, upper, frames, ends, P, Q):
    """Frames (2, 3, 3) and ends (2, 3) of upper and lower limb and its capsules' ends P, Q (k, 3), all in the world.

    The elbow turns about the upper arm's z, the knee about the thigh's y; arms lie along +y, legs along -z.
    """
    c, s = np.cos(flexion), np.sin(flexion)
    for i in range(3):
        for j in range(3):
            frames[0, i, j] = R0[i, 0] * R[0, j] + R0[i, 1] * R[1, j] + R0[i, 2] * R[2, j]
    for i in range(3):
        x, y, z = frames[0, i, 0], frames[0, i, 1], frames[0, i, 2]
        if is_arm:
            frames[1, i, 0], frames[1, i, 1], frames[1, i, 2] = c * x + s * y, c * y - s * x, z
        else:
            frames[1, i, 0], frames[1, i, 1], frames[1, i, 2] = c * x - s * z, y, s * x + c * z
    axis, sign = (1, 1.0) if is_arm else (2, -1.0)
    for i in range(3):
        ends[0, i] = shoulder[i] + sign * lengths[0] * frames[0, i, axis]
        ends[1, i] = ends[0, i] + sign * lengths[1] * frames[1, i, axis]
    for k in range(own.stick.shape[0]):
        first = own.stick[k] == upper
        for i in range(3):
            origin = shoulder[i] if first else ends[0, i]
            P[k, i], Q[k, i] = origin, origin
            for j in range(3):
                a = frames[0, i, j] if first else frames[1, i, j]
                P[k, i] += a * own.start[k, j]
                Q[k, i] += a * own.end[k, j]


@njit(cache=True)
def rays_gained(separation, without, gate):
    """Rays that the limb explains: what each (n,) costs ``without`` it, less what it costs with it."""
    gain = 0.0
    for i in range(separation.shape[0]):
        gain += max(ray_cost(without[i], gate) - ray_cost(separation[i], gate), 0.0)
    return gain


@njit(cache=True)
def is_held(shoulder, ends, hull):
    """Whether the hull holds the limb."""
    held = 0
    for s in range(2):
        for u in HELD_AT:
            x = shoulder[0] if s == 0 else ends[0, 0]
            y = shoulder[1] if s == 0 else ends[0, 1]
            z = shoulder[2] if s == 0 else ends[0, 2]
            held += in_hull(
                hull.low, hull.cells, x + u * (ends[s, 0] - x), y + u * (ends[s, 1] - y), z + u * (ends[s, 2] - z)
            )
    return held >= HELD_LEAST


COARSE_GATE_M = 0.12  # the library is coarse: an elbow may be 80 mm off
OPEN_M = 0.03  # a ray that the rest of the body passes so near has no need of the limb
APART_M = 0.12  # hands or feet (and elbows or knees) so near to each other are the same place
REFINED = 6  # of the library, the poses that are looked at more closely
LEAST_MARGIN = (
    -4.0
)  # rays that another place must explain more than this one, to be worth a fit (which finds some more)


def other_place(
    body: Body,
    capsules: BodySurface,
    pose: Pose,
    limb: Limb,
    library: LimbPoses,
    contour_rays: ContourArrays,
    hull: HullMap,
) -> Pose | None:
    """The best pose that differs from ``pose`` in one limb alone and puts it elsewhere, if it may explain more."""
    mine = (capsules.stick == limb.upper) | (capsules.stick == limb.lower)
    rest, own = _chosen(capsules, ~mine), _chosen(capsules, mine)
    figure = Figure.of(body)
    R, flexion = pose.R_joints[limb.ball].copy(), np.array([pose.hinges[limb.hinge]])
    margin = _search(
        *State.of(pose),
        figure,
        rest,
        own,
        limb.upper,
        figure.lengths[[limb.upper, limb.lower]],
        limb.is_arm,
        library.R,
        library.flexion,
        contour_rays,
        hull,
        R,
        flexion,
    )
    return None if margin < LEAST_MARGIN else with_limb(pose, limb, R, float(flexion[0]))


def with_limb(pose: Pose, limb: Limb, R: np.ndarray, flexion: float) -> Pose:
    """The pose with one limb elsewhere: upper limb to torso ``R``, hinge ``flexion`` (rad)."""
    R_joints, hinges = pose.R_joints.copy(), pose.hinges.copy()
    R_joints[limb.ball], hinges[limb.hinge] = R, flexion
    return replace(pose, R_joints=R_joints, hinges=hinges)


def _chosen(capsules: BodySurface, rows: np.ndarray) -> BodySurface:
    return BodySurface(*(np.ascontiguousarray(part[rows]) for part in capsules))


@njit(cache=True)
def _search(
    t0, R0, RJ, hinges, figure, rest, own, upper, lengths, is_arm, tried_R, tried, contour_rays, hull, R, flexion
):
    """The best of the library that lies elsewhere, refined, into R (3, 3) and flexion (1,), which hold the limb's own.

    Returns the rays that it explains beyond those that the limb explains now; -inf when there is none.
    """
    A, left_over, without = _without_limb(t0, R0, RJ, hinges, figure, rest, contour_rays, upper, lengths)
    shoulder, m, k = A[upper], without.shape[0], own.stick.shape[0]
    match = (np.zeros(m, np.int64), np.zeros(m), np.empty(m), np.empty(m))
    frames, ends, P, Q = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty((k, 3)), np.empty((k, 3))
    place_limb(R0, R, flexion[0], is_arm, shoulder, lengths, own, upper, frames, ends, P, Q)
    match_contour_rays(left_over, P, Q, own.radii, SLACK_M, match)
    now, gain_now = ends.copy(), rays_gained(match[3], without, GATE_M)
    gains = np.zeros(tried.shape[0])
    for h in range(tried.shape[0]):
        place_limb(R0, tried_R[h], tried[h], is_arm, shoulder, lengths, own, upper, frames, ends, P, Q)
        if is_held(shoulder, ends, hull):
            match_contour_rays(left_over, P, Q, own.radii, SLACK_M, match)
            gains[h] = rays_gained(match[3], without, COARSE_GATE_M)
    best = -np.inf
    for h in np.argsort(-gains)[:REFINED]:
        if gains[h] <= 0.0:
            break
        turned = tried_R[h].copy()
        bent = refine_limb(
            R0, shoulder, own, upper, lengths, is_arm, left_over, turned, tried[h], (match, frames, ends, P, Q)
        )
        gain = rays_gained(match[3], without, GATE_M)
        if gain > best and is_held(shoulder, ends, hull) and _apart(ends, now):
            best, flexion[0] = gain, bent
            R[:] = turned
    return best - gain_now


@njit(cache=True)
def _apart(ends, others):
    """Whether two limbs' ends (2, 3) are in different places."""
    first, second = 0.0, 0.0
    for i in range(3):
        first += (ends[0, i] - others[0, i]) ** 2
        second += (ends[1, i] - others[1, i]) ** 2
    return max(first, second) > APART_M**2


@njit(cache=True)
def _without_limb(t0, R0, RJ, hinges, figure, rest, contour_rays, upper, lengths):
    """Stick starts (10, 3), the rays that the limb could touch and the rest of the body leaves over, and how far that
    rest passes from each."""
    k, n = rest.stick.shape[0], contour_rays.information.shape[0]
    A, B, P, Q = np.empty((10, 3)), np.empty((10, 3)), np.empty((k, 3)), np.empty((k, 3))
    place(t0, R0, RJ, hinges, figure, rest, A, B, P, Q)
    separation = np.empty(n)
    match_contour_rays(
        contour_rays, P, Q, rest.radii, SLACK_M, (np.zeros(n, np.int64), np.zeros(n), np.empty(n), separation)
    )
    rows, count = np.empty(n, np.int64), 0
    reach = lengths[0] + lengths[1] + COARSE_GATE_M
    for i in range(n):
        squared, along = 0.0, 0.0
        for q in range(3):
            d = A[upper, q] - contour_rays.points[q, i]
            squared += d * d
            along += d * contour_rays.directions[q, i]
        if separation[i] > OPEN_M and squared - along * along < reach * reach:
            rows[count] = i
            count += 1
    rows = rows[:count]
    left_over = ContourArrays(
        np.ascontiguousarray(contour_rays.points[:, rows]),
        np.ascontiguousarray(contour_rays.directions[:, rows]),
        np.ascontiguousarray(contour_rays.normals[:, rows]),
        np.ascontiguousarray(contour_rays.tangents[:, rows]),
        contour_rays.half_lengths[rows],
        contour_rays.information[rows],
    )
    return A, left_over, separation[rows]
