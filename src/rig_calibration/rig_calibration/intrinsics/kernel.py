"""The normal equations of all views, compiled: projection, its derivatives and their products, corner by corner.

A corner X of the board, which stands out of its plane by what the board is bent, is seen at
u = fx x' + cx, v = fy y' + cy, where (x', y') is the distorted (x, y) = (X_c / Z_c, Y_c / Z_c) of X_c = R X + t
(distortion as in capture_rig.lens; d R / d r of a rotation vector r after Gallego & Yezzi 2015).
"""

from __future__ import annotations

import numpy as np
from numba import njit

CAMERA, COEFFICIENTS, BOW, POSE = 4, 8, 2, 6
PARAMETERS = CAMERA + COEFFICIENTS + BOW  # fx fy cx cy, k1 k2 p1 p2 k3 k4 k5 k6, bow


@njit(cache=True)
def rotation(r, R, dR):
    """Rotation matrix R (3, 3) of the vector r (3,), and its derivatives dR (3, 3, 3), the first index r's."""
    angle2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    angle = np.sqrt(angle2)
    if angle < 1e-9:
        sine, versine = 1.0, 0.5
    else:
        sine, versine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
    cross(r, R)
    square = R @ R
    for i in range(3):
        for j in range(3):
            R[i, j] = (1.0 if i == j else 0.0) + sine * R[i, j] + versine * square[i, j]
    S = np.empty((3, 3))
    w = np.empty(3)
    for i in range(3):
        if angle < 1e-9:
            w[:] = 0.0
            w[i] = 1.0
        else:
            # (r_i r + r x (I - R) e_i) / |r|^2
            a, b, c = -R[0, i], -R[1, i], -R[2, i]
            if i == 0:
                a += 1.0
            elif i == 1:
                b += 1.0
            else:
                c += 1.0
            w[0] = (r[i] * r[0] + r[1] * c - r[2] * b) / angle2
            w[1] = (r[i] * r[1] + r[2] * a - r[0] * c) / angle2
            w[2] = (r[i] * r[2] + r[0] * b - r[1] * a) / angle2
        cross(w, S)
        dR[i] = S @ R


@njit(cache=True)
def cross(w, S):
    """S (3, 3) so that S x = w x x."""
    S[0, 0], S[0, 1], S[0, 2] = 0.0, -w[2], w[1]
    S[1, 0], S[1, 1], S[1, 2] = w[2], 0.0, -w[0]
    S[2, 0], S[2, 1], S[2, 2] = -w[1], w[0], 0.0


@njit(cache=True)
def project_corner(theta, R, dR, t, corner, shape, J, pixel):
    """One corner's pixel (2,), and J (2, PARAMETERS + POSE), its derivatives."""
    X, Y, Z = corner[0], corner[1], corner[2] + shape[0] * theta[12] + shape[1] * theta[13]
    xc = R[0, 0] * X + R[0, 1] * Y + R[0, 2] * Z + t[0]
    yc = R[1, 0] * X + R[1, 1] * Y + R[1, 2] * Z + t[1]
    zc = R[2, 0] * X + R[2, 1] * Y + R[2, 2] * Z + t[2]
    x, y = xc / zc, yc / zc
    fx, fy = theta[0], theta[1]
    k1, k2, p1, p2, k3, k4, k5, k6 = theta[4:12]
    r2 = x * x + y * y
    top, bottom = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    g = top / bottom
    d_g = (k1 + r2 * (2 * k2 + 3 * r2 * k3) - g * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / bottom
    xd = x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * g + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixel[0], pixel[1] = fx * xd + theta[2], fy * yd + theta[3]
    J[:] = 0.0
    J[0, 0], J[1, 1], J[0, 2], J[1, 3] = xd, yd, 1.0, 1.0
    power = r2
    for top_k, bottom_k in ((4, 9), (5, 10), (8, 11)):  # r^2, r^4, r^6
        J[0, top_k], J[1, top_k] = fx * x * power / bottom, fy * y * power / bottom
        J[0, bottom_k], J[1, bottom_k] = -fx * x * g * power / bottom, -fy * y * g * power / bottom
        power *= r2
    J[0, 6], J[1, 6] = fx * 2 * x * y, fy * (r2 + 2 * y * y)
    J[0, 7], J[1, 7] = fx * (r2 + 2 * x * x), fy * 2 * x * y
    # by x and y, then by the corner in the camera's frame
    xx = fx * (g + 2 * x * x * d_g + 2 * p1 * y + 6 * p2 * x)
    yy = fy * (g + 2 * y * y * d_g + 6 * p1 * y + 2 * p2 * x)
    xy = 2 * x * y * d_g + 2 * p1 * x + 2 * p2 * y
    for row in range(2):
        bx, by = (xx, fx * xy) if row == 0 else (fy * xy, yy)
        a, b = bx / zc, by / zc
        c = -(a * x + b * y)
        for i in range(3):
            moved = dR[i]
            J[row, PARAMETERS + i] = (
                a * (moved[0, 0] * X + moved[0, 1] * Y + moved[0, 2] * Z)
                + b * (moved[1, 0] * X + moved[1, 1] * Y + moved[1, 2] * Z)
                + c * (moved[2, 0] * X + moved[2, 1] * Y + moved[2, 2] * Z)
            )
        J[row, PARAMETERS + 3], J[row, PARAMETERS + 4], J[row, PARAMETERS + 5] = a, b, c
        height = a * R[0, 2] + b * R[1, 2] + c * R[2, 2]
        J[row, 12], J[row, 13] = height * shape[0], height * shape[1]


@njit(cache=True)
def project_all(theta, poses, first, points, shapes, pixels):
    """Where the corners of all views are seen; corners first[v] .. first[v + 1] belong to view v."""
    R, dR, J = np.empty((3, 3)), np.empty((3, 3, 3)), np.empty((2, PARAMETERS + POSE))
    for v in range(len(poses)):
        rotation(poses[v, :3], R, dR)
        for i in range(first[v], first[v + 1]):
            project_corner(theta, R, dR, poses[v, 3:], points[i], shapes[i], J, pixels[i])


@njit(cache=True)
def normal_equations(theta, poses, first, points, shapes, seen, sigma, robust, matrices, rights):
    """matrices (V, n, n) and rights (V, n), n = PARAMETERS + POSE, of each view, weighted by Cauchy's loss."""
    count = PARAMETERS + POSE
    R, dR, J, pixel = np.empty((3, 3)), np.empty((3, 3, 3)), np.empty((2, count)), np.empty(2)
    matrices[:] = 0.0
    rights[:] = 0.0
    for v in range(len(poses)):
        rotation(poses[v, :3], R, dR)
        matrix, right = matrices[v], rights[v]
        for i in range(first[v], first[v + 1]):
            project_corner(theta, R, dR, poses[v, 3:], points[i], shapes[i], J, pixel)
            du, dv = seen[i, 0] - pixel[0], seen[i, 1] - pixel[1]
            weight = 1.0 / (sigma[v] * sigma[v])
            weight /= 1.0 + (du * du + dv * dv) * weight / (robust * robust)
            for j in range(count):
                right[j] += weight * (J[0, j] * du + J[1, j] * dv)
                for k in range(j + 1):
                    matrix[j, k] += weight * (J[0, j] * J[0, k] + J[1, j] * J[1, k])
        for j in range(count):
            for k in range(j):
                matrix[k, j] = matrix[j, k]
