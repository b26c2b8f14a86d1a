"""The calibrated rig in words: tables for a person, rig.report.yaml for later."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from capture_rig.verdict import GOOD, REDO, USABLE
from rig_calibration.extrinsics.calibrate import RigCalibration
from rig_calibration.extrinsics.figures import CameraFigures, RigFigures

COLOURS = {GOOD: "green", USABLE: "yellow", REDO: "red"}


def print_report(console: Console, calibrated: RigCalibration) -> None:
    """Each camera's figures, the rig's, what was left out, the verdict, and what to measure with a tape."""
    figures = calibrated.figures
    console.print(_table(figures))
    console.print(f"rms of all corners {figures.rms_px:.2f} px; between neighbours {_gaps(figures)} degrees")
    size = calibrated.placed.rig.volume.high - calibrated.placed.rig.volume.low
    enough = calibrated.placed.common.enough
    console.print(
        f"volume {size[0]:.1f} x {size[1]:.1f} x {size[2]:.2f} m; {enough} cameras or more see {figures.volume_m3:.0f} "
        f"m3, and a standing person on {figures.floor_m2[enough - 1]:.1f} m2 of floor (all cameras: "
        f"{figures.floor_m2[-1]:.1f})"
    )
    if (frames := calibrated.evidence.floor_guess) != ():
        console.print(f"floor: the carried board in frames {', '.join(map(str, frames))}, where nothing was below it")
    for left in calibrated.solution.left_out[:5]:
        sighting = left.sighting
        console.print(f"left out: {sighting.camera}, {sighting.target}, frame {sighting.moment}: {left.reason}")
    if len(calibrated.solution.left_out) > 5:
        console.print(f"... and {len(calibrated.solution.left_out) - 5} more, in the report")
    for check in calibrated.evidence.tape:
        console.print(str(check))
    verdict = calibrated.verdict
    console.print(f"verdict: {verdict.grade.upper()}", style=COLOURS[verdict.grade])
    for finding in verdict.findings:
        console.print(f"  {finding.grade}: {finding.what}. {finding.remedy}", style=COLOURS[finding.grade])
    console.print(tape_request(calibrated))


def tape_request(calibrated: RigCalibration) -> str:
    """What a person should measure: no picture can tell whether the print has the size that was stated."""
    cameras = calibrated.placed.rig.cameras
    parts = []
    if calibrated.evidence.floor_known:
        parts.append(f"the lens of {cameras[0].name} is {cameras[0].centre_world[2]:.2f} m above the floor")
    if len(cameras) > 1:
        apart = np.linalg.norm(cameras[0].centre_world - cameras[1].centre_world)
        parts.append(f"the lenses of {cameras[0].name} and {cameras[1].name} are {apart:.2f} m apart")
    return f"Measure with a tape: {', and '.join(parts)}. If not, the board's size is wrong."


def write_report(path: Path, calibrated: RigCalibration, asked: Mapping[str, Any]) -> Path:
    """Write figures, verdict, what was left out, what was asked for, date and versions."""
    document = {
        "verdict": calibrated.verdict.grade,
        "findings": [
            {"grade": finding.grade, "what": finding.what, "remedy": finding.remedy}
            for finding in calibrated.verdict.findings
        ],
        "measure": tape_request(calibrated),
        "rig": _rig_document(calibrated),
        "cameras": {camera.name: _camera_document(camera, calibrated) for camera in calibrated.figures.cameras},
        "left_out": [_left_document(left) for left in calibrated.solution.left_out],
        "asked": dict(asked),
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": {"sagoma_tools": _version("sagoma_tools"), "opencv": cv2.__version__, "numpy": np.__version__},
    }
    path.write_text(yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True))
    return path


def _table(figures: RigFigures) -> Table:
    table = Table(title="cameras", title_justify="left")
    table.add_column("camera")
    headings = (
        "sightings",
        "rms px",
        "mm/px",
        "distance m",
        "height m",
        "sees floor board at",
        "sd place mm",
        "sd turn deg",
    )
    for heading in headings:
        table.add_column(heading, justify="right")
    for c in figures.cameras:
        angle = "never" if c.floor_angle_deg is None else f"{c.floor_angle_deg:.0f} deg"
        table.add_row(
            c.name,
            str(c.sightings),
            f"{c.rms_px:.2f}",
            f"{c.mm_per_px:.1f}",
            f"{c.distance_m:.2f}",
            f"{c.height_m:.2f}",
            angle,
            f"{c.sd_centre_mm:.1f}",
            f"{c.sd_rotation_deg:.3f}",
        )
    return table


def _gaps(figures: RigFigures) -> str:
    return ", ".join(f"{one}-{other} {gap:.0f}" for (one, other), gap in figures.gaps_deg.items()) or "none"


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
            for name, (ratio, sd) in sorted(calibrated.evidence.scales.items())
        },
        "tape": [str(check) for check in calibrated.evidence.tape],
    }


def _camera_document(camera: CameraFigures, calibrated: RigCalibration) -> dict[str, Any]:
    keys = (
        "sightings",
        "rms_px",
        "mm_per_px",
        "distance_m",
        "height_m",
        "floor_angle_deg",
        "sd_centre_mm",
        "sd_rotation_deg",
    )
    document: dict[str, Any] = {key: _rounded(getattr(camera, key)) for key in keys}
    covariance = calibrated.solution.covariance[camera.name]
    document["pose_covariance"] = [[float(f"{value:.4g}") for value in row] for row in covariance]
    return document


def _left_document(left: Any) -> dict[str, Any]:
    sighting = left.sighting
    return {"camera": sighting.camera, "target": sighting.target, "frame": sighting.moment, "reason": left.reason}


def _rounded(value: float | None) -> float | int | None:
    return value if value is None or isinstance(value, int) else float(f"{value:.5g}")


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
