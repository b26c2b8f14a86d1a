"""A limb moved to where the rays are: Gauss-Newton over its four joint angles alone, a few iterations a guess."""

from __future__ import annotations

import numpy as np
from numba import njit

from stick_figure import kernels

from ..rim_term import match_rims
from ..small_algebra import solve_positive
from .evidence import SLACK_M, ray_cost
from .hull_map import in_hull

ITERATIONS = 4
ANGLES = 4  # three of the ball joint, one of the hinge
GATE_M = 0.08
STIFFNESS_M2 = 2.0 * 0.3**2  # rays that hold an angle at its guess, times their lever squared
STEP_MOST = 0.4  # rad
HELD_AT = (0.5, 1.0)  # where along upper and lower limb the hull is asked
HELD_LEAST = 3  # of those four points, that must lie in the hull


@njit(cache=True)
def refine_limb(R0, shoulder, own, upper, lengths, is_arm, rims, R, flexion, room):
    """Move R (3, 3), upper limb to torso, and ``flexion`` toward the rays, in place; returns the flexion.

    ``own`` flesh of the limb; lengths (2,) m of its sticks; room = match, frames, elbow, P, Q: arrays to work in.
    """
    match, frames, ends, P, Q = room
    H, g, L, step = np.empty((ANGLES, ANGLES)), np.empty(ANGLES), np.empty((ANGLES, ANGLES)), np.empty(ANGLES)
    row, E, T = np.empty(ANGLES), np.empty((3, 3)), np.empty((3, 3))
    for _ in range(ITERATIONS):
        place_limb(R0, R, flexion, is_arm, shoulder, lengths, own, upper, frames, ends, P, Q)
        match_rims(rims, P, Q, own.radii, SLACK_M, match)
        H[:], g[:] = 0.0, 0.0
        for a in range(ANGLES):
            H[a, a] = STIFFNESS_M2
        _add_rays(rims, own, upper, match, R0, frames, shoulder, ends, is_arm, P, Q, row, H, g)
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
    match_rims(rims, P, Q, own.radii, SLACK_M, match)
    return flexion


@njit(cache=True)
def _add_rays(rims, own, upper, match, R0, frames, shoulder, ends, is_arm, P, Q, row, H, g):
    """The rays' part of the normal equations: how each one's distance to its capsule changes with the four angles."""
    capsule, along, distance, misfit = match
    hinge = 2 if is_arm else 1
    for i in range(capsule.shape[0]):
        k, u = capsule[i], along[i]
        ratio = 1.0 + (misfit[i] / GATE_M) ** 2
        w = 1.0 / (ratio * ratio)
        n0, n1, n2 = rims.normals[0, i], rims.normals[1, i], rims.normals[2, i]
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
def rays_gained(misfit, without, gate):
    """Rays that the limb explains: what each (n,) costs ``without`` it, less what it costs with it."""
    gain = 0.0
    for i in range(misfit.shape[0]):
        gain += max(ray_cost(without[i], gate) - ray_cost(misfit[i], gate), 0.0)
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
