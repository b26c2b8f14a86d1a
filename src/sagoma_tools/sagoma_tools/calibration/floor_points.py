"""Points on the floor that were measured by hand, and where each camera sees them: a floor without a board."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.yaml_file import read_mapping
from rig_calibration.boards.sighting import Sighting
from rig_calibration.extrinsics.calibrate import FLOOR, FloorTarget

from .rig_inputs import RigInputs

FEWEST_POINTS = 4
CLICKED_SD_PX = 1.0
"""What a person's click errs by."""
FORMAT = "Write points: {A: [x, y], ...} in metres on the floor, and cameras: {NAME: {A: [u, v], ...}} in pixels."


def read_floor_points(path: str | Path, cameras: Mapping[str, CameraModel]) -> RigInputs:
    """The measured points as the floor target, seen by those of ``cameras`` that the file names. A third number of a
    point is its height. Raises InputError naming file, camera, point and remedy."""
    document = read_mapping(Path(path), FORMAT)
    points = {str(name): _numbers(xy, (2, 3), f"{path}: points.{name}") for name, xy in _part(document, "points", path)}
    order = {name: index for index, name in enumerate(points)}
    world = np.array([[*xy, 0.0][:3] for xy in points.values()])
    sightings = []
    for name, seen in _part(document, "cameras", path):
        if name in cameras:
            sightings.append(_sighting(cameras[name], seen, order, f"{path}: cameras.{name}"))
    return RigInputs(tuple(sightings), {FLOOR: FloorTarget(world)})


def names_in_floor_points(path: str | Path) -> list[str]:
    """The cameras that the file names."""
    return [str(name) for name, _ in _part(read_mapping(Path(path), FORMAT), "cameras", path)]


def _part(document: Mapping[str, Any], key: str, path: str | Path) -> list[tuple[str, Any]]:
    part = document.get(key)
    if not isinstance(part, Mapping) or not part:
        raise InputError(f"key '{key}' is missing or empty", where=str(path), remedy=FORMAT)
    return [(str(name), value) for name, value in part.items()]


def _sighting(camera: CameraModel, seen: Any, order: Mapping[str, int], where: str) -> Sighting:
    if not isinstance(seen, Mapping) or len(seen) < FEWEST_POINTS:
        raise InputError(
            f"shows fewer than {FEWEST_POINTS} points",
            where=where,
            remedy="Measure more points, spread over what the camera sees.",
        )
    unknown = sorted(set(map(str, seen)) - set(order))
    if unknown:
        raise InputError(
            f"point '{unknown[0]}' is not among the measured ones",
            where=where,
            remedy=f"Known points: {', '.join(order)}.",
        )
    pixels = np.array([_numbers(uv, (2,), f"{where}.{name}") for name, uv in seen.items()])
    ids = np.array([order[str(name)] for name in seen], np.int64)
    return Sighting(camera.name, 0, ids, pixels, (camera.width, camera.height), FLOOR, CLICKED_SD_PX)


def _numbers(value: Any, lengths: tuple[int, ...], where: str) -> list[float]:
    try:
        numbers = [float(number) for number in value]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in lengths or not np.isfinite(numbers).all():
        raise InputError(f"{value!r} is not {' or '.join(map(str, lengths))} numbers", where=where, remedy=FORMAT)
    return numbers
