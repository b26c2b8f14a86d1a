"""The inputs of a rig's calibration: the cameras' lenses, the targets, and the detections of them.

A floor is given by a board, or by points that were measured by hand. Lenses come from camera_info YAML files, one a
camera, or from a rig file whose poses are to be renewed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import read_camera_info
from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.yaml_file import read_mapping
from rig_calibration.boards.board import Board, TargetDetection
from rig_calibration.extrinsics.board_frames import FloorAt, average_still_board, frames_on_floor, shared_frames
from rig_calibration.extrinsics.calibrate import FLOOR, MOVING, Target
from rig_calibration.extrinsics.world import WorldChoice

from .rig_detections import Cameras, CamerasDetections

FEWEST_POINTS = 4
CLICKED_SD_PX = 1.0
"""Standard deviation of a person's click."""
FORMAT = "Write points: {A: [x, y], ...} in metres on the floor, and cameras: {NAME: {A: [u, v], ...}} in pixels."
PINHOLE = ("fx", "fy", "cx", "cy")
CALIBRATE = "Run sagoma calibrate intrinsics for it first"


class RigInputs:
    """Detections and the targets they name."""

    def __init__(self) -> None:
        self.detections: list[TargetDetection] = []
        self.targets: dict[str, Target] = {}

    def add_floor(self, detections: Iterable[TargetDetection], board: Board, target: Target) -> None:
        """Add the board on the floor: each camera's frames averaged."""
        by_camera: dict[str, list[TargetDetection]] = {}
        for detection in sorted(detections, key=lambda detection: detection.camera):
            by_camera.setdefault(detection.camera, []).append(detection)
        for seen in by_camera.values():
            self.detections.append(average_still_board(seen, board))
            self.targets[FLOOR] = target

    def add_moving(
        self, cameras: Cameras, moving: Sequence[TargetDetection], board: Board, choice: WorldChoice, at: FloorAt | None
    ) -> tuple[int, ...]:
        """Add the carried board; its detections ``at`` the frame at which it lies on the floor are the floor target.
        Returns the frames in which it was found to lie there."""
        lying = () if at is None else frames_on_floor(cameras, moving, board, at)
        self.add_floor((s for s in moving if s.frame_index in lying), board, Target.of(board, choice))
        self.add_carried([s for s in moving if s.frame_index not in lying], MOVING, Target.of(board))
        return lying

    def add_carried(self, carried: Sequence[TargetDetection], name: str, target: Target) -> None:
        """Add the detections of a carried target, in the frames that several cameras share."""
        shared = set(shared_frames(carried))
        if shared:
            self.detections += [detection for detection in carried if detection.frame_index in shared]
            self.targets[name] = target

    def add_floor_points(self, points: FloorPoints, cameras: Cameras) -> None:
        """Add measured points as the floor target, seen by those of ``cameras`` that the file names."""
        for name in sorted(points.seen.keys() & cameras.keys()):
            ids, pixels = points.seen[name]
            size = cameras[name].width, cameras[name].height
            self.detections.append(TargetDetection(name, 0, ids, pixels, size, FLOOR, CLICKED_SD_PX))
        self.targets[FLOOR] = Target(points.world, T_world_target=np.eye(4))


def require_seen(
    cameras: Iterable[str], inputs: RigInputs, searched: Sequence[tuple[str, CamerasDetections, Board | None]]
) -> None:
    """Raise InputError for cameras without a detection, with the reason from the ``searched`` pictures (kind,
    detections, the board; None: a wand)."""
    placed = {detection.camera for detection in inputs.detections}
    unseen, others = sorted(set(cameras) - placed), len(placed) > 1
    if not unseen:
        return
    reasons = [
        f"{name} ({kind}): {seen[name].missing_reason(board)}"
        for name in unseen
        for kind, seen, board in searched
        if name in seen
    ]
    raise InputError(
        f"no board was found for {', '.join(unseen)}. " + "; ".join(reasons),
        remedy="Show it the board nearer and more from above, or give the board's outer corners in its picture "
        "(--click, or --corners FILE)"
        + (f", or calibrate the others alone (--without {' '.join(unseen)})." if others else "."),
    )


class FloorPoints(NamedTuple):
    """Points that were measured on the floor: ``world`` (n, 3), m; by camera, which it shows (ids) and where, px."""

    world: np.ndarray
    seen: dict[str, tuple[np.ndarray, np.ndarray]]


def read_floor_points(path: Path) -> FloorPoints:
    """Read a file of measured points; a third number of a point is its height. Raises InputError naming file, camera,
    point and remedy."""
    document = read_mapping(path, FORMAT)
    points = {name: _numbers(xy, (2, 3), f"{path}: points.{name}") for name, xy in _part(document, "points", path)}
    order, found = {name: index for index, name in enumerate(points)}, {}
    for camera, seen in _part(document, "cameras", path):
        where = f"{path}: cameras.{camera}"
        if not isinstance(seen, Mapping) or len(seen) < FEWEST_POINTS:
            remedy = "Measure more points, spread over what the camera sees."
            raise InputError(f"shows fewer than {FEWEST_POINTS} points", where=where, remedy=remedy)
        if unknown := sorted(set(map(str, seen)) - set(order)):
            remedy = f"Known points: {', '.join(order)}."
            raise InputError(f"point '{unknown[0]}' is not among the measured ones", where=where, remedy=remedy)
        pixels = np.array([_numbers(uv, (2,), f"{where}.{name}") for name, uv in seen.items()])
        found[camera] = np.array([order[str(name)] for name in seen]), pixels
    return FloorPoints(np.array([[*xy, 0.0][:3] for xy in points.values()]), found)


def _part(document: Mapping[str, Any], key: str, path: Path) -> list[tuple[str, Any]]:
    part = document.get(key)
    if not isinstance(part, Mapping) or not part:
        raise InputError(f"key '{key}' is missing or empty", where=str(path), remedy=FORMAT)
    return [(str(name), value) for name, value in part.items()]


def _numbers(value: Any, lengths: tuple[int, ...], where: str) -> list[float]:
    try:
        numbers = [float(number) for number in value]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in lengths or not np.isfinite(numbers).all():
        raise InputError(f"{value!r} is not {' or '.join(map(str, lengths))} numbers", where=where, remedy=FORMAT)
    return numbers


def read_intrinsics(path: str | Path, names: Iterable[str]) -> dict[str, CameraModel]:
    """Return the models of the cameras called ``names``, in name order; their poses are meaningless.

    ``path``: a folder with one NAME.yaml (camera_info) a camera, or a rig YAML. Raises InputError naming the camera
    without a file, and the file that is another camera's.
    """
    path, wanted = Path(path), sorted(names)
    if path.is_file():
        rig = load_rig(path)
        return {name: rig.camera(name) for name in wanted}
    if not path.is_dir():
        remedy = f"Give the folder of camera_info files. {CALIBRATE}."
        raise InputError("does not exist", where=str(path), remedy=remedy)
    return {name: _read(path, name) for name in wanted}


def read_lens_deviations(path: str | Path, names: Iterable[str]) -> dict[str, list[float]]:
    """Standard deviations of fx, fy, cx, cy, px, of those cameras whose NAME.report.yaml lies in the folder."""
    found = {}
    for name in sorted(names):
        report = Path(path) / f"{name}.report.yaml"
        if report.is_file():
            parameters = read_mapping(report, f"{CALIBRATE}, or delete this file.").get("parameters")
            if isinstance(parameters, Mapping) and set(PINHOLE) <= set(parameters):
                found[name] = [float(parameters[key]["sd"]) for key in PINHOLE]
    return found


def _read(folder: Path, name: str) -> CameraModel:
    path = folder / f"{name}.yaml"
    if not path.is_file():
        files = sorted(file.stem for file in folder.glob("*.yaml") if not file.stem.endswith(".report"))
        there = f"it holds {', '.join(files)}" if files else "it holds no .yaml file"
        what = f"there is no {path.name} with the intrinsics of camera '{name}'; {there}"
        remedy = f"{CALIBRATE}, rename the footage or the file, or leave the camera out (--without {name})."
        raise InputError(what, where=str(folder), remedy=remedy)
    return read_camera_info(path, name)
