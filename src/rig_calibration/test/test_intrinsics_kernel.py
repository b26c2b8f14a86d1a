"""The compiled normal equations against OpenCV's projection and its derivatives."""

import cv2
import numpy as np
import pytest

from rig_calibration.intrinsics import kernel

THETA = np.array([467.0, 466.0, 324.0, 245.0, 0.3, -0.05, 3e-4, -2e-4, 0.01, 0.5, 0.02, 0.01, 0.0, 0.0])
POSES = np.array([[0.3, -2.9, 0.2, 0.1, -0.05, 1.5], [0.0, 0.0, 0.0, -0.2, 0.1, 1.2], [3.0, 0.1, 0.4, 0, 0, 2.0]])


@pytest.fixture
def corners():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (30, 2)), np.zeros(30)])
    return points, rng.uniform(0, 1, (30, 2)), np.array([0, 10, 20, 30])


def test_projection_is_opencvs(corners):
    points, shapes, first = corners
    pixels = np.empty((30, 2))
    kernel.project_all(THETA, POSES, first, points, shapes, pixels)
    for pose, start in zip(POSES, first, strict=False):
        K = np.array([[THETA[0], 0, THETA[2]], [0, THETA[1], THETA[3]], [0, 0, 1]])
        theirs, _ = cv2.projectPoints(points[start : start + 10], pose[:3], pose[3:], K, THETA[4:12])
        assert pixels[start : start + 10] == pytest.approx(theirs.reshape(-1, 2), abs=1e-9)


def test_normal_equations_are_those_of_numerical_derivatives(corners):
    points, shapes, first = corners
    bent = THETA + np.r_[np.zeros(12), 0.01, -0.02]
    pixels, count = np.empty((30, 2)), kernel.PARAMETERS + kernel.POSE
    kernel.project_all(bent, POSES, first, points, shapes, pixels)
    seen = pixels + np.random.default_rng(1).normal(0, 2, (30, 2))
    sigma, robust = np.array([0.5, 1.0, 2.0]), 3.0
    matrices, rights = np.empty((3, count, count)), np.empty((3, count))
    kernel.normal_equations(bent, POSES, first, points, shapes, seen, sigma, robust, matrices, rights)
    for v in range(3):
        rows = slice(first[v], first[v + 1])
        J = _numerical(bent, POSES[v], points[rows], shapes[rows])
        residual = (seen - pixels)[rows]
        weight = 1 / (sigma[v] ** 2 + (residual**2).sum(axis=1) / robust**2)
        W = np.diag(np.repeat(weight, 2))
        assert matrices[v] == pytest.approx(J.T @ W @ J, rel=1e-4, abs=1e-3 * np.abs(J).max())
        assert rights[v] == pytest.approx(J.T @ W @ residual.ravel(), rel=1e-4, abs=1e-3 * np.abs(J).max())


def _numerical(theta, pose, points, shapes):
    """(2n, PARAMETERS + POSE) by central differences."""
    together = np.concatenate([theta, pose])
    first, columns = np.array([0, len(points)]), []
    for j in range(len(together)):
        values = []
        for sign in (1, -1):
            changed = together.copy()
            changed[j] += sign * 1e-6
            pixels = np.empty((len(points), 2))
            kernel.project_all(changed[: len(theta)], changed[None, len(theta) :], first, points, shapes, pixels)
            values.append(pixels.ravel())
        columns.append((values[0] - values[1]) / 2e-6)
    return np.array(columns).T
