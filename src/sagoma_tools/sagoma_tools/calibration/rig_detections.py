"""Finds the board or the wand in the pictures of all cameras, and keeps the reasons of failures.

The pictures are files here (:class:`FootageSources`), or those of the running cameras (rig_live.LiveSources).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.files import write_text
from capture_rig.yaml_file import read_mapping
from rig_calibration.boards.board import Board, TargetDetection
from rig_calibration.boards.detector import diagnose_board, find_board, find_from_outer_corners
from rig_calibration.boards.wand import find_wand
from rig_calibration.extrinsics.calibrate import FLOOR, MOVING

from ..console import doing, until_stopped
from .footage import CameraFootage, open_footage_of_cameras

FLOOR_FRAMES, MOVING_FRAMES = 15, 160
"""Frames of each camera's footage, at most, that are searched, evenly spread."""
MEDIAN_FRAMES = 9
SAME_RATE = 1e-3  # of the rate: as of a session's videos; 25 and 24.98 drift by a frame in a minute
MAX_BLUR_PX = 2.5
"""Corners of a board that is blurred more (sigma of its edges) are not used; a wand's markers have no blur."""

Picture = np.ndarray
Footage: TypeAlias = "CameraFootage | Sequence[tuple[int, Picture]]"
"""Frame indices and pictures of one camera."""
FORMAT = (
    "Write NAME: [[x, y], [x, y], [x, y], [x, y]] for each camera, or NAME: {corners: [...], frame: 12}: the outermost "
    "inner corners of the print in pixels, in reading order (first row's two ends, then the last row's last and first)."
)
GRID_STEP_PX, GRID_PICTURE_PX = 50, 1600


@dataclass(frozen=True, eq=False)
class OuterCorners:
    """The outermost inner corners as a person gave them: (4, 2) px, in one frame or (None) in all of them."""

    pixels: np.ndarray
    frame: int | None = None


Corners = Mapping[str, OuterCorners]
Cameras = Mapping[str, CameraModel]
Find = Callable[[Picture, int], TargetDetection | None]
"""Searches a picture of a camera, with its frame index."""


@dataclass(eq=False)
class CameraDetections:
    """The detections of a target in one camera's pictures.

    ``examined`` frames, of which ``blurred`` showed it blurred. ``picture`` : the first frame with a detection, or the
    first of all; ``refused`` : why corners given by hand were not taken.
    """

    find: Find
    detections: list[TargetDetection] = field(default_factory=list)
    examined: int = 0
    blurred: int = 0
    picture: Picture | None = None
    refused: InputError | None = None

    def examine(self, image: Picture, frame_index: int) -> TargetDetection | None:
        """Search one more picture; returns the detection when it is sharp."""
        self.examined += 1
        found = None
        try:
            found = self.find(image, frame_index)
        except InputError as error:
            self.refused = self.refused or error
        if found is not None and found.blur_px > MAX_BLUR_PX:
            self.blurred, found = self.blurred + 1, None
        if self.picture is None or (found is not None and not self.detections):
            self.picture = image
        self.detections += [] if found is None else [found]
        return found

    def missing_reason(self, board: Board | None) -> str:
        """Why nothing was found; ``board`` is None of a wand."""
        if self.refused is not None:
            return str(self.refused)
        if self.blurred:
            return f"the board is blurred in {self.blurred} of {self.examined} frames"
        diagnosis = None if board is None or self.picture is None else diagnose_board(self.picture, board)
        what = "wand" if board is None else "board"
        return diagnosis or f"the {what} was not found in any of {self.examined} frame(s)"


CamerasDetections = dict[str, CameraDetections]
"""By the cameras' names."""


def find_floor(footage: Mapping[str, Footage], board: Board, corners: Corners) -> CamerasDetections:
    """Find the board on the floor in each camera's footage, from the given ``corners`` where they name the camera."""

    def find(name: str, image: Picture, frame_index: int) -> TargetDetection | None:
        if name in corners:
            given = corners[name].pixels
            return find_from_outer_corners(image, board, given, camera=name, frame_index=frame_index, target=FLOOR)
        return find_board(image, board, camera=name, frame_index=frame_index, target=FLOOR, thorough=True)

    only = {name: given.frame for name, given in corners.items()}
    steps = {name: max(1, -(-len(clip) // FLOOR_FRAMES)) for name, clip in footage.items()}
    return _in_all("board on the floor", footage, find, steps, only)


def _in_all(
    what: str,
    footage: Mapping[str, Footage],
    find: Callable[[str, Picture, int], TargetDetection | None],
    steps: Mapping[str, int],
    only: Mapping[str, int | None],
) -> CamerasDetections:
    """Search all cameras in parallel, one thread a processor, counting pictures; results in order of the names."""
    if not footage:
        return {}
    done, counted = doing(f"looking for the {what} in {len(footage)} cameras' pictures"), count(1)
    names = sorted(footage)

    def search(name: str) -> CameraDetections:
        found, frame = CameraDetections(partial(find, name)), only.get(name)
        for frame_index, image in footage[name]:
            if frame_index % steps[name] == 0 if frame is None else frame_index == frame:
                done(next(counted))
                found.examine(image, frame_index)
                if frame is not None:
                    break
        if found.picture is None:
            what = "has no frame" if frame is None else f"has no frame {frame}"
            raise InputError(what, where=name, remedy="Give a frame that exists, or footage that can be decoded.")
        return found

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [pool.submit(search, name) for name in names]
        found = {name: job.result() for name, job in zip(names, jobs, strict=True)}
    until_stopped()
    return found


def detections_of(seen: CamerasDetections) -> Sequence[TargetDetection]:
    """Return the detections of all cameras."""
    return [detection for found in seen.values() for detection in found.detections]


class FootageSources:
    """Stills and videos of a rig, whose cameras are ``names``. Raises InputError for footage that cannot be read."""

    def __init__(
        self, floor: Sequence[str], moving: Sequence[str], wand: Sequence[str], without: Sequence[str]
    ) -> None:
        every = [open_footage_of_cameras(sources) if sources else {} for sources in (floor, moving, wand)]
        names = {name for clips in every for name in clips}
        unknown = sorted(set(without) - names)
        if unknown:
            what = f"there is no footage of camera '{unknown[0]}' to leave out"
            raise InputError(what, where="--without", remedy=f"Known cameras: {', '.join(sorted(names))}.")
        self.names = tuple(sorted(names - set(without)))
        self._floor, self._moving, self._wand = (
            {name: clip for name, clip in clips.items() if name in self.names} for clips in every
        )

    def detect_floor(self, board: Board, corners: Corners) -> CamerasDetections:
        return find_floor(self._floor, board, corners)

    def detect_moving(self, board: Board, cameras: Cameras) -> CamerasDetections:
        def find(name: str, image: Picture, frame_index: int) -> TargetDetection | None:
            return find_board(image, board, camera=name, frame_index=frame_index, target=MOVING)

        return _in_all("carried board", self._moving, find, _common_step(self._moving), {})

    def detect_wand(self, marks_m: Sequence[float], cameras: Cameras) -> CamerasDetections:
        empty = {name: _median_picture(clip) for name, clip in self._wand.items()}  # static lamps are no markers

        def find(name: str, image: Picture, frame_index: int) -> TargetDetection | None:
            return find_wand(image, marks_m, cameras[name], frame_index=frame_index, background=empty[name])

        return _in_all("wand", self._wand, find, _common_step(self._wand), {})


def _common_step(clips: Mapping[str, CameraFootage]) -> dict[str, int]:
    """Return the step from one frame to the next that is searched, the same for every camera. Raises InputError when
    videos have several frame rates: their frames do not correspond."""
    rates = {name: clip.fps for name, clip in clips.items() if clip.fps}
    if rates and max(rates.values()) - min(rates.values()) > SAME_RATE * max(rates.values()):
        listed = ", ".join(f"{name} {rate:g}" for name, rate in rates.items())
        said = f"the videos have different frame rates ({listed} fps): frame k of each is not of the same instant"
        remedy = "Record at one rate, or bring them to one: ffmpeg -i IN -r RATE -c:v libx264 -crf 16 OUT.mp4."
        raise InputError(said, where=", ".join(clips[name].where for name in rates), remedy=remedy)
    return dict.fromkeys(clips, max(1, -(-max(map(len, clips.values()), default=0) // MOVING_FRAMES)))


def _median_picture(footage: CameraFootage) -> Picture | None:
    """Return the static background: the median of some frames; None of footage with too few."""
    step = max(1, len(footage) // MEDIAN_FRAMES)
    some = [image for index, (_, image) in enumerate(footage) if index % step == 0]
    return np.median(np.stack(some), axis=0).astype(np.uint8) if len(some) >= MEDIAN_FRAMES else None


# --- Outer corners that a person gives.


def read_corners(path: str | Path) -> dict[str, OuterCorners]:
    """Corners by camera, from a YAML file. Raises InputError naming file, camera, value and remedy."""
    document = read_mapping(Path(path), FORMAT)
    return {str(name): _corners(entry, f"{path}: {name}") for name, entry in document.items()}


def _corners(entry: Any, where: str) -> OuterCorners:
    frame = None
    if isinstance(entry, Mapping):
        unknown = set(entry) - {"corners", "frame"}
        if unknown or "corners" not in entry:
            raise InputError(f"has the keys {sorted(map(str, entry))}", where=where, remedy=FORMAT)
        entry, frame = entry["corners"], entry.get("frame")
    if frame is not None and (not isinstance(frame, int) or isinstance(frame, bool) or frame < 0):
        raise InputError(f"frame = {frame!r} is not the number of a frame", where=where, remedy="Count from 0.")
    try:
        pixels = np.array(entry, float)
    except (TypeError, ValueError):
        pixels = np.empty(0)
    if pixels.shape != (4, 2) or not np.isfinite(pixels).all():
        raise InputError(f"{entry!r} is not four [x, y] corners", where=where, remedy=FORMAT)
    return OuterCorners(pixels, frame)


def write_corner_help(folder: Path, name: str, image: np.ndarray) -> Path:
    """Write NAME_click.png, the picture enlarged under a grid of pixel coordinates; returns its path."""
    from matplotlib.figure import Figure

    height, width = image.shape[:2]
    figure = Figure(figsize=(GRID_PICTURE_PX / 100, GRID_PICTURE_PX / 100 * height / width), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(image if image.ndim == 2 else image[..., ::-1], cmap="gray", vmin=0, vmax=255)
    axes.set(xticks=range(0, width, GRID_STEP_PX), yticks=range(0, height, GRID_STEP_PX))
    axes.tick_params(labelsize=7, labelrotation=45)
    axes.grid(color="#ffff00", linewidth=0.5)
    path = folder / f"{name}_click.png"
    figure.savefig(path, dpi=100)
    return path


def write_template(path: Path, names: list[str]) -> None:
    """Write a corners file whose numbers a person replaces."""
    lines = [f"# {FORMAT}", "# Replace every number; delete the cameras that need none."]
    lines += [f"{name}: [[0, 0], [1, 0], [1, 1], [0, 1]]" for name in names]
    write_text(path, "\n".join(lines) + "\n")
