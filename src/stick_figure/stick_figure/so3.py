"""Compiled rotations, SO(3): exponential and logarithm, product, turn in place. Nothing allocates."""

from __future__ import annotations

import math

from capture_rig.kernel import kernel


@kernel
def matmul3(A, B, out):
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def rotation_exp(x, y, z, E):
    """E (3, 3) <- rotation matrix of the rotation vector (x, y, z) (Rodrigues; thesis eq. 5.25)."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-10:
        a = 1.0 - angle2 / 6.0
        b = 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        a = math.sin(angle) / angle
        half = math.sin(0.5 * angle)
        b = 2.0 * half * half / angle2
    E[0, 0] = 1.0 - b * (y * y + z * z)
    E[1, 1] = 1.0 - b * (x * x + z * z)
    E[2, 2] = 1.0 - b * (x * x + y * y)
    E[0, 1] = b * x * y - a * z
    E[1, 0] = b * x * y + a * z
    E[0, 2] = b * x * z + a * y
    E[2, 0] = b * x * z - a * y
    E[1, 2] = b * y * z - a * x
    E[2, 1] = b * y * z + a * x


@kernel
def rotation_log(R, w):
    """w (3,) <- rotation vector of R (3, 3), |w| <= pi. Goes through the quaternion: exact near 0 and near pi."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace > 0.0:
        s = trace + 1.0
        x = R[2, 1] - R[1, 2]
        y = R[0, 2] - R[2, 0]
        z = R[1, 0] - R[0, 1]
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        s = R[2, 1] - R[1, 2]
        x = 1.0 + R[0, 0] - R[1, 1] - R[2, 2]
        y = R[0, 1] + R[1, 0]
        z = R[0, 2] + R[2, 0]
    elif R[1, 1] >= R[2, 2]:
        s = R[0, 2] - R[2, 0]
        x = R[0, 1] + R[1, 0]
        y = 1.0 - R[0, 0] + R[1, 1] - R[2, 2]
        z = R[1, 2] + R[2, 1]
    else:
        s = R[1, 0] - R[0, 1]
        x = R[0, 2] + R[2, 0]
        y = R[1, 2] + R[2, 1]
        z = 1.0 - R[0, 0] - R[1, 1] + R[2, 2]
    if s < 0.0:
        s, x, y, z = -s, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 / s if sine < 1e-12 * s else 2.0 * math.atan2(sine, s) / sine
    w[0] = factor * x
    w[1] = factor * y
    w[2] = factor * z


@kernel
def turn(R, x, y, z, E, T):
    """R <- exp((x, y, z)) R in place, followed by one Newton step back to orthogonality."""
    rotation_exp(x, y, z, E)
    matmul3(E, R, T)
    for i in range(3):
        for j in range(3):
            E[i, j] = T[0, i] * T[0, j] + T[1, i] * T[1, j] + T[2, i] * T[2, j]
    for i in range(3):
        for j in range(3):
            R[i, j] = 1.5 * T[i, j] - 0.5 * (T[i, 0] * E[0, j] + T[i, 1] * E[1, j] + T[i, 2] * E[2, j])
