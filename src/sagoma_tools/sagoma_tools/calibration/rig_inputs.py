"""The inputs of a rig's calibration: the cameras' lenses, the targets, and the detections of them.

A floor is given by a board, or by points that were measured by hand. Lenses come from camera_info YAML files, one a
camera, or from a rig file whose poses are to be renewed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import read_camera_info
from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.yaml_file import read_mapping
from rig_calibration.boards.board import Board, TargetDetection
from rig_calibration.boards.wand import wand_points, wand_symmetry_order
from rig_calibration.extrinsics.board_frames import (
    FloorAt,
    StillBoard,
    average_still_board,
    frames_on_floor,
    shared_frames,
)
from rig_calibration.extrinsics.calibrate import FLOOR, MOVING, WAND, Target
from rig_calibration.extrinsics.world import WorldChoice

from .rig_detections import CameraDetections, Cameras, CamerasDetections, missing_reason

FEWEST_POINTS = 4
CLICKED_SD_PX = 1.0
"""Standard deviation of a person's click."""
FORMAT = "Write points: {A: [x, y], ...} in metres on the floor, and cameras: {NAME: {A: [u, v], ...}} in pixels."
PINHOLE = ("fx", "fy", "cx", "cy")
CALIBRATE = "Run sagoma calibrate intrinsics for it first"


@dataclass(frozen=True, eq=False)
class RigInputs:
    """Detections and the targets they name.

    moved_frames : by camera, the number of frames in which the floor board lay elsewhere, and of all its frames.
    floor_guess : frames in which the carried board was taken to lie on the floor.
    """

    detections: tuple[TargetDetection, ...]
    targets: Mapping[str, Target]
    moved_frames: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    floor_guess: tuple[int, ...] = ()


def floor_inputs(floor: CamerasDetections, board: Board, choice: WorldChoice, by_hand: Iterable[str] = ()) -> RigInputs:
    """The board on the floor: each camera's frames averaged. Where all cameras' corners were given ``by_hand``, their
    order tells which way round the board lies."""
    stills = {
        name: average_still_board(seen.detections, board, target=FLOOR)
        for name, seen in floor.items()
        if seen.detections
    }
    target = Target.of(board, choice)
    if set(by_hand) >= set(stills):
        target = replace(target, symmetry_order=1)
    return RigInputs(tuple(still.detection for still in stills.values()), {FLOOR: target}, _moved_frames(stills))


def moving_inputs(
    cameras: Cameras, moving: Sequence[TargetDetection], board: Board, choice: WorldChoice, floor_at: FloorAt | None
) -> RigInputs:
    """The carried board in chosen frames; with ``floor_at``, what it shows while it lies on the floor becomes the
    floor target."""
    if floor_at is None:
        return RigInputs(_at_chosen_frames(moving), {MOVING: Target.of(board)})
    lying = set(frames_on_floor(cameras, moving, board, floor_at))
    resting = [detection for detection in moving if detection.frame_index in lying]
    names = sorted({detection.camera for detection in resting})
    stills = {
        name: average_still_board([s for s in resting if s.camera == name], board, target=FLOOR) for name in names
    }
    carried = _at_chosen_frames([detection for detection in moving if detection.frame_index not in lying])
    targets = {FLOOR: Target.of(board, choice)} | ({MOVING: Target.of(board)} if carried else {})
    guess = tuple(sorted(lying)) if floor_at == "lowest" else ()
    return RigInputs((*(still.detection for still in stills.values()), *carried), targets, _moved_frames(stills), guess)


def wand_inputs(wands: Sequence[TargetDetection], marks_m: Sequence[float]) -> RigInputs:
    """Return the carried wand in chosen frames."""
    target = Target(wand_points(marks_m), wand_symmetry_order(marks_m))
    return RigInputs(_at_chosen_frames(wands), {WAND: target})


def merge_inputs(parts: Sequence[RigInputs]) -> RigInputs:
    """Merge all parts into one."""
    return RigInputs(
        tuple(detection for part in parts for detection in part.detections),
        {name: target for part in parts for name, target in part.targets.items()},
        {name: moved_frames for part in parts for name, moved_frames in part.moved_frames.items()},
        tuple(frame for part in parts for frame in part.floor_guess),
    )


def require_seen(
    cameras: Iterable[str],
    inputs: RigInputs,
    footage: Mapping[str, Mapping[str, tuple[CameraDetections, Board | None]]],
) -> None:
    """Raises InputError for cameras without a detection, with the reason from their ``footage`` (kind, camera)."""
    placed = {detection.camera for detection in inputs.detections}
    unseen, others = sorted(set(cameras) - placed), len(placed) > 1
    if not unseen:
        return
    reasons = [
        f"{name} ({kind}): {missing_reason(*seen[name])}"
        for name in unseen
        for kind, seen in footage.items()
        if name in seen
    ]
    raise InputError(
        f"no board was found for {', '.join(unseen)}. " + "; ".join(reasons),
        remedy="Show it the board nearer and more from above, or give the board's outer corners in its picture "
        "(--click, or --corners FILE)"
        + (f", or calibrate the others alone (--without {' '.join(unseen)})." if others else "."),
    )


def _at_chosen_frames(moving: Sequence[TargetDetection]) -> tuple[TargetDetection, ...]:
    chosen = set(shared_frames(moving))
    return tuple(detection for detection in moving if detection.frame_index in chosen)


def _moved_frames(stills: Mapping[str, StillBoard]) -> dict[str, tuple[int, int]]:
    return {name: (len(s.moved_frames), len(s.moved_frames) + len(s.frames)) for name, s in stills.items()}


def read_floor_points(path: str | Path, cameras: Cameras) -> RigInputs:
    """The measured points as the floor target, seen by those of ``cameras`` that the file names. A third number of a
    point is its height. Raises InputError naming file, camera, point and remedy."""
    document = read_mapping(Path(path), FORMAT)
    points = {str(name): _numbers(xy, (2, 3), f"{path}: points.{name}") for name, xy in _part(document, "points", path)}
    order = {name: index for index, name in enumerate(points)}
    world = np.array([[*xy, 0.0][:3] for xy in points.values()])
    detections = []
    for name, seen in _part(document, "cameras", path):
        if name in cameras:
            detections.append(_detection(cameras[name], seen, order, f"{path}: cameras.{name}"))
    return RigInputs(tuple(detections), {FLOOR: Target(world, T_world_target=np.eye(4))})


def names_in_floor_points(path: str | Path) -> list[str]:
    """Return the cameras that the file names."""
    return [str(name) for name, _ in _part(read_mapping(Path(path), FORMAT), "cameras", path)]


def _part(document: Mapping[str, Any], key: str, path: str | Path) -> list[tuple[str, Any]]:
    part = document.get(key)
    if not isinstance(part, Mapping) or not part:
        raise InputError(f"key '{key}' is missing or empty", where=str(path), remedy=FORMAT)
    return [(str(name), value) for name, value in part.items()]


def _detection(camera: CameraModel, seen: Any, order: Mapping[str, int], where: str) -> TargetDetection:
    if not isinstance(seen, Mapping) or len(seen) < FEWEST_POINTS:
        remedy = "Measure more points, spread over what the camera sees."
        raise InputError(f"shows fewer than {FEWEST_POINTS} points", where=where, remedy=remedy)
    unknown = sorted(set(map(str, seen)) - set(order))
    if unknown:
        remedy = f"Known points: {', '.join(order)}."
        raise InputError(f"point '{unknown[0]}' is not among the measured ones", where=where, remedy=remedy)
    pixels = np.array([_numbers(uv, (2,), f"{where}.{name}") for name, uv in seen.items()])
    ids = np.array([order[str(name)] for name in seen], np.int64)
    return TargetDetection(camera.name, 0, ids, pixels, (camera.width, camera.height), FLOOR, CLICKED_SD_PX)


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


def require_image_sizes(cameras: Cameras, detections: Iterable[TargetDetection]) -> None:
    """Raises InputError for images of another size than the camera's lens was calibrated for."""
    for detection in detections:
        camera = cameras[detection.camera]
        if detection.image_size != (camera.width, camera.height):
            raise InputError(
                f"its images are {detection.image_size[0]} x {detection.image_size[1]} pixels, its intrinsics are for "
                f"{camera.width} x {camera.height}",
                where=detection.camera,
                remedy="Calibrate the lens at the size that the camera delivers, or give footage of that size.",
            )


def _read(folder: Path, name: str) -> CameraModel:
    path = folder / f"{name}.yaml"
    if not path.is_file():
        files = sorted(file.stem for file in folder.glob("*.yaml") if not file.stem.endswith(".report"))
        there = f"it holds {', '.join(files)}" if files else "it holds no .yaml file"
        what = f"there is no {path.name} with the intrinsics of camera '{name}'; {there}"
        remedy = f"{CALIBRATE}, rename the footage or the file, or leave the camera out (--without {name})."
        raise InputError(what, where=str(folder), remedy=remedy)
    camera = read_camera_info(path)
    if camera.name != name:
        what = f"camera_name = '{camera.name}', but the footage is called '{name}'"
        remedy = "If the file belongs to this camera, correct camera_name in it; else give the right folder."
        raise InputError(what, where=str(path), remedy=remedy)
    return camera
