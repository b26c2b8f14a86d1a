"""Foot points against plain geometry."""

import numpy as np
import pytest

from stick_figure.least_squares.point_factor import foot_points


def nearest(points, A, B):
    n = len(points)
    stick, along, feet, squared = np.empty(n, int), np.empty(n), np.empty((n, 3)), np.empty(n)
    foot_points(points, A, B, stick, along, feet, squared)
    return stick, along, feet, squared


def test_foot_points_are_the_nearest_points_of_all_sticks():
    rng = np.random.default_rng(1)
    A, B, points = rng.normal(size=(10, 3)), rng.normal(size=(10, 3)), 2 * rng.normal(size=(200, 3))
    stick, along, feet, squared = nearest(points, A, B)
    u = np.linspace(0, 1, 2001)
    dense = A[:, None] + u[None, :, None] * (B - A)[:, None]  # (10, 2001, 3)
    for i, point in enumerate(points):
        distances = np.linalg.norm(dense - point, axis=2)
        spacing = np.linalg.norm(B - A, axis=1).max() / 2000
        assert np.sqrt(squared[i]) <= distances.min() + 1e-12
        assert np.sqrt(squared[i]) >= distances.min() - spacing
        assert distances[stick[i]].min() == pytest.approx(distances.min(), abs=spacing)
    assert np.allclose(feet, A[stick] + along[:, None] * (B - A)[stick])
    assert np.allclose(squared, ((points - feet) ** 2).sum(1))
    assert along.min() == 0.0 and along.max() == 1.0  # both ends clamp


def test_nearest_stick_is_not_the_nearest_line():
    """The closest LINE's segment may be far away (thesis figure 4.4)."""
    A, B = np.full((10, 3), 50.0), np.full((10, 3), 51.0)
    A[0], B[0] = [0, 0, 0], [1, 0, 0]
    A[1], B[1] = [2.0, 0.3, 0], [3.0, 0.3, 0]
    stick, _, feet, _ = nearest(np.array([[2.5, 0.1, 0.0]]), A, B)
    assert stick[0] == 1
    assert np.allclose(feet[0], [2.5, 0.3, 0.0])


def test_stick_of_no_length_is_a_point():
    A = np.full((10, 3), 9.0)
    B = A.copy()
    A[3] = B[3] = [1.0, 0.0, 0.0]
    stick, _, feet, squared = nearest(np.zeros((1, 3)), A, B)
    assert stick[0] == 3 and squared[0] == 1.0
    assert np.array_equal(feet[0], A[3])
