"""Finds the board in the footage of all cameras, and keeps what is needed to say why where it cannot."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Protocol

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.boards.board import Board
from rig_calibration.boards.detection import find_board
from rig_calibration.boards.diagnosis import diagnose_board
from rig_calibration.boards.sharpness import blur_px
from rig_calibration.boards.sighting import Sighting
from rig_calibration.bundle.wand import find_wand
from rig_calibration.extrinsics.calibrate import FLOOR, MOVING, WAND

from .clicking import OuterCorners, find_from_clicks

FLOOR_FRAMES, MOVING_FRAMES = 15, 160
"""Of each camera's footage, at most so many frames are examined, evenly spread."""
MEDIAN_FRAMES = 9
MOST_BLUR_PX = 2.5
"""Corners of a board that is blurred more (sigma of its edges) are not used."""

Picture = np.ndarray


class Footage(Protocol):
    """Pictures of one camera: how many (0: unknown), each with its moment."""

    @property
    def name(self) -> str: ...

    @property
    def count(self) -> int: ...

    def __iter__(self) -> Iterator[tuple[int, Picture]]: ...


@dataclass(frozen=True, eq=False)
class Seen:
    """What one camera's footage shows of a board.

    ``examined`` frames, of which ``blurred`` showed it blurred. ``picture`` : the first frame with a sighting, or the
    first of all; ``refused`` : why corners given by hand were not taken.
    """

    camera: str
    sightings: tuple[Sighting, ...]
    examined: int
    blurred: int
    picture: Picture
    refused: InputError | None = None


def find_floor(
    footage: Mapping[str, Footage],
    board: Board,
    cameras: Mapping[str, CameraModel],
    corners: Mapping[str, OuterCorners],
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Seen]:
    """The board on the floor in each camera's footage; where ``corners`` names the camera, from those."""

    def find(name: str, moment: int, image: Picture) -> Sighting | None:
        if name in corners:
            return find_from_clicks(
                image, board, corners[name].pixels, model=cameras[name], moment=moment, target=FLOOR
            )
        return find_board(image, board, camera=name, moment=moment, target=FLOOR, thorough=True)

    only = {name: given.frame for name, given in corners.items()}
    steps = {name: max(1, -(-clip.count // FLOOR_FRAMES)) for name, clip in footage.items()}
    return _in_all(footage, find, steps, only, progress)


def find_moving(
    footage: Mapping[str, Footage], board: Board, progress: Callable[[], None] = lambda: None
) -> dict[str, Seen]:
    """The carried board in all footage, at the same frames of every camera."""
    find = partial(_find_carried, board)
    return _in_all(footage, find, dict.fromkeys(footage, _common_step(footage)), {}, progress)


def find_wands(
    footage: Mapping[str, Footage],
    marks_m: Sequence[float],
    cameras: Mapping[str, CameraModel],
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Seen]:
    """The wand's markers in all footage, at the same frames of every camera; lamps that never move are no markers."""
    empty = {name: _median_picture(clip) for name, clip in footage.items()}

    def find(name: str, moment: int, image: Picture) -> Sighting | None:
        return find_wand(image, marks_m, cameras[name], moment=moment, target=WAND, background=empty[name])

    return _in_all(footage, find, dict.fromkeys(footage, _common_step(footage)), {}, progress, refuse_blurred=False)


def explain_unseen(seen: Seen, board: Board | None) -> str:
    """Why the board was not found in a camera's footage, as far as its picture tells."""
    if seen.refused is not None:
        return str(seen.refused)
    if seen.blurred:
        return f"the board is blurred in {seen.blurred} of {seen.examined} frames"
    if board is None:
        return f"the wand was not found in any of {seen.examined} frame(s)"
    diagnosis = diagnose_board(seen.picture, board)
    return diagnosis or f"the board was not found in any of {seen.examined} frame(s)"


def _common_step(footage: Mapping[str, Footage]) -> int:
    return max(1, -(-max(clip.count for clip in footage.values()) // MOVING_FRAMES))


def _median_picture(footage: Footage) -> Picture | None:
    """What does not move: the median of some frames; None of footage too short to tell."""
    step = max(1, footage.count // MEDIAN_FRAMES)
    some = [image for index, (_, image) in enumerate(footage) if index % step == 0]
    return np.median(np.stack(some), axis=0).astype(np.uint8) if len(some) >= MEDIAN_FRAMES else None


def _find_carried(board: Board, name: str, moment: int, image: Picture) -> Sighting | None:
    return find_board(image, board, camera=name, moment=moment, target=MOVING)


def _in_all(
    footage: Mapping[str, Footage],
    find: Callable[[str, int, Picture], Sighting | None],
    steps: Mapping[str, int],
    only: Mapping[str, int | None],
    progress: Callable[[], None],
    refuse_blurred: bool = True,
) -> dict[str, Seen]:
    """All cameras at once, as far as there are processors; by name, in order."""
    names = sorted(footage)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [pool.submit(_in_one, footage[n], find, steps[n], only.get(n), progress, refuse_blurred) for n in names]
        return {name: job.result() for name, job in zip(names, jobs, strict=True)}


def _in_one(
    footage: Footage,
    find: Callable[[str, int, Picture], Sighting | None],
    step: int,
    only: int | None,
    progress: Callable[[], None],
    refuse_blurred: bool,
) -> Seen:
    sightings: list[Sighting] = []
    examined = blurred = 0
    picture: Picture | None = None
    refused: InputError | None = None
    for moment, image in _frames(footage, step, only):
        examined += 1
        picture = image if picture is None else picture
        try:
            sighting = find(footage.name, moment, image)
        except InputError as error:
            refused, sighting = refused or error, None
        if sighting is not None and refuse_blurred and blur_px(image, sighting) > MOST_BLUR_PX:
            blurred, sighting = blurred + 1, None
        if sighting is not None:
            picture = picture if sightings else image
            sightings.append(sighting)
        progress()
    if picture is None:
        raise InputError(
            f"has no frame {only}" if only is not None else "has no frame",
            where=footage.name,
            remedy="Give a frame that exists, or footage that can be decoded.",
        )
    return Seen(footage.name, tuple(sightings), examined, blurred, picture, None if sightings else refused)


def _frames(footage: Footage, step: int, only: int | None) -> Iterator[tuple[int, Picture]]:
    if only is not None:
        return islice(((moment, image) for moment, image in footage if moment == only), 1)
    return ((moment, image) for moment, image in footage if moment % step == 0)


def sightings_of(seen: Mapping[str, Seen]) -> Sequence[Sighting]:
    """Those of all cameras."""
    return [sighting for found in seen.values() for sighting in found.sightings]
