"""The rig: its calibrated cameras and the volume they watch, read from and written to one YAML file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .camera import CameraModel
from .errors import InputError, shortened
from .lens import COEFFICIENTS, Array
from .rigid import nearest_rotation
from .yaml_file import read_mapping, save_mapping

CAMERA_NAME = re.compile("[A-Za-z][A-Za-z0-9_]{0,63}")  # as a part of a topic's name (ROS 2 design, topic names)
UNITS = "metres, pixels; x_camera = R_camera_world x_world + t_camera_world; world z up; camera z forward, y down"
CAMERA_KEYS = (
    "image_width",
    "image_height",
    "camera_matrix",
    "distortion_model",
    "distortion",
    "R_camera_world",
    "t_camera_world",
)
# Thresholds: judgement, no measurement.
ROTATION_TOLERANCE = 1e-4
MAX_CAMERAS = 63  # of a set: they are bits of a signed 64-bit word
MAX_SIDE_PX = 20000  # of a sensor
FOCAL_WIDTHS = (0.05, 100.0)  # focal length over the width of an image: of 170 degrees, of a telescope
MOST_LINE_TIME_S = 1e-3  # a tenth of it is usual: 15 to 30 ms for all rows
FARTHEST_M = 100.0  # of a camera, or a corner of the volume, from the origin
DEFAULT_HALF_WIDTH_M, DEFAULT_HEIGHT_M, FLOOR_MARGIN_M = 2.5, 2.4, 0.05


@dataclass(frozen=True, eq=False)
class Volume:
    """The axis-aligned box that is searched for a body: corners ``low`` and ``high`` (3,), metres, map frame."""

    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class Rig:
    """The calibrated cameras, in name order, and the capture volume."""

    cameras: tuple[CameraModel, ...]
    volume: Volume

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(camera.name for camera in self.cameras)

    def camera(self, name: str) -> CameraModel:
        """Return the camera called ``name``; InputError lists the known names otherwise."""
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise InputError(f"there is no camera '{name}' in the rig", remedy=f"Known cameras: {', '.join(self.names)}.")


def load_rig(path: str | Path) -> Rig:
    """Read a rig YAML; every defect is an InputError with file, key, value and remedy."""
    path = Path(path)
    document = read_mapping(path, "Give a rig file: a YAML mapping with 'cameras' and, optionally, 'volume'.")
    cameras = document.get("cameras")
    if not isinstance(cameras, Mapping) or not cameras:
        raise InputError("key 'cameras' is missing or empty", where=str(path), remedy="List each camera under it.")
    if len(cameras) > MAX_CAMERAS:
        remedy = f"At most {MAX_CAMERAS} can watch one volume: keep those in this file."
        raise InputError(f"there are {len(cameras)} cameras", where=f"{path}: cameras", remedy=remedy)
    for name in cameras:
        if not CAMERA_NAME.fullmatch(str(name)):
            remedy = "Topics are named after cameras: use letters, digits and _, a letter first."
            raise InputError(f"'{shortened(str(name), 60)}' cannot be a camera's name", where=str(path), remedy=remedy)
    models = tuple(
        camera_from_mapping(str(name), cameras[name], f"{path}: cameras.{name}") for name in sorted(cameras, key=str)
    )
    if "volume" in document:
        return Rig(models, _volume(document["volume"], f"{path}: volume"))
    return Rig(models, default_volume(models))


def save_rig(rig: Rig, path: str | Path) -> None:
    """Write ``rig`` so that :func:`load_rig` reads the same numbers back, all or nothing. Raises InputError."""
    document = {
        "units": UNITS,
        "volume": {"low": rig.volume.low.tolist(), "high": rig.volume.high.tolist()},
        "cameras": {camera.name: _camera_document(camera) for camera in rig.cameras},
    }
    save_mapping(path, document, default_flow_style=None, width=120)


def default_volume(cameras: tuple[CameraModel, ...]) -> Volume:
    """Return a box of 5 x 5 x 2.45 m on the floor around the point that the optical axes meet best (least squares)."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for camera in cameras:
        axis = camera.R_camera_world[2]
        across = np.eye(3) - np.outer(axis, axis)
        A, b = A + across, b + across @ camera.centre_world
    meeting = np.linalg.lstsq(A, b, rcond=None)[0][:2]
    low = np.array([*(meeting - DEFAULT_HALF_WIDTH_M), -FLOOR_MARGIN_M])
    high = np.array([*(meeting + DEFAULT_HALF_WIDTH_M), DEFAULT_HEIGHT_M])
    return Volume(low, high)


def camera_from_mapping(name: str, entry: Any, where: str) -> CameraModel:
    """The camera that ``entry`` describes with the keys CAMERA_KEYS. Raises InputError naming ``where`` and the key."""
    if not isinstance(entry, Mapping):
        raise InputError("is not a mapping", where=where, remedy=f"It needs the keys {', '.join(CAMERA_KEYS)}.")
    for key in CAMERA_KEYS:
        if key not in entry:
            raise InputError(f"key '{key}' is missing", where=where, remedy=f"Needed: {', '.join(CAMERA_KEYS)}.")
    model = entry["distortion_model"]
    if not isinstance(model, str) or model not in COEFFICIENTS:
        raise InputError(
            f"distortion_model = {model!r} is not known", where=where, remedy=f"Use one of {', '.join(COEFFICIENTS)}."
        )
    T = np.eye(4)
    T[:3, :3] = _rotation(entry, where)
    T[:3, 3] = _metres(entry, "t_camera_world", where)
    width = _pixels(entry, "image_width", where)
    return CameraModel(
        name=name,
        width=width,
        height=_pixels(entry, "image_height", where),
        K=_camera_matrix(entry, width, where),
        distortion_model=model,
        D=_distortion(entry, COEFFICIENTS[model], where),
        T_camera_world=T,
        line_time_s=_line_time(entry, where),
    )


def _numbers(entry: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> Array:
    try:
        values = np.array(entry[key], dtype=float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != shape or not np.isfinite(values).all():
        size = " x ".join(map(str, shape))
        raise InputError(
            f"{key} = {entry[key]!r} is not {size} finite numbers",
            where=where,
            remedy="Calibrate the camera again or mend the file.",
        )
    return values


def _metres(entry: Mapping[str, Any], key: str, where: str) -> Array:
    values = _numbers(entry, key, (3,), where)
    if not np.hypot.reduce(values) <= FARTHEST_M:
        what = f"{key} = {values.tolist()} is more than {FARTHEST_M:g} m from the origin"
        raise InputError(what, where=where, remedy="Give metres; millimetres are likely here: divide by 1000.")
    return values


def _pixels(entry: Mapping[str, Any], key: str, where: str) -> int:
    value = entry[key]
    if not isinstance(value, int) or isinstance(value, bool) or not 0 < value <= MAX_SIDE_PX:
        what = f"{key} = {value!r} is not a whole number from 1 to {MAX_SIDE_PX}"
        raise InputError(what, where=where, remedy="Give the image size in pixels.")
    return value


def _line_time(entry: Mapping[str, Any], where: str) -> float:
    value = entry.get("line_time_s", 0.0)
    if not isinstance(value, int | float) or isinstance(value, bool) or not 0.0 <= value <= MOST_LINE_TIME_S:
        what = f"line_time_s = {value!r} is not a number from 0 to {MOST_LINE_TIME_S:g}"
        raise InputError(what, where=where, remedy="Give the seconds between two rows; 0 of a global shutter.")
    return float(value)


def _camera_matrix(entry: Mapping[str, Any], width: int, where: str) -> Array:
    K = _numbers(entry, "camera_matrix", (3, 3), where)
    if K[0, 0] <= 0 or K[1, 1] <= 0 or not np.allclose(K[2], [0, 0, 1]) or K[0, 1] != 0 or K[1, 0] != 0:
        raise InputError(
            f"camera_matrix = {K.tolist()} is not an intrinsic matrix",
            where=where,
            remedy="It must read [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0 pixels: calibrate the camera.",
        )
    least, most = (widths * width for widths in FOCAL_WIDTHS)
    if not least <= K[[0, 1], [0, 1]].min() <= K[[0, 1], [0, 1]].max() <= most:
        what = f"camera_matrix has focal lengths of {K[0, 0]:g} and {K[1, 1]:g} pixels in an image {width} wide"
        remedy = f"Give fx and fy in pixels, {least:g} to {most:g}, not millimetres: calibrate the camera."
        raise InputError(what, where=where, remedy=remedy)
    if np.abs(K[:2, 2]).max() > MAX_SIDE_PX:
        what = f"camera_matrix has its principal point at {K[:2, 2].tolist()}"
        raise InputError(what, where=where, remedy="Give cx and cy in pixels: calibrate the camera.")
    return K


def _distortion(entry: Mapping[str, Any], count: int, where: str) -> Array:
    given = entry["distortion"]
    length = len(given) if isinstance(given, list) else -1
    if length == 4 and count == 5:  # k1 k2 p1 p2: k3 = 0 is what the shorter form means
        return np.append(_numbers(entry, "distortion", (4,), where), 0.0)
    return _numbers(entry, "distortion", (count,), where)


def _rotation(entry: Mapping[str, Any], where: str) -> Array:
    R = _numbers(entry, "R_camera_world", (3, 3), where)
    error = max(np.abs(R @ R.T - np.eye(3)).max(), abs(np.linalg.det(R) - 1))
    if error > ROTATION_TOLERANCE:
        raise InputError(
            f"R_camera_world is not a rotation: it departs from R R^T = I, det R = 1 by {error:.2g}",
            where=where,
            remedy="Its rows must be orthonormal and right-handed: calibrate the extrinsics again.",
        )
    return R if error < 1e-9 else nearest_rotation(R)  # rounding of the file taken out


def _volume(entry: Any, where: str) -> Volume:
    if not isinstance(entry, Mapping) or set(entry) != {"low", "high"}:
        raise InputError(
            f"{entry!r} is not a volume", where=where, remedy="Give low: [x, y, z] and high: [x, y, z] in metres."
        )
    low, high = _metres(entry, "low", where), _metres(entry, "high", where)
    if not (high > low).all():
        raise InputError(
            f"high = {high.tolist()} is not above low = {low.tolist()}",
            where=where,
            remedy="Every coordinate of high must exceed that of low.",
        )
    return Volume(low, high)


def _camera_document(camera: CameraModel) -> dict[str, Any]:
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": camera.K.tolist(),
        "distortion_model": camera.distortion_model,
        "distortion": camera.D.tolist(),
        "R_camera_world": camera.R_camera_world.tolist(),
        "t_camera_world": camera.t_camera_world.tolist(),
        "centre_world": camera.centre_world.tolist(),
        **({"line_time_s": camera.line_time_s} if camera.line_time_s else {}),
    }
