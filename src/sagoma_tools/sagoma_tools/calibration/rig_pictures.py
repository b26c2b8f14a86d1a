"""Draws rig.png: the calibrated rig from above and from the side, the floor's coverage, and the residuals.

An overlay draws floor grid, axes and board back into a camera's picture of the floor: the best check by eye.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from capture_rig.camera import CameraModel
from capture_rig.files import describe_os_error
from capture_rig.rig import Volume
from rig_calibration.extrinsics.world import CameraFigures, PlacedRig

COLUMNS, DPI = 4, 90
FRUSTUM_M = 0.8
ARROW_SHARE, MAX_MAGNIFIED = 0.05, 200.0
"""The residuals' rms is drawn as this share of the image's width, magnified at most so much."""
MAX_ARROWS = 1500
CAMERA, BOARD, BOX, RESIDUAL = "#1769aa", "#b22222", "#2e7d32", "#d9772b"
X, Y, Z = 0, 1, 2
GRID_M, GRID_REACH_M, AXIS_M = 0.5, 3.0, 0.5
SAMPLE_M = 0.05
"""Length of the pieces of a line: so short that the lens bends none of them visibly."""
GRID, VOLUME, FOUND, EXPECTED, AXES = "#ffc800", "#50c850", "#00ffff", "#ff3c3c", ("#ff0000", "#00ff00", "#0050ff")

Residuals = Mapping[str, tuple[np.ndarray, np.ndarray]]
"""By camera: where in its image (n, 2), and found minus expected (n, 2), px."""


def draw_rig(
    path: Path,
    placed: PlacedRig,
    board_world: np.ndarray | None,
    figures: Mapping[str, CameraFigures],
    residuals: Residuals,
) -> Path:
    """Write the picture; ``board_world`` (n, 3): the corners of the board on the floor, None where there was none."""
    cameras = placed.rig.cameras
    rows = -(-len(cameras) // COLUMNS)
    figure = Figure(figsize=(15, 6.5 + 3.0 * rows), constrained_layout=True)
    views, panels = cast(np.ndarray, figure.subfigures(2, 1, height_ratios=[6.5, 3.0 * rows]))
    plan, side = views.subplots(1, 2, width_ratios=[1.15, 1.0])
    _draw_coverage(plan, placed)
    for axes, (right, up) in ((plan, (X, Y)), (side, (X, Z))):
        _draw_view(axes, placed, board_world, right, up)
    plan.set_title("from above: how many cameras see a standing person", fontsize=10)
    side.set_title("from the side", fontsize=10)
    side.axhline(0.0, color="0.5", linewidth=1)
    grid = panels.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, camera in zip(grid, cameras, strict=False):
        _draw_residuals(axes, camera, figures[camera.name], *residuals[camera.name])
    for axes in grid[len(cameras) :]:
        axes.set_axis_off()
    matplotlib.rcParams["svg.hashsalt"] = "rig"
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    return path


def _draw_coverage(axes: Axes, placed: PlacedRig) -> None:
    common = placed.common
    levels = np.arange(len(placed.rig.cameras) + 2) - 0.5
    mesh = axes.pcolormesh(common.x, common.y, common.standing.T, cmap="Greys", vmin=0, vmax=2 * levels[-1], alpha=0.8)
    mesh.set_rasterized(True)
    inside = axes.contour(common.x, common.y, common.standing.T, levels=levels[1:-1], colors="0.4", linewidths=0.6)
    axes.clabel(inside, fmt=lambda level: f"{level + 0.5:.0f}", fontsize=7)


def _draw_view(axes: Axes, placed: PlacedRig, board_world: np.ndarray | None, right: int, up: int) -> None:
    low, high = placed.rig.volume.low, placed.rig.volume.high
    size = high - low
    axes.add_patch(Rectangle((low[right], low[up]), size[right], size[up], fill=False, color=BOX, linewidth=1.5))
    for camera in placed.rig.cameras:
        for edge in _frustum_edges(camera):
            axes.plot(edge[:, right], edge[:, up], color=CAMERA, linewidth=0.8)
        centre = camera.centre_world
        axes.plot(centre[right], centre[up], "o", color=CAMERA, markersize=5)
        axes.annotate(camera.name, (centre[right], centre[up]), xytext=(5, 5), textcoords="offset points", fontsize=9)
    if board_world is not None:
        axes.plot(board_world[:, right], board_world[:, up], ".", color=BOARD, markersize=2)
    axes.plot(0.0, 0.0, "+", color=BOARD, markersize=12)
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)
    axes.set_xlabel(f"{'xyz'[right]} [m]")
    axes.set_ylabel(f"{'xyz'[up]} [m]")
    places = np.array([camera.centre_world for camera in placed.rig.cameras] + [low, high])
    for set_limits, axis in ((axes.set_xlim, right), (axes.set_ylim, up)):
        set_limits(places[:, axis].min() - 0.6, places[:, axis].max() + 0.6)


def _frustum_edges(camera: CameraModel) -> list[np.ndarray]:
    """Return the lines (k, 3) from the centre to the image's corners, at FRUSTUM_M, and around them."""
    w, h = camera.width - 1.0, camera.height - 1.0
    rays = camera.rays_world(np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]]))
    if not np.isfinite(rays).all():  # a lens model that does not reach the corners
        pinhole = np.array([[0.0, 0.0, 1.0], [w, 0.0, 1.0], [w, h, 1.0], [0.0, h, 1.0]]) @ np.linalg.inv(camera.K).T
        rays = pinhole @ camera.R_camera_world
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    centre = camera.centre_world
    ends = centre + FRUSTUM_M * rays / (rays @ camera.R_camera_world[2])[:, None]
    return [np.stack([centre, end]) for end in ends] + [np.vstack([ends, ends[:1]])]


def _draw_residuals(
    axes: Axes, camera: CameraModel, figures: CameraFigures, places: np.ndarray, residuals: np.ndarray
) -> None:
    step = -(-len(places) // MAX_ARROWS) or 1
    magnified = min(ARROW_SHARE * camera.width / max(figures.rms_px, 1e-3), MAX_MAGNIFIED)
    axes.quiver(
        *places[::step].T,
        *(residuals[::step] * magnified).T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        color=RESIDUAL,
        width=0.003,
    )
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal", xticks=[], yticks=[])
    axes.set_title(f"{camera.name}: {figures.rms_px:.2f} px rms, arrows x {magnified:.0f}", fontsize=9)


def draw_overlay(
    path: Path, picture: np.ndarray, camera: CameraModel, volume: Volume, board_world: np.ndarray, found_px: np.ndarray
) -> None:
    """Write the picture with the floor's grid, the world's axes (x red, y green, z blue), the volume's outline on the
    floor, the corners found (n, 2) and those of the board (m, 3) as the calibration expects them. Raises InputError."""
    height, width = picture.shape[:2]
    figure = Figure(figsize=((width + 0.01) / DPI, (height + 0.01) / DPI))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    axes.set_axis_off()
    axes.imshow(picture if picture.ndim == 2 else picture[..., ::-1], cmap="gray", vmin=0, vmax=255, aspect="auto")
    reach, ticks = GRID_REACH_M, np.arange(-GRID_REACH_M, GRID_REACH_M + GRID_M / 2, GRID_M)
    for tick in ticks:
        for ends in (((tick, -reach), (tick, reach)), ((-reach, tick), (reach, tick))):
            _draw_floor_line(axes, camera, ends, GRID, 0.7, f"grid {GRID_M} m" if tick == ticks[0] else None)
    (left, near, _), (right, far, _) = volume.low, volume.high
    corners = ((left, near), (right, near), (right, far), (left, far), (left, near))
    _draw_floor_line(axes, camera, corners, VOLUME, 1.4, "volume")
    for axis, colour, name in zip(np.eye(3) * AXIS_M, AXES, "xyz", strict=True):
        _draw_floor_line(axes, camera, (np.zeros(3), axis), colour, 1.4, name)
    axes.plot(*camera.project(board_world).T, "x", color=EXPECTED, markersize=5, label="expected")
    axes.plot(*found_px.T, "o", color=FOUND, markersize=6, fillstyle="none", label="found")
    names = {label: line for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    axes.legend(names.values(), names, loc="lower left", ncols=len(names), fontsize=7, title=camera.name)
    try:
        figure.savefig(path, dpi=DPI, metadata={"Software": None})
    except OSError as error:
        raise describe_os_error(error, "cannot be written", path) from None


def _draw_floor_line(
    axes: Axes, camera: CameraModel, points: Sequence[Any], colour: str, width: float, label: str | None
) -> None:
    """Draw a line through points (2,) on the floor or (3,) of the world as the lens bends it, where it is seen."""
    ends = np.array([[*point, 0.0][:3] for point in points])
    for start, end in pairwise(ends):
        pieces = int(np.ceil(np.linalg.norm(end - start) / SAMPLE_M)) + 1
        pixels = camera.project(start + np.linspace(0.0, 1.0, pieces)[:, None] * (end - start))
        pixels[np.abs(pixels).max(axis=1) > 4 * max(camera.width, camera.height)] = np.nan
        axes.plot(*pixels.T, color=colour, linewidth=width, label=label)
