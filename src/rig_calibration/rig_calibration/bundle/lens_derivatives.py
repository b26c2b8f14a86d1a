"""The lens model's derivatives (plumb_bob and rational_polynomial, OpenCV's formulas; see capture_rig.lens), for many
points with coefficients of their own: by the point, and by the coefficients.
"""

from __future__ import annotations

import numpy as np

from .rigid import Array

COEFFICIENTS = 8  # k1 k2 p1 p2 k3 k4 k5 k6


def distort(points: Array, D: Array) -> Array:
    """Ideal points (..., 2) under coefficients (..., 8), to distorted points (..., 2)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.moveaxis(D, -1, 0)
    x, y = points[..., 0], points[..., 1]
    q = x * x + y * y
    g = (1 + q * (k1 + q * (k2 + q * k3))) / (1 + q * (k4 + q * (k5 + q * k6)))
    return np.stack(
        [x * g + 2 * p1 * x * y + p2 * (q + 2 * x * x), y * g + p1 * (q + 2 * y * y) + 2 * p2 * x * y], axis=-1
    )


def by_point(points: Array, D: Array) -> Array:
    """(..., 2, 2) d(distorted) / d(ideal)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.moveaxis(D, -1, 0)
    x, y = points[..., 0], points[..., 1]
    q = x * x + y * y
    top, bottom = 1 + q * (k1 + q * (k2 + q * k3)), 1 + q * (k4 + q * (k5 + q * k6))
    g = top / bottom
    d_g = (k1 + q * (2 * k2 + q * 3 * k3) - g * (k4 + q * (2 * k5 + q * 3 * k6))) / bottom
    across = 2 * x * y * d_g + 2 * p1 * x + 2 * p2 * y
    return np.stack(
        [
            np.stack([g + 2 * x * x * d_g + 2 * p1 * y + 6 * p2 * x, across], axis=-1),
            np.stack([across, g + 2 * y * y * d_g + 6 * p1 * y + 2 * p2 * x], axis=-1),
        ],
        axis=-2,
    )


def by_coefficients(points: Array, D: Array) -> Array:
    """(..., 2, 8) d(distorted) / d(k1 k2 p1 p2 k3 k4 k5 k6)."""
    k1, k2, _, _, k3, k4, k5, k6 = np.moveaxis(D, -1, 0)
    x, y = points[..., 0], points[..., 1]
    q = x * x + y * y
    bottom = 1 + q * (k4 + q * (k5 + q * k6))
    g = (1 + q * (k1 + q * (k2 + q * k3))) / bottom
    powers = np.stack([q, q**2, q**3], axis=-1) / bottom[..., None]
    radial = np.concatenate([powers, -g[..., None] * powers], axis=-1)  # by k1 k2 k3 k4 k5 k6
    both = radial[..., None, :] * points[..., :, None]
    tangential = np.stack(
        [np.stack([2 * x * y, q + 2 * x * x], axis=-1), np.stack([q + 2 * y * y, 2 * x * y], axis=-1)], axis=-2
    )
    return np.concatenate([both[..., :2], tangential, both[..., 2:]], axis=-1)
