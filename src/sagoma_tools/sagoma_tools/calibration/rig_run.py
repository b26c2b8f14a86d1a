"""The extrinsic calibration from pictures to files: what ``sagoma calibrate extrinsics`` does, step by step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from rich.console import Console

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.boards.board import Board
from rig_calibration.extrinsics.calibrate import RigCalibration, calibrate_rig

from .clicking import read_corners
from .floor_points import names_in_floor_points, read_floor_points
from .rig_by_hand import click_missing
from .rig_inputs import RigInputs, floor_inputs, moving_inputs, require_seen, together, wand_inputs
from .rig_intrinsics import read_intrinsics, read_lens_deviations, require_image_sizes
from .rig_outputs import write_outputs
from .rig_report import print_report
from .rig_request import RigRequest
from .rig_sightings import Seen, sightings_of
from .rig_sources import RigSources


def calibrate_extrinsics(request: RigRequest, sources: RigSources, console: Console) -> RigCalibration:
    """See, solve, judge, print, write. Raises InputError with the remedy for what cannot be solved."""
    cameras = read_intrinsics(request.intrinsics, _names(request, sources))
    floor, by_hand = _see_floor(request, sources, cameras, console)
    moving = sources.see_moving(request.board, cameras) if request.board is not None else {}
    wands = sources.see_wand(request.wand_marks_m, cameras)
    for seen in (floor, moving, wands):
        require_image_sizes(cameras, sightings_of(seen))
    parts = [*_floor_parts(request, cameras, floor, by_hand), *_moving_parts(request, cameras, moving, wands)]
    inputs = together(parts)
    require_seen(cameras, inputs, _footage(request, floor, moving, wands))
    calibrated = calibrate_rig(
        cameras,
        inputs.sightings,
        inputs.targets,
        strays=inputs.strays,
        floor_guess=inputs.floor_guess,
        intrinsics_covariance=read_lens_deviations(request.intrinsics, cameras),
        tape=request.tape,
    )
    print_report(console, calibrated)
    pictures: dict[str, np.ndarray] = {name: seen.picture for name, seen in floor.items()}
    for path in write_outputs(request.output, calibrated, pictures, request.text):
        console.print(f"written: {path}")
    return calibrated


def _see_floor(
    request: RigRequest, sources: RigSources, cameras: Mapping[str, CameraModel], console: Console
) -> tuple[dict[str, Seen], frozenset[str]]:
    """What the pictures of the floor show, and the cameras whose corners a person gave."""
    board = request.floor_board
    if board is None:
        return {}, frozenset()
    corners = read_corners(request.corners) if request.corners is not None else {}
    unknown = sorted(set(corners) - set(sources.names) - set(request.without))
    if unknown:
        raise InputError(
            f"there is no camera '{unknown[0]}'",
            where=str(request.corners),
            remedy=f"Known cameras: {', '.join(sources.names)}.",
        )
    floor = sources.see_floor(board, cameras, corners)
    if request.click is not None and floor:
        clicked = click_missing(request, floor, cameras, board, console)
        again = {name: cameras[name] for name in clicked}
        floor |= sources.see_floor(board, again, clicked) if again else {}
        corners |= clicked
    return floor, frozenset(corners)


def _names(request: RigRequest, sources: RigSources) -> list[str]:
    """All cameras of which there are pictures, or points on the floor."""
    points = names_in_floor_points(request.floor_points) if request.floor_points is not None else []
    return sorted({*sources.names, *points} - set(request.without))


def _floor_parts(
    request: RigRequest, cameras: Mapping[str, CameraModel], floor: Mapping[str, Seen], by_hand: frozenset[str]
) -> Iterator[RigInputs]:
    if request.floor_points is not None:
        yield read_floor_points(request.floor_points, cameras)
    if any(seen.sightings for seen in floor.values()):
        assert request.floor_board is not None
        yield floor_inputs(floor, request.floor_board, request.choice, by_hand)


def _moving_parts(
    request: RigRequest, cameras: Mapping[str, CameraModel], moving: Mapping[str, Seen], wands: Mapping[str, Seen]
) -> Iterator[RigInputs]:
    if any(seen.sightings for seen in moving.values()):
        assert request.board is not None
        yield moving_inputs(cameras, sightings_of(moving), request.board, request.choice, request.floor_at)
    if any(seen.sightings for seen in wands.values()):
        yield wand_inputs(sightings_of(wands), request.wand_marks_m)


def _footage(
    request: RigRequest, floor: Mapping[str, Seen], moving: Mapping[str, Seen], wands: Mapping[str, Seen]
) -> dict[str, dict[str, tuple[Seen, Board | None]]]:
    """By kind and camera, what was seen and of which board (None: a wand), to explain why nothing was."""
    kinds = (("floor", floor, request.floor_board), ("moving", moving, request.board), ("wand", wands, None))
    return {kind: {name: (found, board) for name, found in seen.items()} for kind, seen, board in kinds}
