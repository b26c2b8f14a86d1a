"""Writes and prints a calibrated rig: rig.yaml, its report and pictures, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import cv2
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from rich.console import Console
from rich.table import Table

from capture_rig.camera import CameraModel
from capture_rig.files import make_folder
from capture_rig.rig import Volume, save_rig
from capture_rig.visibility import CELL_M
from capture_rig.yaml_file import save_mapping
from rig_calibration.extrinsics.calibrate import FLOOR, RigCalibration
from rig_calibration.extrinsics.world import CameraFigures
from rig_calibration.intrinsics.picture import draw_residuals

from ..console import GRADE_STYLE
from ..doctor.rig import carried
from ..recording.writer import own_version

CAMERA_FIGURES = (
    ("detections", "detections", "d"),
    ("rms px", "rms_px", ".2f"),
    ("mm/px", "mm_per_px", ".1f"),
    ("distance m", "distance_m", ".2f"),
    ("height m", "height_m", ".2f"),
    ("sd place mm", "sd_centre_mm", ".1f"),
    ("sd turn deg", "sd_rotation_deg", ".3f"),
)
"""Heading, name in the report, and format of each figure of a camera."""


def write_outputs(
    path: Path, calibrated: RigCalibration, pictures: Mapping[str, np.ndarray], asked: Mapping[str, Any]
) -> list[Path]:
    """Write the rig to ``path``, and beside it STEM.report.yaml, STEM.png and, for each camera that has a picture of
    the floor, STEM_CAMERA.png; returns all paths. The rig's bytes depend on the detections alone. Raises InputError."""

    make_folder(path.parent)
    save_rig(calibrated.rig, path)
    written = [path, write_report(path.with_suffix(".report.yaml"), calibrated, asked)]
    written.append(draw_rig(path.with_suffix(".png"), calibrated))
    found = {s.camera: s.pixels for s in calibrated.solution.detections if s.target == FLOOR}
    for camera in calibrated.rig.cameras:
        if calibrated.floor_world is not None and camera.name in pictures:
            place = path.with_name(f"{path.stem}_{camera.name}.png")
            found_px = found.get(camera.name, np.empty((0, 2)))
            volume = calibrated.rig.volume
            draw_overlay(place, pictures[camera.name], camera, volume, calibrated.floor_world, found_px)
            written.append(place)
    return written


def residuals_of(calibrated: RigCalibration) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return by camera all its corners (n, 2), and found minus expected (n, 2), px."""
    solution = calibrated.solution
    pairs = list(zip(solution.detections, solution.residuals_px, strict=True))
    return {
        name: (
            np.concatenate([detection.pixels for detection, _ in pairs if detection.camera == name]),
            np.concatenate([residuals for detection, residuals in pairs if detection.camera == name]),
        )
        for name in calibrated.rig.names
    }


def print_report(console: Console, calibrated: RigCalibration) -> None:
    """Print the figures of cameras and rig, detections left out, the verdict, and what to measure with a tape."""
    console.print(_table(calibrated.figures))
    console.print(f"rms of all corners {calibrated.rms_px:.2f} px")
    size = calibrated.rig.volume.high - calibrated.rig.volume.low
    common = calibrated.common
    enough = common.enough
    console.print(
        f"volume {size[0]:.1f} x {size[1]:.1f} x {size[2]:.2f} m; {enough} cameras or more see a standing person on "
        f"{common.floor_m2[enough - 1]:.1f} m2 of floor (all cameras: {common.floor_m2[-1]:.1f})"
    )
    console.print(carried(calibrated.rig))
    for left in calibrated.solution.left_out[:5]:
        detection = left.detection
        console.print(f"left out: {detection.camera}, {detection.target}, frame {detection.frame_index}: {left.reason}")
    if len(calibrated.solution.left_out) > 5:
        console.print(f"... and {len(calibrated.solution.left_out) - 5} more, in the report")
    for check in calibrated.tape:
        console.print(str(check))
    verdict = calibrated.verdict
    console.print(f"verdict: {verdict.grade.upper()}", style=GRADE_STYLE[verdict.grade])
    for finding in verdict.findings:
        console.print(f"  {finding.grade}: {finding.what}. {finding.remedy}", style=GRADE_STYLE[finding.grade])
    console.print(tape_request(calibrated))


def tape_request(calibrated: RigCalibration) -> str:
    """Return what to measure with a tape: no picture shows whether the print has the stated size."""
    cameras = calibrated.rig.cameras
    parts = []
    if calibrated.floor_world is not None:
        parts.append(f"the lens of {cameras[0].name} is {cameras[0].centre_world[2]:.2f} m above the floor")
    if len(cameras) > 1:
        apart = np.linalg.norm(cameras[0].centre_world - cameras[1].centre_world)
        parts.append(f"the lenses of {cameras[0].name} and {cameras[1].name} are {apart:.2f} m apart")
    return f"Measure with a tape: {', and '.join(parts)}. If not, the board's size is wrong."


def write_report(path: Path, calibrated: RigCalibration, asked: Mapping[str, Any]) -> Path:
    """Write figures, verdict, detections left out, the arguments, date and versions."""
    document = {
        "verdict": calibrated.verdict.grade,
        "findings": [asdict(finding) for finding in calibrated.verdict.findings],
        "measure": tape_request(calibrated),
        "rig": _rig_document(calibrated),
        "cameras": {
            name: _camera_document(camera, calibrated.solution.covariance[name])
            for name, camera in calibrated.figures.items()
        },
        "left_out": [
            {"camera": of.camera, "target": of.target, "frame": of.frame_index, "reason": left.reason}
            for left in calibrated.solution.left_out
            for of in [left.detection]
        ],
        "asked": dict(asked),
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": {"sagoma_tools": own_version(), "opencv": cv2.__version__, "numpy": np.__version__},
    }
    save_mapping(path, document, default_flow_style=None, width=120)
    return path


def _table(figures: Mapping[str, CameraFigures]) -> Table:
    table = Table(title="cameras", title_justify="left")
    table.add_column("camera")
    for heading, _, _ in CAMERA_FIGURES:
        table.add_column(heading, justify="right")
    for camera, its in figures.items():
        table.add_row(camera, *(f"{getattr(its, name):{form}}" for _, name, form in CAMERA_FIGURES))
    return table


def _rig_document(calibrated: RigCalibration) -> dict[str, Any]:
    volume, common = calibrated.rig.volume, calibrated.common
    return {
        "rms_px": _rounded(calibrated.rms_px),
        "volume_m": {"low": volume.low.tolist(), "high": volume.high.tolist()},
        "cameras_for_seen": common.enough,
        "floor_m2_seen_by_1_to_all": [_rounded(area) for area in common.floor_m2],
        "scale": {
            name: {"ratio": _rounded(ratio), "sd": _rounded(sd)}
            for name, (ratio, sd) in sorted(calibrated.solution.scale_of.items())
        },
        "tape": [str(check) for check in calibrated.tape],
    }


def _camera_document(camera: CameraFigures, covariance: np.ndarray) -> dict[str, Any]:
    document: dict[str, Any] = {name: _rounded(getattr(camera, name)) for _, name, _ in CAMERA_FIGURES}
    return document | {"pose_covariance": [[float(f"{value:.4g}") for value in row] for row in covariance]}


def _rounded(value: float | None) -> float | int | None:
    return value if value is None or isinstance(value, int) else float(f"{value:.5g}")


# pictures -------------------------------------------------------------------------------------------------------------


COLUMNS, DPI = 4, 90
CAMERA, BOARD, BOX = "#1769aa", "#b22222", "#2e7d32"
X, Y, Z = 0, 1, 2
GRID_M, GRID_REACH_M, AXIS_M = 0.5, 3.0, 0.5
GRID, VOLUME, FOUND, EXPECTED, AXES = "#ffc800", "#50c850", "#00ffff", "#ff3c3c", ("#ff0000", "#00ff00", "#0050ff")


def draw_rig(path: Path, calibrated: RigCalibration) -> Path:
    """Write the picture: the rig from above and from the side, and each camera's residuals."""
    cameras, residuals = calibrated.rig.cameras, residuals_of(calibrated)
    rows = -(-len(cameras) // COLUMNS)
    figure = Figure(figsize=(15, 6.5 + 3.0 * rows), constrained_layout=True)
    views, panels = cast(np.ndarray, figure.subfigures(2, 1, height_ratios=[6.5, 3.0 * rows]))
    plan, side = views.subplots(1, 2, width_ratios=[1.15, 1.0])
    _draw_coverage(plan, calibrated)
    for axes, (right, up) in ((plan, (X, Y)), (side, (X, Z))):
        _draw_view(axes, calibrated, right, up)
    plan.set_title("from above: how many cameras see a standing person", fontsize=10)
    side.set_title("from the side", fontsize=10)
    side.axhline(0.0, color="0.5", linewidth=1)
    grid = panels.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, camera in zip(grid, cameras, strict=False):
        magnified = draw_residuals(axes, camera, *residuals[camera.name])
        axes.set(xticks=[], yticks=[])
        rms_px = calibrated.figures[camera.name].rms_px
        axes.set_title(f"{camera.name}: {rms_px:.2f} px rms, arrows x {magnified:.0f}", fontsize=9)
    for axes in grid[len(cameras) :]:
        axes.set_axis_off()
    matplotlib.rcParams["svg.hashsalt"] = "rig"
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    return path


def _draw_coverage(axes: Axes, calibrated: RigCalibration) -> None:
    common = calibrated.common
    levels = np.arange(len(calibrated.rig.cameras) + 2) - 0.5
    mesh = axes.pcolormesh(common.x, common.y, common.standing.T, cmap="Greys", vmin=0, vmax=2 * levels[-1], alpha=0.8)
    mesh.set_rasterized(True)
    inside = axes.contour(common.x, common.y, common.standing.T, levels=levels[1:-1], colors="0.4", linewidths=0.6)
    axes.clabel(inside, fmt=lambda level: f"{level + 0.5:.0f}", fontsize=7)


def _draw_view(axes: Axes, calibrated: RigCalibration, right: int, up: int) -> None:
    rig, board_world = calibrated.rig, calibrated.floor_world
    low, high = rig.volume.low, rig.volume.high
    size = high - low
    axes.add_patch(Rectangle((low[right], low[up]), size[right], size[up], fill=False, color=BOX, linewidth=1.5))
    for camera in rig.cameras:
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
    places = np.array([camera.centre_world for camera in rig.cameras] + [low, high])
    for set_limits, axis in ((axes.set_xlim, right), (axes.set_ylim, up)):
        set_limits(places[:, axis].min() - 0.6, places[:, axis].max() + 0.6)


def _frustum_edges(camera: CameraModel) -> list[np.ndarray]:
    """Return the lines (k, 3) from the centre to the image's corners, at AXIS_M, and around them."""
    w, h = camera.width - 1.0, camera.height - 1.0
    rays = camera.rays_world(np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]]))
    if not np.isfinite(rays).all():  # a lens model that does not reach the corners
        pinhole = np.array([[0.0, 0.0, 1.0], [w, 0.0, 1.0], [w, h, 1.0], [0.0, h, 1.0]]) @ np.linalg.inv(camera.K).T
        rays = pinhole @ camera.R_camera_world
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    centre = camera.centre_world
    ends = centre + AXIS_M * rays / (rays @ camera.R_camera_world[2])[:, None]
    return [np.stack([centre, end]) for end in ends] + [np.vstack([ends, ends[:1]])]


def draw_overlay(
    path: Path, picture: np.ndarray, camera: CameraModel, volume: Volume, board_world: np.ndarray, found_px: np.ndarray
) -> None:
    """Write the picture with the floor's grid, the world's axes (x red, y green, z blue), the volume's outline on the
    floor, the corners found (n, 2) and those of the board (m, 3) as the calibration expects them."""
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
    figure.savefig(path, dpi=DPI, metadata={"Software": None})


def _draw_floor_line(
    axes: Axes, camera: CameraModel, points: Sequence[Any], colour: str, width: float, label: str | None
) -> None:
    """Draw a line through points (2,) on the floor or (3,) of the world as the lens bends it, where it is seen."""
    ends = np.array([[*point, 0.0][:3] for point in points])
    for start, end in pairwise(ends):
        pieces = int(np.ceil(np.linalg.norm(end - start) / CELL_M)) + 1
        pixels = camera.project(start + np.linspace(0.0, 1.0, pieces)[:, None] * (end - start))
        pixels[np.abs(pixels).max(axis=1) > 4 * max(camera.width, camera.height)] = np.nan
        axes.plot(*pixels.T, color=colour, linewidth=width, label=label)
