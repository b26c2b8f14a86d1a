"""Calibrates a rig's extrinsics, from pictures to files: the recipe of ``sagoma calibrate extrinsics``."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from rich.console import Console

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.boards.board import Board, TargetDetection
from rig_calibration.extrinsics.calibrate import FLOOR, RigCalibration, calibrate_rig

from .clicking import (
    OuterCorners,
    click_corners,
    find_from_clicks,
    open_display,
    read_corners,
    save_corners,
    write_click_help,
    write_template,
)
from .rig_detections import CameraDetections, Cameras, CamerasDetections, RigSources, detections_of
from .rig_inputs import (
    RigInputs,
    floor_inputs,
    merge_inputs,
    moving_inputs,
    names_in_floor_points,
    read_floor_points,
    read_intrinsics,
    read_lens_deviations,
    require_image_sizes,
    require_seen,
    wand_inputs,
)
from .rig_report import print_report, write_outputs
from .rig_request import RigRequest


def calibrate_extrinsics(request: RigRequest, sources: RigSources, console: Console) -> RigCalibration:
    """Detect, solve, print, write. Raises InputError with the remedy for what cannot be solved."""
    cameras = read_intrinsics(request.intrinsics, _names(request, sources))
    floor, by_hand = _detect_floor(request, sources, cameras, console)
    moving = sources.detect_moving(request.board, cameras) if request.board is not None else {}
    wands = sources.detect_wand(request.wand_marks_m, cameras)
    for seen in (floor, moving, wands):
        require_image_sizes(cameras, detections_of(seen))
    parts = [*_floor_parts(request, cameras, floor, by_hand), *_moving_parts(request, cameras, moving, wands)]
    inputs = merge_inputs(parts)
    require_seen(cameras, inputs, _footage(request, floor, moving, wands))
    calibrated = calibrate_rig(
        cameras,
        inputs.detections,
        inputs.targets,
        moved_frames=inputs.moved_frames,
        floor_guess=inputs.floor_guess,
        intrinsics_sd=read_lens_deviations(request.intrinsics, cameras),
        refine_intrinsics=request.refine_intrinsics,
        tape=request.tape,
    )
    print_report(console, calibrated)
    pictures: dict[str, np.ndarray] = {name: seen.picture for name, seen in floor.items()}
    for path in write_outputs(request.output, calibrated, pictures, request.text):
        console.print(f"written: {path}")
    return calibrated


def _detect_floor(
    request: RigRequest, sources: RigSources, cameras: Cameras, console: Console
) -> tuple[CamerasDetections, frozenset[str]]:
    """Return the detections in the pictures of the floor, and the cameras whose corners a person gave."""
    board = request.floor_board
    if board is None:
        return {}, frozenset()
    corners = read_corners(request.corners) if request.corners is not None else {}
    unknown = sorted(set(corners) - set(sources.names) - set(request.without))
    if unknown:
        remedy = f"Known cameras: {', '.join(sources.names)}."
        raise InputError(f"there is no camera '{unknown[0]}'", where=str(request.corners), remedy=remedy)
    floor = sources.detect_floor(board, cameras, corners)
    if request.click is not None and floor:
        clicked = click_missing(request, floor, cameras, board, console)
        again = {name: cameras[name] for name in clicked}
        floor |= sources.detect_floor(board, again, clicked) if again else {}
        corners |= clicked
    return floor, frozenset(corners)


def _names(request: RigRequest, sources: RigSources) -> list[str]:
    """Return all cameras of which there are pictures, or points on the floor."""
    points = names_in_floor_points(request.floor_points) if request.floor_points is not None else []
    return sorted({*sources.names, *points} - set(request.without))


def _floor_parts(
    request: RigRequest, cameras: Cameras, floor: CamerasDetections, by_hand: frozenset[str]
) -> Iterator[RigInputs]:
    if request.floor_points is not None:
        yield read_floor_points(request.floor_points, cameras)
    if any(seen.detections for seen in floor.values()):
        assert request.floor_board is not None
        yield floor_inputs(floor, request.floor_board, request.choice, by_hand)


def _moving_parts(
    request: RigRequest, cameras: Cameras, moving: CamerasDetections, wands: CamerasDetections
) -> Iterator[RigInputs]:
    if any(seen.detections for seen in moving.values()):
        assert request.board is not None
        yield moving_inputs(cameras, detections_of(moving), request.board, request.choice, request.floor_at)
    if any(seen.detections for seen in wands.values()):
        yield wand_inputs(detections_of(wands), request.wand_marks_m)


def _footage(
    request: RigRequest, floor: CamerasDetections, moving: CamerasDetections, wands: CamerasDetections
) -> dict[str, dict[str, tuple[CameraDetections, Board | None]]]:
    """By kind and camera, the detections and their board (None: a wand), to explain missing ones."""
    kinds = (("floor", floor, request.floor_board), ("moving", moving, request.board), ("wand", wands, None))
    return {kind: {name: (found, board) for name, found in seen.items()} for kind, seen, board in kinds}


def click_missing(
    request: RigRequest, floor: CamerasDetections, cameras: Cameras, board: Board, console: Console
) -> dict[str, OuterCorners]:
    """Let a person click the corners for the requested cameras, or for all without a detection, and save them.

    Without a display, writes pictures with a grid and a file to fill in, and raises InputError naming them.
    """
    wanted = [name for name in request.click or [name for name, seen in floor.items() if not seen.detections]]
    unknown = sorted(set(wanted) - set(floor))
    if unknown:
        remedy = f"Cameras with one: {', '.join(sorted(floor))}."
        raise InputError(f"there is no picture of the floor by '{unknown[0]}'", where="--click", remedy=remedy)
    if not wanted:
        return {}
    if not open_display():
        raise _help_without_display(request, wanted, floor)
    clicked: dict[str, OuterCorners] = {}
    for name in wanted:
        fit = partial(_fit, floor[name].picture, board, cameras[name])
        outer = click_corners(name, floor[name].picture, fit)
        if outer is not None:
            clicked[name] = OuterCorners(outer)
    if clicked:
        path = request.output.with_suffix(".corners.yaml")
        path.parent.mkdir(parents=True, exist_ok=True)
        save_corners(path, clicked)
        console.print(f"clicked corners: {path} (give it with --corners next time)")
    return clicked


def _fit(picture: np.ndarray, board: Board, camera: CameraModel, outer_px: np.ndarray) -> TargetDetection:
    return find_from_clicks(picture, board, outer_px, model=camera, frame_index=0, target=FLOOR)


def _help_without_display(request: RigRequest, names: list[str], floor: CamerasDetections) -> InputError:
    folder = request.output.parent
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [write_click_help(folder, name, floor[name].picture) for name in names]
    template = request.output.with_suffix(".corners.yaml")
    write_template(template, names)
    return InputError(
        "there is no display to click on",
        where="--click",
        remedy=f"Read the outer corners off {', '.join(map(str, pictures))}, write them into {template}, and run this "
        f"again with --corners {template}.",
    )
