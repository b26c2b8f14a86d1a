"""``.cal``: a camera's calibration in the terms of Bouguet's toolbox, whose model is OpenCV's plumb_bob.

22 numbers: focal lengths (2), principal point (2), skew (1), k1 k2 p1 p2 k3 (5), rotation by rows (9), translation in
mm (3), with x_camera = R x_world + T; the world is Vicon's, z up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from .number_file import read_numbers

MEANING = "fc(2) cc(2) alpha_c kc(5) R(9, row by row) T(3, mm)"
ROTATION_TOLERANCE = 1e-3


def read_cal(path: Path, name: str, width: int, height: int) -> CameraModel:
    """The camera that a ``.cal`` file describes, called ``name``, metres; its images are ``width`` x ``height`` px.

    Raises InputError naming the file for missing numbers, a skewed sensor, or a matrix that is no rotation.
    """
    numbers = read_numbers(path, 22, MEANING)
    focal, centre, skew, D = numbers[0:2], numbers[2:4], numbers[4], numbers[5:10]
    if (focal <= 0).any() or skew != 0:
        raise InputError(
            f"focal lengths {focal.tolist()} and skew {skew:g} are not those of a camera with square axes",
            where=str(path),
            remedy="Focal lengths must be positive pixels and the skew 0.",
        )
    T_camera_world = np.eye(4)
    T_camera_world[:3, :3] = _rotation(numbers[10:19].reshape(3, 3), path)
    T_camera_world[:3, 3] = numbers[19:22] / 1000.0
    K = np.array([[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]])
    return CameraModel(name, width, height, K, "plumb_bob", D, T_camera_world)


def _rotation(R: np.ndarray, path: Path) -> np.ndarray:
    """The rotation nearest to R: the file's digits are rounded."""
    error = max(np.abs(R @ R.T - np.eye(3)).max(), abs(np.linalg.det(R) - 1))
    if error > ROTATION_TOLERANCE:
        raise InputError(
            f"its R is not a rotation: it departs from R R^T = I, det R = 1 by {error:.2g}",
            where=str(path),
            remedy=f"It reads {MEANING}: copy it again from the data set.",
        )
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt
