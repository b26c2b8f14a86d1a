"""The inputs of a rig's calibration: the cameras' lenses, the targets, and the detections of them.

Lenses come from camera_info YAML files, one a camera, or from a rig file whose poses are to be renewed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

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
        """Add the carried board; what it shows ``at`` the frame at which it lies on the floor is the floor target.
        Returns the frames in which it was taken to lie there."""
        lying = () if at is None else frames_on_floor(cameras, moving, board, at)
        self.add_floor((s for s in moving if s.frame_index in lying), board, Target.of(board, choice))
        self.add_carried([s for s in moving if s.frame_index not in lying], MOVING, Target.of(board))
        return lying

    def add_carried(self, carried: Sequence[TargetDetection], name: str, target: Target) -> None:
        """Add what was carried, in the frames that several cameras share."""
        shared = set(shared_frames(carried))
        if shared:
            self.detections += [detection for detection in carried if detection.frame_index in shared]
            self.targets[name] = target


def require_seen(
    cameras: Iterable[str], inputs: RigInputs, searched: Sequence[tuple[str, CamerasDetections, Board | None]]
) -> None:
    """Raises InputError for cameras without a detection, with the reason from what was ``searched`` (kind, detections,
    the board; None: a wand)."""
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
