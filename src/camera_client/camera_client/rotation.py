"""Rotation vectors and matrices (Rodrigues)."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def matrix_of(turn_rad: npt.ArrayLike) -> Array:
    """(3, 3) rotation matrix of a rotation vector (3,), radians."""
    return np.asarray(cv2.Rodrigues(np.asarray(turn_rad, float))[0], np.float64)


def vector_of(R: Array) -> Array:
    """(3,) rotation vector, radians, of a rotation matrix (3, 3)."""
    return np.asarray(cv2.Rodrigues(R)[0], np.float64).reshape(3)
