"""Cameras in whose pictures of the floor no board was found: a person clicks its corners, or reads them off."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from rich.console import Console

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.boards.board import Board
from rig_calibration.boards.sighting import Sighting
from rig_calibration.extrinsics.calibrate import FLOOR

from .clicking import OuterCorners, find_from_clicks, save_corners
from .rig_request import RigRequest
from .rig_sightings import Seen


def click_missing(
    request: RigRequest, floor: Mapping[str, Seen], cameras: Mapping[str, CameraModel], board: Board, console: Console
) -> dict[str, OuterCorners]:
    """Corners that a person clicks for the cameras asked for, or for all whose pictures show no board; saved beside the
    output. Without a display, pictures with a grid and a file to fill in are written, and InputError says so."""
    wanted = [name for name in request.click or [name for name, seen in floor.items() if not seen.sightings]]
    unknown = sorted(set(wanted) - set(floor))
    if unknown:
        raise InputError(
            f"there is no picture of the floor by '{unknown[0]}'",
            where="--click",
            remedy=f"Cameras with one: {', '.join(sorted(floor))}.",
        )
    if not wanted:
        return {}
    from .click_window import click_corners, open_display  # matplotlib takes a second to load

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


def _fit(picture: np.ndarray, board: Board, camera: CameraModel, outer_px: np.ndarray) -> Sighting:
    return find_from_clicks(picture, board, outer_px, model=camera, moment=0, target=FLOOR)


def _help_without_display(request: RigRequest, names: list[str], floor: Mapping[str, Seen]) -> InputError:
    from .click_window import write_click_help, write_template

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
