"""Compiled kinematics shared by every solver: plain arrays in, plain arrays filled.

State arrays: t0 (3,) torso centre in the world, R0 (3, 3) torso to world, RJ (5, 3, 3) rotations of neck, left and
right shoulder, left and right hip (stick to torso), hinges (4,) left and right elbow, left and right knee, rad.
Body arrays: lengths (10,) full stick lengths, origins (10, 3) start of each stick that begins on the torso, torso
frame. All arrays are float64 and C-contiguous. Nothing here allocates per point, and no fast-math is used, so equal
inputs give equal bytes.

Tangent (24,): torso translation (world); torso rotation increment, world frame, R0 <- exp(d) R0; ball joints in the
TORSO frame, R <- exp(d) R; hinges as scalars. Slots are named by `skeleton.TANGENT_NAMES`. The neck has two degrees
of freedom: its z slot does not exist and its rotation is always kept in the form Rx Ry.
"""

from __future__ import annotations

import math

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.rigid import matmul3, rotation_log, turn

STEP_LIMIT = 0.5  # m, rad: largest component of a step within which linearisations hold; judgement
CHAIN = np.array(
    [
        [-1, -1, -1, -1],
        [6, 7, -1, -1],
        [8, 10, 12, -1],
        [9, 11, 13, -1],
        [16, 18, 22, -1],
        [17, 19, 23, -1],
        [8, 10, 12, 14],
        [9, 11, 13, 15],
        [16, 18, 22, 20],
        [17, 19, 23, 21],
    ]
)
"""(10, 4) tangent slots of the joints above each stick, beyond the torso's six; -1 pads."""
PIVOT_STICK = np.array([0, 0, 0, 0, 0, 0, 1, 1, 2, 3, 2, 3, 2, 3, 6, 7, 4, 5, 4, 5, 8, 9, 4, 5])
"""(24,) stick whose origin A is the pivot of each tangent slot (the first six turn about t0 instead)."""
SLOT_OF_JOINT_AXIS = np.array([[6, 7, -1], [8, 12, 10], [9, 13, 11], [16, 18, 22], [17, 19, 23]])
"""(5, 3) tangent slot of ball joint m about the torso's x, y, z axis; -1: the neck has no z."""
HINGE_SLOT = np.array([14, 15, 20, 21])
"""(4,) tangent slot of each hinge."""


@kernel
def neck_from_direction(x, y, z, R):
    """R (3, 3) <- Rx(theta1) Ry(theta2) that takes +z to the direction (x, y, z), torso frame (thesis Table 5.4)."""
    r = math.sqrt(y * y + z * z)
    n = math.sqrt(x * x + r * r)
    c1, s1 = (z / r, -y / r) if r > 0.0 else (1.0, 0.0)
    c2, s2 = r / n, x / n
    R[0, 0] = c2
    R[0, 1] = 0.0
    R[0, 2] = s2
    R[1, 0] = s1 * s2
    R[1, 1] = c1
    R[1, 2] = -s1 * c2
    R[2, 0] = -c1 * s2
    R[2, 1] = s1
    R[2, 2] = c1 * c2


@njit(cache=True)
def place_sticks(pose, lengths, origins):
    """Place the sticks of a body (lengths, origins) in a pose (t0, R0, RJ, hinges), world frame.

    Returns stick frames G (10, 3, 3), joint axes (18, 3), stick starts A and ends B (10, 3).
    """
    t0, R0, RJ, hinges = pose
    G, axes = np.empty((10, 3, 3)), np.empty((18, 3))
    A, B = np.empty((10, 3)), np.empty((10, 3))
    stick_frames(R0, RJ, hinges, G, axes)
    stick_ends(G, t0, lengths, origins, A, B)
    return G, axes, A, B


@kernel
def stick_frames(R0, RJ, hinges, G, axes):
    """World rotations of the ten sticks and world axes of the eighteen joint slots.

    G (10, 3, 3) <- stick to world. axes (18, 3) <- world axis of tangent slot 6 + k: the torso's own axes for ball
    joints, the upper limb's z (elbows) or y (knees) for hinges.
    """
    for i in range(3):
        for j in range(3):
            G[0, i, j] = R0[i, j]
    for m in range(5):
        matmul3(R0, RJ[m], G[m + 1])
        for k in range(3):
            slot = SLOT_OF_JOINT_AXIS[m, k]
            if slot >= 0:
                for i in range(3):
                    axes[slot - 6, i] = R0[i, k]
    for h in range(4):
        hinge_frame(h, hinges[h], G, axes)


@kernel
def hinge_frame(h, angle, G, axes):
    """G, axes <- the frame of the stick below hinge h, and the hinge's axis, from the frame of the stick above."""
    c = math.cos(angle)
    s = math.sin(angle)
    upper = G[2 + h]
    lower = G[6 + h]
    axis = 2 if h < 2 else 1
    for i in range(3):
        axes[HINGE_SLOT[h] - 6, i] = upper[i, axis]
        if h < 2:  # elbow: Rz
            lower[i, 0] = c * upper[i, 0] + s * upper[i, 1]
            lower[i, 1] = c * upper[i, 1] - s * upper[i, 0]
            lower[i, 2] = upper[i, 2]
        else:  # knee: Ry
            lower[i, 0] = c * upper[i, 0] - s * upper[i, 2]
            lower[i, 1] = upper[i, 1]
            lower[i, 2] = c * upper[i, 2] + s * upper[i, 0]


@kernel
def stick_ends(G, t0, lengths, origins, A, B):
    """A, B (10, 3) <- start and end of every stick in the world (thesis Table 5.2, sticks as segments)."""
    for j in range(10):
        stick_end(j, G, t0, lengths, origins, A, B)


@kernel
def stick_end(j, G, t0, lengths, origins, A, B):
    """A, B <- start and end of stick j; of the sticks that do not begin on the torso, that above must be in place."""
    axis = 1 if (j == 2 or j == 3 or j == 6 or j == 7) else 2
    length = -lengths[j] if (j == 4 or j == 5 or j >= 8) else lengths[j]
    for i in range(3):
        if j < 6:
            A[j, i] = t0[i] + (G[0, i, 0] * origins[j, 0] + G[0, i, 1] * origins[j, 1] + G[0, i, 2] * origins[j, 2])
        else:
            A[j, i] = B[j - 4, i]
        B[j, i] = A[j, i] + G[j, i, axis] * length


@kernel
def move_limb(ball, hinge, pose, figure, frames):
    """G, axes, A, B of the two sticks of one limb <- where its ball joint and hinge put them, the torso as it is.

    ``pose`` (t0, R0, RJ, hinges); ``figure`` (lengths, origins); ``frames`` (G, axes, A, B) as `place_sticks` fills
    them.
    """
    (t0, R0, RJ, hinges), (lengths, origins), (G, axes, A, B) = pose, figure, frames
    matmul3(R0, RJ[ball], G[ball + 1])
    hinge_frame(hinge, hinges[hinge], G, axes)
    stick_end(2 + hinge, G, t0, lengths, origins, A, B)
    stick_end(6 + hinge, G, t0, lengths, origins, A, B)


@njit(cache=True)
def turn_limb(ball, hinge, RJ, hinges, d, scale):
    """Move one limb's ball joint and hinge along `scale` times their part of the tangent vector d (24,), in place."""
    sx, sy, sz = SLOT_OF_JOINT_AXIS[ball, 0], SLOT_OF_JOINT_AXIS[ball, 1], SLOT_OF_JOINT_AXIS[ball, 2]
    turn(RJ[ball], scale * d[sx], scale * d[sy], scale * d[sz], np.empty((3, 3)), np.empty((3, 3)))
    hinges[hinge] += scale * d[HINGE_SLOT[hinge]]


@kernel
def reference_points(A, B, t0, P):
    """P (15, 3) <- the thesis's reference points p1 to p15 from the sticks' ends."""
    for i in range(3):
        P[0, i] = t0[i]
        P[1, i] = B[1, i]
        for k in range(5):  # neck, shoulders, hips: starts of the sticks on the torso
            P[2 + k, i] = A[1 + k, i]
        for k in range(8):  # elbows, knees, hand tips, feet: ends of sticks 2 to 9
            P[7 + k, i] = B[2 + k, i]


@kernel
def point_jacobian(stick, point, t0, A, axes, J, slots):
    """Derivative of a world point fixed to a stick with respect to the tangent, only the columns that matter.

    J[:, :n] (3, >= 10) <- columns, slots[:n] <- their tangent slots, in rising order of the chain; returns n.
    Columns: identity, -[p - t0]x, and a_k x (p - o_k) for every joint above (thesis Table 5.8, p1's row corrected).
    """
    for k in range(6):
        slots[k] = k
    for i in range(3):
        for k in range(3):
            J[i, k] = 1.0 if i == k else 0.0
    x = point[0] - t0[0]
    y = point[1] - t0[1]
    z = point[2] - t0[2]
    J[0, 3], J[1, 3], J[2, 3] = 0.0, -z, y
    J[0, 4], J[1, 4], J[2, 4] = z, 0.0, -x
    J[0, 5], J[1, 5], J[2, 5] = -y, x, 0.0
    n = 6
    for m in range(4):
        slot = CHAIN[stick, m]
        if slot < 0:
            break
        pivot = PIVOT_STICK[slot]
        x = point[0] - A[pivot, 0]
        y = point[1] - A[pivot, 1]
        z = point[2] - A[pivot, 2]
        a0, a1, a2 = axes[slot - 6, 0], axes[slot - 6, 1], axes[slot - 6, 2]
        J[0, n] = a1 * z - a2 * y
        J[1, n] = a2 * x - a0 * z
        J[2, n] = a0 * y - a1 * x
        slots[n] = slot
        n += 1
    return n


@njit(cache=True)
def scale_of_step(step):
    """Return the factor that shortens a Gauss-Newton step (m and rad) to STEP_LIMIT."""
    return min(1.0, STEP_LIMIT / max(np.abs(step).max(), STEP_LIMIT))


@njit(cache=True)
def retract(t0, R0, RJ, hinges, d, scale):
    """Moves the state along `scale` times the tangent vector d (24,), in place."""
    E = np.empty((3, 3))
    T = np.empty((3, 3))
    for i in range(3):
        t0[i] += scale * d[i]
    turn(R0, scale * d[3], scale * d[4], scale * d[5], E, T)
    turn(RJ[0], scale * d[6], scale * d[7], 0.0, E, T)
    neck_from_direction(RJ[0, 0, 2], RJ[0, 1, 2], RJ[0, 2, 2], RJ[0])
    for m in range(1, 5):
        sx, sy, sz = SLOT_OF_JOINT_AXIS[m, 0], SLOT_OF_JOINT_AXIS[m, 1], SLOT_OF_JOINT_AXIS[m, 2]
        turn(RJ[m], scale * d[sx], scale * d[sy], scale * d[sz], E, T)
    for h in range(4):
        hinges[h] += scale * d[HINGE_SLOT[h]]


@kernel
def _neck_difference(a, b, out):
    """out (2,) <- x, y of the rotation vector in the torso's x-y plane that takes direction b to direction a."""
    dx, dy, dz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    # the axis u lies in the plane and u.a = u.b, so it is perpendicular to a - b
    ux, uy = -dy, dx
    n = math.hypot(ux, uy)
    if n < 1e-9:
        if abs(dz) < 1e-9:  # equal directions, to first order u x b = a - b
            scale = b[2] if abs(b[2]) > 1e-6 else 1e-6
            out[0], out[1] = -dy / scale, dx / scale
            return
        ux, uy = -b[1], b[0]
        n = math.hypot(ux, uy)
        if n < 1e-9:
            ux, uy, n = 1.0, 0.0, 1.0
    ux /= n
    uy /= n
    along = ux * b[0] + uy * b[1]
    px, py, pz = b[0] - along * ux, b[1] - along * uy, b[2]
    qx, qy, qz = a[0] - along * ux, a[1] - along * uy, a[2]
    sine = ux * (py * qz - pz * qy) + uy * (pz * qx - px * qz)
    angle = math.atan2(sine, px * qx + py * qy + pz * qz)
    out[0], out[1] = angle * ux, angle * uy


@njit(cache=True)
def difference(t0, R0, RJ, hinges, t0_from, R0_from, RJ_from, hinges_from, out):
    """out (24,) <- tangent vector from the second state to the first: retract(second, out) gives the first."""
    T = np.empty((3, 3))
    w = np.empty(3)
    for i in range(3):
        out[i] = t0[i] - t0_from[i]
    matmul3(R0, R0_from.T, T)
    rotation_log(T, w)
    out[3], out[4], out[5] = w[0], w[1], w[2]
    _neck_difference(RJ[0, :, 2], RJ_from[0, :, 2], w)
    out[6], out[7] = w[0], w[1]
    for m in range(1, 5):
        matmul3(RJ[m], RJ_from[m].T, T)
        rotation_log(T, w)
        for k in range(3):
            out[SLOT_OF_JOINT_AXIS[m, k]] = w[k]
    for h in range(4):
        out[HINGE_SLOT[h]] = hinges[h] - hinges_from[h]


@njit(cache=True)
def canonicalise_hinges(RJ, hinges, velocity, margin):
    """Bends every hinge that passed straight by more than `margin` (rad) the right way again; same points.

    Arms: (R, h) -> (R Ry(pi), -h); legs: (R Rz(pi), -h). In place; velocity (24,) has the hinge's rate negated.
    Returns a bit mask of the hinges changed (bit h), so that a caller can negate their rows of a covariance.
    """
    changed = 0
    for h in range(4):
        hinges[h] -= 2.0 * math.pi * math.floor(hinges[h] / (2.0 * math.pi) + 0.5)
        wrong = hinges[h] if h < 2 else -hinges[h]
        if wrong <= margin:
            continue
        hinges[h] = -hinges[h]
        velocity[HINGE_SLOT[h]] = -velocity[HINGE_SLOT[h]]
        second = 2 if h < 2 else 1  # Ry(pi) flips x and z, Rz(pi) flips x and y
        for i in range(3):
            RJ[1 + h, i, 0] = -RJ[1 + h, i, 0]
            RJ[1 + h, i, second] = -RJ[1 + h, i, second]
        changed |= 1 << h
    return changed
