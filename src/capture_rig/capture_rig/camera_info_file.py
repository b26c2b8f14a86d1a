"""The camera_info YAML of ROS (camera_calibration, camera_info_manager): one camera's intrinsics, read and written.

Matrices are written as rows, cols and data. Of a single camera, the rectification matrix is the identity; the
projection matrix belongs to the rectified image, which here is the undistorted canvas with K itself: it is checked for
its size, but not used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .camera import CameraModel
from .errors import InputError
from .lens import Array
from .rig import ROTATION_TOLERANCE, camera_from_mapping
from .yaml_file import read_mapping, save_mapping

MATRICES = {"camera_matrix": (3, 3), "rectification_matrix": (3, 3), "projection_matrix": (3, 4)}
KEYS = ("image_width", "image_height", "camera_name", "distortion_model", "distortion_coefficients", *MATRICES)
_REMEDY = "Give a camera_info YAML, as camera_calibration writes it, or leave camera_info_file empty."


def load_camera_info(path: str | Path, camera: CameraModel) -> CameraModel:
    """Return ``camera`` with the intrinsics of the camera_info YAML at ``path``; its pose stays.

    Raises InputError as :func:`read_camera_info`, and for another camera's name or image size.
    """
    read = read_camera_info(path, camera.name)
    return _with_lens_of(camera, read, str(path))


def read_camera_info(path: str | Path, wanted: str = "") -> CameraModel:
    """Return the camera of the camera_info YAML at ``path``: name, image size and intrinsics from the file, pose the
    identity.

    Raises InputError with file, key, value and remedy: for a missing file, a missing name or one that is not the
    ``wanted``, an invalid matrix.
    """
    document, where = read_mapping(Path(path), _REMEDY), str(path)
    if missing := [key for key in KEYS if key not in document]:
        raise InputError(f"key '{missing[0]}' is missing", where=where, remedy=_REMEDY)
    name = document["camera_name"]
    if not isinstance(name, str) or not name:
        raise InputError(f"camera_name = {name!r} is not a name", where=where, remedy="Write the camera's name there.")
    if wanted and name != wanted:
        remedy = "Name the file of this camera, or correct camera_name in it."
        raise InputError(f"camera_name = '{name}' is not this camera, '{wanted}'", where=where, remedy=remedy)
    matrices = {key: _matrix(document, key, shape, where).tolist() for key, shape in MATRICES.items()}
    size, lens = (document["image_width"], document["image_height"]), document["distortion_model"]
    D, R = _coefficients(document, where), matrices["rectification_matrix"]
    return _camera(name, *size, matrices["camera_matrix"], lens, D, R, where)


def with_intrinsics(
    camera: CameraModel, width: Any, height: Any, K: Any, distortion_model: Any, D: Any, R: Any, where: str
) -> CameraModel:
    """Return ``camera`` with other intrinsics, checked as a rig file's are; ``R`` : the rectification, must be none.

    ``K``, ``R`` are 3 x 3 nested lists, ``D`` a list. Raises InputError naming ``where``.
    """
    return _with_lens_of(camera, _camera(camera.name, width, height, K, distortion_model, D, R, where), where)


def _with_lens_of(camera: CameraModel, other: CameraModel, where: str) -> CameraModel:
    if (other.width, other.height) != (camera.width, camera.height):
        raise InputError(
            f"is for images of {other.width} x {other.height} pixels, those of {camera.name} have "
            f"{camera.width} x {camera.height}",
            where=where,
            remedy="Calibrate at the size that the camera delivers, or set the camera's region.",
        )
    return replace(camera, K=other.K, distortion_model=other.distortion_model, D=other.D)


def _camera(name: str, width: Any, height: Any, K: Any, model: Any, D: Any, R: Any, where: str) -> CameraModel:
    if not np.allclose(R, np.eye(3), atol=ROTATION_TOLERANCE):
        raise InputError(
            "rectification_matrix is not the identity",
            where=where,
            remedy="A stereo calibration cannot be used; calibrate each camera by itself.",
        )
    entry = {
        "image_width": width,
        "image_height": height,
        "camera_matrix": K,
        "distortion_model": "plumb_bob" if model == "" and not np.any(D) else model,
        "distortion": D or [0.0] * 5,
        "R_camera_world": np.eye(3),
        "t_camera_world": np.zeros(3),
    }
    return camera_from_mapping(name, entry, where)


def save_camera_info(path: str | Path, camera: CameraModel) -> None:
    """Write the intrinsics of ``camera``, all or nothing. Raises InputError when the file cannot be written."""
    projection = np.hstack([camera.K, np.zeros((3, 1))])
    document = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": camera.name,
        "camera_matrix": _matrix_document(camera.K),
        "distortion_model": camera.distortion_model,
        "distortion_coefficients": _matrix_document(camera.D[None]),
        "rectification_matrix": _matrix_document(np.eye(3)),
        "projection_matrix": _matrix_document(projection),
    }
    save_mapping(path, document, default_flow_style=None, width=120)


def _matrix_document(values: Array) -> dict[str, Any]:
    rows, cols = values.shape
    return {"rows": rows, "cols": cols, "data": values.ravel().tolist()}


def _matrix(document: Mapping[str, Any], key: str, shape: tuple[int, int], where: str) -> Array:
    entry = document[key]
    try:
        if (entry["rows"], entry["cols"]) == shape:
            return np.array(entry["data"], float).reshape(shape)
    except (TypeError, KeyError, ValueError):
        pass
    raise InputError(
        f"{key} = {entry!r} is not a matrix of {shape[0]} x {shape[1]} numbers",
        where=where,
        remedy=f"Write it as rows: {shape[0]}, cols: {shape[1]}, data: [...].",
    )


def _coefficients(document: Mapping[str, Any], where: str) -> list[float]:
    entry = document["distortion_coefficients"]
    data = entry.get("data") if isinstance(entry, Mapping) else None
    if not isinstance(data, list) or entry.get("rows") != 1 or entry.get("cols") != len(data):
        raise InputError(
            f"distortion_coefficients = {entry!r} is not a matrix of one row",
            where=where,
            remedy="Write it as rows: 1, cols: 5, data: [k1, k2, p1, p2, k3].",
        )
    return data
