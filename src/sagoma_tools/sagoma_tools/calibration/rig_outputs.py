"""Everything that is written when a rig was calibrated: rig.yaml, its report, the rig's picture, overlays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from rig_calibration.extrinsics.calibrate import FLOOR, RigCalibration

from .rig_overlays import write_overlay
from .rig_report import write_report


def write_outputs(
    path: Path, calibrated: RigCalibration, pictures: Mapping[str, np.ndarray], asked: Mapping[str, Any]
) -> list[Path]:
    """Write the rig to ``path``, and beside it STEM.report.yaml, STEM.png and, for each camera that has a picture of
    the floor, STEM_CAMERA.png; returns all paths. The rig's bytes depend on the sightings alone. Raises InputError."""
    from .rig_pictures import draw_rig  # matplotlib takes a second to load

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_rig(calibrated.placed.rig, path)
        written = [path, write_report(path.with_suffix(".report.yaml"), calibrated, asked)]
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror})",
            where=str(path),
            remedy="Name a file in a folder that may be written (--output).",
        ) from None
    figures = {camera.name: camera for camera in calibrated.figures.cameras}
    written.append(
        draw_rig(path.with_suffix(".png"), calibrated.placed, calibrated.floor_world, figures, residuals_of(calibrated))
    )
    return [*written, *_overlays(path, calibrated, pictures)]


def residuals_of(calibrated: RigCalibration) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """By camera: all its corners (n, 2) and by how much each misses its place (n, 2), px."""
    solution = calibrated.solution
    pairs = list(zip(solution.sightings, solution.residuals_px, strict=True))
    return {
        name: (
            np.concatenate([sighting.pixels for sighting, _ in pairs if sighting.camera == name]),
            np.concatenate([residuals for sighting, residuals in pairs if sighting.camera == name]),
        )
        for name in calibrated.placed.rig.names
    }


def _overlays(path: Path, calibrated: RigCalibration, pictures: Mapping[str, np.ndarray]) -> list[Path]:
    if calibrated.floor_world is None:
        return []
    found = {s.camera: s.pixels for s in calibrated.solution.sightings if s.target == FLOOR}
    rig = calibrated.placed.rig
    return [
        write_overlay(
            path.with_name(f"{path.stem}_{name}.png"),
            pictures[name],
            rig.camera(name),
            rig.volume,
            board_world=calibrated.floor_world,
            found_px=found.get(name, np.empty((0, 2))),
        )
        for name in rig.names
        if name in pictures
    ]
