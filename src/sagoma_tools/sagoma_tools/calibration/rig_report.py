"""Writes and prints a calibrated rig: rig.yaml, its report and pictures, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import cv2
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
from rig_calibration.intrinsics.picture import draw_residuals

from ..console import GRADE_STYLE
from ..doctor.rig import carried
from ..recording.writer import own_version

FIGURES = (
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
    written = [path, path.with_suffix(".report.yaml"), path.with_suffix(".png")]
    save_mapping(written[1], report_of(calibrated, asked), default_flow_style=None, width=120)
    draw_rig(written[2], calibrated)
    found = {s.camera: s.pixels for s in calibrated.solution.detections if s.target == FLOOR}
    for camera in calibrated.rig.cameras:
        if calibrated.floor_world is not None and camera.name in pictures:
            place = path.with_name(f"{path.stem}_{camera.name}.png")
            found_px = found.get(camera.name, np.empty((0, 2)))
            volume = calibrated.rig.volume
            draw_overlay(place, pictures[camera.name], camera, volume, calibrated.floor_world, found_px)
            written.append(place)
    return written


def print_report(console: Console, calibrated: RigCalibration) -> None:
    """Print the figures of cameras and rig, the verdict, and a length to measure with a tape."""
    table = Table(title="cameras", title_justify="left")
    table.add_column("camera")
    for heading, _, _ in FIGURES:
        table.add_column(heading, justify="right")
    for name, its in calibrated.figures.items():
        table.add_row(name, *(f"{getattr(its, figure):{form}}" for _, figure, form in FIGURES))
    console.print(table)
    size, common = calibrated.rig.volume.high - calibrated.rig.volume.low, calibrated.common
    left_out = len(calibrated.solution.left_out)
    console.print(f"rms of all corners {calibrated.rms_px:.2f} px; {left_out} detections left out (see the report)")
    console.print(
        f"volume {size[0]:.1f} x {size[1]:.1f} x {size[2]:.2f} m; {common.enough} cameras or more see a standing person"
        f" on {common.floor_m2[common.enough - 1]:.1f} m2 of floor (all cameras: {common.floor_m2[-1]:.1f})"
    )
    console.print(carried(calibrated.rig))
    for check in calibrated.tape:
        console.print(str(check))
    verdict = calibrated.verdict
    console.print(f"verdict: {verdict.grade.upper()}", style=GRADE_STYLE[verdict.grade])
    for finding in verdict.findings:
        console.print(f"  {finding.grade}: {finding.what}. {finding.remedy}", style=GRADE_STYLE[finding.grade])
    console.print(tape_request(calibrated))


def tape_request(calibrated: RigCalibration) -> str:
    """Return the length to measure with a tape, as no picture shows whether the print has the stated size."""
    first, *others = calibrated.rig.cameras
    parts = []
    if calibrated.floor_world is not None:
        parts.append(f"the lens of {first.name} is {first.centre_world[2]:.2f} m above the floor")
    if others:
        apart = np.linalg.norm(first.centre_world - others[0].centre_world)
        parts.append(f"the lenses of {first.name} and {others[0].name} are {apart:.2f} m apart")
    return f"Measure with a tape: {', and '.join(parts)}. If not, the board's size is wrong."


def report_of(calibrated: RigCalibration, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Make plain data of figures, verdict, detections left out, the arguments, date and versions."""
    volume, common, solution = calibrated.rig.volume, calibrated.common, calibrated.solution
    return {
        "verdict": calibrated.verdict.grade,
        "findings": [asdict(finding) for finding in calibrated.verdict.findings],
        "measure": tape_request(calibrated),
        "rig": {
            "rms_px": _rounded(calibrated.rms_px),
            "volume_m": {"low": volume.low.tolist(), "high": volume.high.tolist()},
            "cameras_for_seen": common.enough,
            "floor_m2_seen_by_1_to_all": _rounded(common.floor_m2),
            "scale": {
                name: dict(zip(("ratio", "sd"), _rounded(of), strict=True)) for name, of in solution.scale_of.items()
            },
            "tape": [str(check) for check in calibrated.tape],
        },
        "cameras": {
            name: {key: _rounded(value) for key, value in asdict(its).items()}
            | {"pose_covariance": _rounded(solution.covariance[name])}
            for name, its in calibrated.figures.items()
        },
        "left_out": [
            {"camera": of.camera, "target": of.target, "frame": of.frame_index, "reason": left.reason}
            for left in solution.left_out
            for of in [left.detection]
        ],
        "asked": dict(asked),
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": {"sagoma_tools": own_version(), "opencv": cv2.__version__, "numpy": np.__version__},
    }


def _rounded(value: Any) -> Any:
    """Five digits of a number, or of all in an array."""
    if isinstance(value, int):
        return value
    return float(f"{value:.5g}") if np.ndim(value) == 0 else [_rounded(each) for each in value]


# pictures -------------------------------------------------------------------------------------------------------------


COLUMNS, DPI = 4, 90
CAMERA, BOARD, BOX = "#1769aa", "#b22222", "#2e7d32"
X, Y, Z = 0, 1, 2
GRID_M, GRID_REACH_M, AXIS_M = 0.5, 3.0, 0.5
GRID, VOLUME, FOUND, EXPECTED, AXES = "#ffc800", "#50c850", "#00ffff", "#ff3c3c", ("#ff0000", "#00ff00", "#0050ff")


def draw_rig(path: Path, calibrated: RigCalibration) -> None:
    """Write the picture: the rig from above and from the side, and each camera's residuals."""
    cameras, common, solution = calibrated.rig.cameras, calibrated.common, calibrated.solution
    rows = -(-len(cameras) // COLUMNS)
    figure = Figure(figsize=(15, 6.5 + 3.0 * rows), constrained_layout=True)
    views, panels = cast(np.ndarray, figure.subfigures(2, 1, height_ratios=[6.5, 3.0 * rows]))
    plan, side = views.subplots(1, 2, width_ratios=[1.15, 1.0])
    levels = np.arange(len(cameras) + 2) - 0.5
    plan.pcolormesh(common.x, common.y, common.standing.T, cmap="Greys", vmin=0, vmax=2 * levels[-1], alpha=0.8)
    inside = plan.contour(common.x, common.y, common.standing.T, levels=levels[1:-1], colors="0.4", linewidths=0.6)
    plan.clabel(inside, fmt=lambda level: f"{level + 0.5:.0f}", fontsize=7)
    for axes, (right, up) in ((plan, (X, Y)), (side, (X, Z))):
        _draw_view(axes, calibrated, right, up)
    plan.set_title("from above: how many cameras see a standing person", fontsize=10)
    side.set_title("from the side", fontsize=10)
    side.axhline(0.0, color="0.5", linewidth=1)
    grid = panels.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, camera in zip(grid, cameras, strict=False):
        pairs = zip(solution.detections, solution.residuals_px, strict=True)
        of = [(detection.pixels, residuals) for detection, residuals in pairs if detection.camera == camera.name]
        magnified = draw_residuals(axes, camera, *(np.concatenate(part) for part in zip(*of, strict=True)))
        axes.set(xticks=[], yticks=[])
        rms_px = calibrated.figures[camera.name].rms_px
        axes.set_title(f"{camera.name}: {rms_px:.2f} px rms, arrows x {magnified:.0f}", fontsize=9)
    for axes in grid[len(cameras) :]:
        axes.set_axis_off()
    figure.savefig(path, dpi=DPI, metadata={"Software": None})


def _draw_view(axes: Axes, calibrated: RigCalibration, right: int, up: int) -> None:
    rig, board_world = calibrated.rig, calibrated.floor_world
    low, high = rig.volume.low, rig.volume.high
    size = high - low
    axes.add_patch(Rectangle((low[right], low[up]), size[right], size[up], fill=False, color=BOX, linewidth=1.5))
    for camera in rig.cameras:
        w, h, centre = camera.width - 1.0, camera.height - 1.0, camera.centre_world
        corners = np.array([[0.0, 0.0, 1.0], [w, 0.0, 1.0], [w, h, 1.0], [0.0, h, 1.0]]) @ np.linalg.inv(camera.K).T
        ends = centre + AXIS_M * corners @ camera.R_camera_world  # of a pinhole: no lens model reaches all corners
        for edge in [*(np.stack([centre, end]) for end in ends), np.vstack([ends, ends[:1]])]:
            axes.plot(edge[:, right], edge[:, up], color=CAMERA, linewidth=0.8)
        axes.plot(centre[right], centre[up], "o", color=CAMERA, markersize=5)
        axes.annotate(camera.name, (centre[right], centre[up]), xytext=(5, 5), textcoords="offset points", fontsize=9)
    if board_world is not None:
        axes.plot(board_world[:, right], board_world[:, up], ".", color=BOARD, markersize=2)
    axes.plot(0.0, 0.0, "+", color=BOARD, markersize=12)
    places = np.array([camera.centre_world for camera in rig.cameras] + [low, high])
    (left, bottom), (rightmost, top) = places.min(axis=0)[[right, up]] - 0.6, places.max(axis=0)[[right, up]] + 0.6
    axes.set(xlim=(left, rightmost), ylim=(bottom, top), aspect="equal")
    axes.set(xlabel=f"{'xyz'[right]} [m]", ylabel=f"{'xyz'[up]} [m]")
    axes.grid(alpha=0.3)


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
