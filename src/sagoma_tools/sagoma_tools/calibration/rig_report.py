"""Writes and prints a calibrated rig: rig.yaml, its report and pictures, tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from capture_rig.verdict import GOOD, REDO, USABLE
from capture_rig.yaml_file import save_mapping
from rig_calibration.extrinsics.calibrate import FLOOR, RigCalibration
from rig_calibration.extrinsics.world import CameraFigures, RigFigures

from ..doctor.rig import carried
from ..recording.writer import own_version

COLOURS = {GOOD: "green", USABLE: "yellow", REDO: "red"}
CAMERA_FIGURES = (
    ("detections", "detections", "d"),
    ("rms px", "rms_px", ".2f"),
    ("mm/px", "mm_per_px", ".1f"),
    ("distance m", "distance_m", ".2f"),
    ("height m", "height_m", ".2f"),
    ("floor board at deg", "floor_angle_deg", ".0f"),
    ("sd place mm", "sd_centre_mm", ".1f"),
    ("sd turn deg", "sd_rotation_deg", ".3f"),
)
"""Heading, name in the report, and format of each figure of a camera."""


def write_outputs(
    path: Path, calibrated: RigCalibration, pictures: Mapping[str, np.ndarray], asked: Mapping[str, Any]
) -> list[Path]:
    """Write the rig to ``path``, and beside it STEM.report.yaml, STEM.png and, for each camera that has a picture of
    the floor, STEM_CAMERA.png; returns all paths. The rig's bytes depend on the detections alone. Raises InputError."""
    from .rig_pictures import draw_overlay, draw_rig  # matplotlib takes a second to load

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_rig(calibrated.placed.rig, path)
        written = [path, write_report(path.with_suffix(".report.yaml"), calibrated, asked)]
    except OSError as error:
        remedy = "Name a file in a folder that may be written (--output)."
        raise InputError(f"cannot be written ({error.strerror})", where=str(path), remedy=remedy) from None
    figures = {camera.name: camera for camera in calibrated.figures.cameras}
    written.append(
        draw_rig(path.with_suffix(".png"), calibrated.placed, calibrated.floor_world, figures, residuals_of(calibrated))
    )
    found = {s.camera: s.pixels for s in calibrated.solution.detections if s.target == FLOOR}
    for camera in calibrated.placed.rig.cameras:
        if calibrated.floor_world is not None and camera.name in pictures:
            place = path.with_name(f"{path.stem}_{camera.name}.png")
            found_px = found.get(camera.name, np.empty((0, 2)))
            volume = calibrated.placed.rig.volume
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
        for name in calibrated.placed.rig.names
    }


def print_report(console: Console, calibrated: RigCalibration) -> None:
    """Print the figures of cameras and rig, detections left out, the verdict, and what to measure with a tape."""
    figures = calibrated.figures
    console.print(_table(figures))
    gaps = ", ".join(f"{one}-{other} {gap:.0f}" for (one, other), gap in figures.gaps_deg.items())
    console.print(f"rms of all corners {figures.rms_px:.2f} px; between neighbours {gaps or 'none'} degrees")
    size = calibrated.placed.rig.volume.high - calibrated.placed.rig.volume.low
    enough = calibrated.placed.common.enough
    console.print(
        f"volume {size[0]:.1f} x {size[1]:.1f} x {size[2]:.2f} m; {enough} cameras or more see {figures.volume_m3:.0f} "
        f"m3, and a standing person on {figures.floor_m2[enough - 1]:.1f} m2 of floor (all cameras: "
        f"{figures.floor_m2[-1]:.1f})"
    )
    console.print(carried(calibrated.placed.rig))
    if (frames := calibrated.floor_guess) != ():
        console.print(f"floor: the carried board in frames {', '.join(map(str, frames))}, where nothing was below it")
    for left in calibrated.solution.left_out[:5]:
        detection = left.detection
        console.print(f"left out: {detection.camera}, {detection.target}, frame {detection.frame_index}: {left.reason}")
    if len(calibrated.solution.left_out) > 5:
        console.print(f"... and {len(calibrated.solution.left_out) - 5} more, in the report")
    for check in calibrated.tape:
        console.print(str(check))
    verdict = calibrated.verdict
    console.print(f"verdict: {verdict.grade.upper()}", style=COLOURS[verdict.grade])
    for finding in verdict.findings:
        console.print(f"  {finding.grade}: {finding.what}. {finding.remedy}", style=COLOURS[finding.grade])
    console.print(tape_request(calibrated))


def tape_request(calibrated: RigCalibration) -> str:
    """Return what to measure with a tape: no picture shows whether the print has the stated size."""
    cameras = calibrated.placed.rig.cameras
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
        "cameras": {camera.name: _camera_document(camera, calibrated) for camera in calibrated.figures.cameras},
        "left_out": [_left_document(left) for left in calibrated.solution.left_out],
        "asked": dict(asked),
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": {"sagoma_tools": own_version(), "opencv": cv2.__version__, "numpy": np.__version__},
    }
    save_mapping(path, document, default_flow_style=None, width=120)
    return path


def _table(figures: RigFigures) -> Table:
    table = Table(title="cameras", title_justify="left")
    table.add_column("camera")
    for heading, _, _ in CAMERA_FIGURES:
        table.add_column(heading, justify="right")
    for camera in figures.cameras:
        values = [(getattr(camera, name), form) for _, name, form in CAMERA_FIGURES]
        table.add_row(camera.name, *("never" if value is None else f"{value:{form}}" for value, form in values))
    return table


def _rig_document(calibrated: RigCalibration) -> dict[str, Any]:
    figures, volume = calibrated.figures, calibrated.placed.rig.volume
    return {
        "rms_px": _rounded(figures.rms_px),
        "volume_m": {"low": volume.low.tolist(), "high": volume.high.tolist()},
        "seen_m3": _rounded(figures.volume_m3),
        "cameras_for_seen": calibrated.placed.common.enough,
        "floor_m2_seen_by_1_to_all": [_rounded(area) for area in figures.floor_m2],
        "between_neighbours_deg": {f"{a} {b}": _rounded(gap) for (a, b), gap in figures.gaps_deg.items()},
        "scale": {
            name: {"ratio": _rounded(ratio), "sd": _rounded(sd)}
            for name, (ratio, sd) in sorted(calibrated.scales.items())
        },
        "tape": [str(check) for check in calibrated.tape],
    }


def _camera_document(camera: CameraFigures, calibrated: RigCalibration) -> dict[str, Any]:
    document: dict[str, Any] = {name: _rounded(getattr(camera, name)) for _, name, _ in CAMERA_FIGURES}
    covariance = calibrated.solution.covariance[camera.name]
    document["pose_covariance"] = [[float(f"{value:.4g}") for value in row] for row in covariance]
    return document


def _left_document(left: Any) -> dict[str, Any]:
    of = left.detection
    return {"camera": of.camera, "target": of.target, "frame": of.frame_index, "reason": left.reason}


def _rounded(value: float | None) -> float | int | None:
    return value if value is None or isinstance(value, int) else float(f"{value:.5g}")
