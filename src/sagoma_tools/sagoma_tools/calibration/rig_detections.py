"""Finds the board or the wand in the pictures of all cameras; where it cannot, keeps what explains why.

:class:`RigSources` is where the pictures come from: :class:`FootageSources` reads files, rig_live the running cameras.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count, islice
from typing import Protocol

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.boards.board import Board, TargetDetection
from rig_calibration.boards.detector import diagnose_board, find_board
from rig_calibration.boards.four_corners import find_from_outer_corners
from rig_calibration.boards.wand import find_wand
from rig_calibration.extrinsics.calibrate import FLOOR, MOVING

from ..console import doing, until_stopped
from .footage import CameraFootage, Footage, open_footage_of_cameras
from .outer_corners import OuterCorners

FLOOR_FRAMES, MOVING_FRAMES = 15, 160
"""Of each camera's footage, at most so many frames are examined, evenly spread."""
MEDIAN_FRAMES = 9
SAME_RATE = 1e-3  # of the rate: as of a session's videos; 25 and 24.98 drift by a frame in a minute
MAX_BLUR_PX = 2.5
"""Corners of a board that is blurred more (sigma of its edges) are not used."""

Picture = np.ndarray
Corners = Mapping[str, OuterCorners]
Cameras = Mapping[str, CameraModel]
Find = Callable[[str, int, Picture], TargetDetection | None]
"""Searches a picture of a camera, with its frame index."""


@dataclass(frozen=True, eq=False)
class CameraDetections:
    """The detections of a board in one camera's footage.

    ``examined`` frames, of which ``blurred`` showed it blurred. ``picture`` : the first frame with a detection, or the
    first of all; ``refused`` : why corners given by hand were not taken.
    """

    camera: str
    detections: tuple[TargetDetection, ...]
    examined: int
    blurred: int
    picture: Picture
    refused: InputError | None = None


CamerasDetections = dict[str, CameraDetections]
"""By the cameras' names."""


def find_floor(footage: Mapping[str, Footage], board: Board, cameras: Cameras, corners: Corners) -> CamerasDetections:
    """Find the board on the floor in each camera's footage, from the given ``corners`` where they name the camera."""

    def find(name: str, frame_index: int, image: Picture) -> TargetDetection | None:
        if name in corners:
            given = corners[name].pixels
            return find_from_outer_corners(
                image, board, given, camera=name, frame_index=frame_index, target=FLOOR, model=cameras[name]
            )
        return find_board(image, board, camera=name, frame_index=frame_index, target=FLOOR, thorough=True)

    only = {name: given.frame for name, given in corners.items()}
    steps = {name: max(1, -(-clip.count // FLOOR_FRAMES)) for name, clip in footage.items()}
    return _in_all("board on the floor", footage, find, steps, only)


def missing_reason(seen: CameraDetections, board: Board | None) -> str:
    """Why the board was not found in a camera's footage."""
    if seen.refused is not None:
        return str(seen.refused)
    if seen.blurred:
        return f"the board is blurred in {seen.blurred} of {seen.examined} frames"
    if board is None:
        return f"the wand was not found in any of {seen.examined} frame(s)"
    diagnosis = diagnose_board(seen.picture, board)
    return diagnosis or f"the board was not found in any of {seen.examined} frame(s)"


def _median_picture(footage: Footage) -> Picture | None:
    """Return the static background: the median of some frames; None of footage with too few."""
    step = max(1, footage.count // MEDIAN_FRAMES)
    some = [image for index, (_, image) in enumerate(footage) if index % step == 0]
    return np.median(np.stack(some), axis=0).astype(np.uint8) if len(some) >= MEDIAN_FRAMES else None


def _in_all(
    what: str,
    footage: Mapping[str, Footage],
    find: Find,
    steps: Mapping[str, int],
    only: Mapping[str, int | None],
    max_blur_px: float = MAX_BLUR_PX,
) -> CamerasDetections:
    """Search all cameras in parallel, one thread a processor, counting pictures; results in order of the names."""
    if not footage:
        return {}
    done, counted, names = (
        doing(f"looking for the {what} in {len(footage)} cameras' pictures"),
        count(1),
        sorted(footage),
    )

    def look(name: str, frame_index: int, image: Picture) -> TargetDetection | None:
        done(next(counted))
        return find(name, frame_index, image)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [pool.submit(_in_one, footage[name], look, steps[name], only.get(name), max_blur_px) for name in names]
        found = {name: job.result() for name, job in zip(names, jobs, strict=True)}
    until_stopped()
    return found


def _in_one(footage: Footage, find: Find, step: int, only: int | None, max_blur_px: float) -> CameraDetections:
    detections: list[TargetDetection] = []
    examined = blurred = 0
    picture: Picture | None = None
    refused: InputError | None = None
    for frame_index, image in _frames(footage, step, only):
        examined += 1
        picture = image if picture is None else picture
        try:
            detection = find(footage.name, frame_index, image)
        except InputError as error:
            refused, detection = refused or error, None
        if detection is not None and detection.blur_px > max_blur_px:
            blurred, detection = blurred + 1, None
        if detection is not None:
            picture = picture if detections else image
            detections.append(detection)
    if picture is None:
        what = f"has no frame {only}" if only is not None else "has no frame"
        raise InputError(what, where=footage.name, remedy="Give a frame that exists, or footage that can be decoded.")
    return CameraDetections(
        footage.name, tuple(detections), examined, blurred, picture, None if detections else refused
    )


def _frames(footage: Footage, step: int, only: int | None) -> Iterator[tuple[int, Picture]]:
    if only is not None:
        return islice(((frame_index, image) for frame_index, image in footage if frame_index == only), 1)
    return ((frame_index, image) for frame_index, image in footage if frame_index % step == 0)


def detections_of(seen: CamerasDetections) -> Sequence[TargetDetection]:
    """Return the detections of all cameras."""
    return [detection for found in seen.values() for detection in found.detections]


class RigSources(Protocol):
    """Pictures of a rig's cameras. ``names`` are all its cameras."""

    names: tuple[str, ...]

    def detect_floor(self, board: Board, cameras: Cameras, corners: Corners) -> CamerasDetections:
        """Return the board on the floor, in the pictures of those of ``cameras`` that have any."""

    def detect_moving(self, board: Board, cameras: Cameras) -> CamerasDetections:
        """Return the carried board in their pictures."""

    def detect_wand(self, marks_m: Sequence[float], cameras: Cameras) -> CamerasDetections:
        """Return the carried wand with markers at ``marks_m`` in their pictures."""


class FootageSources:
    """Stills and videos. Raises InputError for footage that cannot be read."""

    def __init__(
        self, floor: Sequence[str], moving: Sequence[str], wand: Sequence[str], without: Sequence[str]
    ) -> None:
        self._floor, self._moving, self._wand = (
            open_footage_of_cameras(sources) if sources else {} for sources in (floor, moving, wand)
        )
        every = self._floor.keys() | self._moving.keys() | self._wand.keys()
        unknown = sorted(set(without) - every)
        if unknown:
            what = f"there is no footage of camera '{unknown[0]}' to leave out"
            raise InputError(what, where="--without", remedy=f"Known cameras: {', '.join(sorted(every))}.")
        self.names = tuple(sorted(every - set(without)))

    def detect_floor(self, board: Board, cameras: Cameras, corners: Corners) -> CamerasDetections:
        return find_floor(
            {name: clip for name, clip in self._floor.items() if name in cameras}, board, cameras, corners
        )

    def detect_moving(self, board: Board, cameras: Cameras) -> CamerasDetections:
        def find(name: str, frame_index: int, image: Picture) -> TargetDetection | None:
            return find_board(image, board, camera=name, frame_index=frame_index, target=MOVING)

        return _find_carried("carried board", self._moving, cameras, find)

    def detect_wand(self, marks_m: Sequence[float], cameras: Cameras) -> CamerasDetections:
        empty = {name: _median_picture(clip) for name, clip in self._wand.items()}  # static lamps are no markers

        def find(name: str, frame_index: int, image: Picture) -> TargetDetection | None:
            return find_wand(image, marks_m, cameras[name], frame_index=frame_index, background=empty[name])

        return _find_carried("wand", self._wand, cameras, find, np.inf)


def _find_carried(
    what: str, clips: Mapping[str, CameraFootage], cameras: Cameras, find: Find, max_blur_px: float = MAX_BLUR_PX
) -> CamerasDetections:
    """Find what is carried at the same frames of every camera. Raises InputError when videos have several frame rates:
    their frames do not correspond."""
    footage = {name: clip for name, clip in clips.items() if name in cameras}
    rates = {name: clip.fps for name, clip in footage.items() if clip.fps}
    if rates and max(rates.values()) - min(rates.values()) > SAME_RATE * max(rates.values()):
        listed = ", ".join(f"{name} {rate:g}" for name, rate in rates.items())
        said = f"the videos have different frame rates ({listed} fps): frame k of each is not of the same instant"
        remedy = "Record at one rate, or bring them to one: ffmpeg -i IN -r RATE -c:v libx264 -crf 16 OUT.mp4."
        raise InputError(said, where=", ".join(clips[name].where for name in rates), remedy=remedy)
    step = max(1, -(-max((clip.count for clip in footage.values()), default=0) // MOVING_FRAMES))
    return _in_all(what, footage, find, dict.fromkeys(footage, step), {}, max_blur_px)
