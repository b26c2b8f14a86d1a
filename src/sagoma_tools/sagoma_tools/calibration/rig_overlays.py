"""The calibration drawn back into a camera's picture of the floor: the best check that a person has."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rig import Volume

GRID_M, GRID_REACH_M = 0.5, 3.0
AXIS_M = 0.5
SAMPLE_M = 0.05
"""Lines are drawn in pieces so short that the lens bends none of them visibly."""
SHIFT = 4
"""Of the fixed-point coordinates that OpenCV draws at: sixteenths of a pixel."""
GRID_BGR, BOX_BGR, FOUND_BGR, EXPECTED_BGR = (0, 200, 255), (80, 200, 80), (255, 255, 0), (60, 60, 255)
AXES_BGR = ((0, 0, 255), (0, 255, 0), (255, 80, 0))


def write_overlay(
    path: Path,
    picture: np.ndarray,
    camera: CameraModel,
    volume: Volume,
    *,
    board_world: np.ndarray,
    found_px: np.ndarray,
) -> Path:
    """Floor grid of half a metre, world axes (x red, y green, z blue), the volume's outline on the floor, the corners
    found (n, 2) and those of the board (m, 3) as the calibration expects them. Raises InputError."""
    canvas = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR) if picture.ndim == 2 else picture.copy()
    for start, end in _floor_grid():
        _draw_line(canvas, camera, start, end, GRID_BGR, 1)
    low, high = volume.low, volume.high
    corners = [
        np.array([x, y, 0.0]) for x, y in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))
    ]
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        _draw_line(canvas, camera, start, end, BOX_BGR, 2)
    for axis, colour in zip(np.eye(3) * AXIS_M, AXES_BGR, strict=True):
        _draw_line(canvas, camera, np.zeros(3), axis, colour, 2)
    for x, y in _finite(camera.project(board_world)):
        cv2.drawMarker(canvas, (round(x), round(y)), EXPECTED_BGR, cv2.MARKER_TILTED_CROSS, 7)
    for x, y in found_px:
        cv2.circle(canvas, (round(x * 2**SHIFT), round(y * 2**SHIFT)), 4 * 2**SHIFT, FOUND_BGR, 1, cv2.LINE_AA, SHIFT)
    _write_legend(canvas, camera.name)
    if not cv2.imwrite(str(path), canvas):
        raise InputError("cannot be written", where=str(path), remedy="Name an output in a folder that may be written.")
    return path


def _floor_grid() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    ticks = np.arange(-GRID_REACH_M, GRID_REACH_M + GRID_M / 2, GRID_M)
    for tick in ticks:
        yield np.array([tick, -GRID_REACH_M, 0.0]), np.array([tick, GRID_REACH_M, 0.0])
        yield np.array([-GRID_REACH_M, tick, 0.0]), np.array([GRID_REACH_M, tick, 0.0])


def _draw_line(
    canvas: np.ndarray, camera: CameraModel, start: np.ndarray, end: np.ndarray, colour: tuple, thickness: int
) -> None:
    pieces = int(np.ceil(np.linalg.norm(end - start) / SAMPLE_M)) + 1
    pixels = camera.project(start + np.linspace(0.0, 1.0, pieces)[:, None] * (end - start))
    near = np.max(np.abs(pixels), axis=1) < 4 * max(camera.width, camera.height)  # NaN is not near
    for one, two in zip(np.flatnonzero(near[:-1] & near[1:]), np.flatnonzero(near[:-1] & near[1:]) + 1, strict=True):
        ends = [tuple(round(float(value) * 2**SHIFT) for value in pixels[index]) for index in (one, two)]
        cv2.line(canvas, ends[0], ends[1], colour, thickness, cv2.LINE_AA, SHIFT)


def _finite(pixels: np.ndarray) -> np.ndarray:
    return pixels[np.isfinite(pixels).all(axis=1) & (np.abs(pixels) < 1e5).all(axis=1)]


def _write_legend(canvas: np.ndarray, name: str) -> None:
    text = f"{name}: grid {GRID_M} m; x red, y green, z blue; circle: found, cross: expected; green: volume"
    scale = max(0.4, canvas.shape[1] / 1600)
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    bottom = canvas.shape[0]
    cv2.rectangle(canvas, (0, bottom - height - 12), (width + 12, bottom), (0, 0, 0), cv2.FILLED)
    cv2.putText(canvas, text, (6, bottom - 7), cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), 1, cv2.LINE_AA)
