"""Imports a trial of HumanEva-I as a session folder: footage, empty room, rig and, where it is published, the truth."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rig import Rig, Volume, default_volume, save_rig

from .formats import (
    FIRST_USABLE_FRAME,
    CommonTime,
    Mocap,
    common_time,
    new_session_folder,
    read_c3d,
    read_cal,
    read_ofs,
    save_description,
    volume_around,
    write_truth_file,
)
from .humaneva_footage import Movie, Source, copy_footage, is_grey
from .humaneva_joints import Joints, joints, markers_mm, measures

CAMERAS = ("C1", "C2", "C3", "BW1", "BW2", "BW3", "BW4")
"""Colour before grey cameras: the order in which the data set's own code takes them."""


@dataclass(frozen=True)
class Trial:
    """The files of one trial, e.g. subject ``S2``, action ``Walking``, number 1; ``root`` holds S1 to S4."""

    root: Path
    subject: str
    action: str
    number: int

    def __post_init__(self) -> None:
        if not (self.root / self.subject).is_dir():
            subjects = sorted(p.name for p in self.root.glob("S[0-9]") if p.is_dir())
            have = f"It has {', '.join(subjects)}." if subjects else "Give the folder that holds S1, S2, S3, S4."
            raise InputError(f"has no folder '{self.subject}'", where=str(self.root), remedy=have)

    def __str__(self) -> str:
        return f"{self.subject} {self.action}_{self.number}"

    def video(self, camera: str) -> Path:
        return self._existing(self.folder / "Image_Data" / f"{self.action}_{self.number}_({camera}).avi")

    def calibration(self, camera: str) -> Path:
        return self._existing(self.folder / "Calibration_Data" / f"{camera}.cal")

    def offsets(self) -> dict[str, Path]:
        """Return the ``.ofs`` file of every camera that has one for this trial."""
        paths = {c: self.folder / "Sync_Data" / f"{self.action}_{self.number}_({c}).ofs" for c in CAMERAS}
        found = {camera: path for camera, path in paths.items() if path.is_file()}
        if not found:
            self._existing(paths["C1"])
        return found

    def mocap(self) -> Path:
        return self.folder / "Mocap_Data" / f"{self.action}_{self.number}.c3d"

    def static_mocap(self) -> Path:
        return self.folder / "Mocap_Data" / "Static.c3d"

    def measures(self) -> Path:
        return self.folder / "Mocap_Data" / f"{self.subject}.mp"

    def backgrounds(self, camera: str) -> list[Path]:
        """Return the movies of the empty room for a camera, at least one."""
        folder = self.root / "Background"
        found = sorted(folder.glob(f"Background_*_({camera}).avi"))
        if not found:
            remedy = "Unpack the data set's background movies there."
            raise InputError(f"has no Background_*_({camera}).avi", where=str(folder), remedy=remedy)
        return found

    @property
    def folder(self) -> Path:
        return self.root / self.subject

    def _existing(self, path: Path) -> Path:
        if path.is_file():
            return path
        pattern = re.sub(r"\([^)]*\)", "(*)", path.name).replace(f"{self.action}_{self.number}_", "*_")
        there = sorted({re.sub(r"_\(.*", "", p.stem) for p in path.parent.glob(pattern)})
        folder = path.parent.name
        remedy = f"{folder} has {', '.join(there)}." if there else f"Unpack {folder} of the data set."
        raise InputError("is not there", where=str(path), remedy=remedy)


@dataclass(frozen=True)
class Request:
    """What to import: cameras by the data set's names; common frames (first, last), counted from 1, or None for all."""

    trial: Trial
    cameras: tuple[str, ...]
    frames: tuple[int, int] | None = None
    with_truth: bool = True

    def __post_init__(self) -> None:
        first, last = self.frames or (FIRST_USABLE_FRAME, FIRST_USABLE_FRAME)
        if first < FIRST_USABLE_FRAME or last < first:
            what = f"{first} {last} is not a range of frames from {FIRST_USABLE_FRAME} on"
            raise InputError(what, where="--frames", remedy="The first five frames of a movie all show the same image.")

    @property
    def first_frame(self) -> int:
        return self.frames[0] if self.frames else FIRST_USABLE_FRAME

    @property
    def count(self) -> int | None:
        return self.frames[1] - self.frames[0] + 1 if self.frames else None


@dataclass(frozen=True)
class Summary:
    """What was written: frames, how many of them have a truth, each camera's movie of the empty room."""

    frames: int
    frames_with_truth: int
    empty_rooms: dict[str, str]


def import_trial(request: Request, folder: Path, progress: Callable[[int], None] = lambda done: None) -> Summary:
    """Write the session folder ``folder``; it appears whole or not at all. Raises InputError naming the file.

    World frame: Vicon's, z up, the floor at z = 0; metres.
    """
    trial = request.trial
    time = common_time({camera: read_ofs(path) for camera, path in trial.offsets().items()})
    sources = {camera: _source(request, time, camera, n) for n, camera in enumerate(request.cameras, 1)}
    cameras = tuple(_camera(trial, camera, source) for camera, source in sources.items())
    mocap = read_c3d(trial.mocap()) if request.with_truth else None
    sizes = measures(read_c3d(trial.static_mocap()), trial.measures()) if request.with_truth else None
    fps = _frame_rate(sources, time, mocap)
    with new_session_folder(folder) as partial:
        count, empty_rooms = copy_footage(sources, request.count, partial, fps, progress)
        frames = np.arange(request.first_frame, request.first_frame + count)
        with_truth = 0
        if mocap is not None and sizes is not None:
            with_truth = _write_truth(partial / "truth.csv", joints(mocap, time.mocap(frames), sizes), trial)
        save_rig(Rig(cameras, _volume(cameras, mocap, time.mocap(frames))), partial / "rig.yaml")
        of_cameras = {
            source.name: {"name": camera, "first_image": source.first_image, "background": empty_rooms[camera]}
            for camera, source in sources.items()
        }
        more = {
            "common_frames": [int(frames[0]), int(frames[-1])],
            "first_mocap_frame": round(float(time.mocap(frames[:1])[0]), 4),
        }
        save_description(partial, fps, f"HumanEva-I, {trial}", "humaneva", cameras=of_cameras, **more)
    return Summary(count, with_truth, empty_rooms)


def _source(request: Request, time: CommonTime, camera: str, number: int) -> Source:
    trial = request.trial
    if camera not in time.first_image:
        what = f"has no .ofs file of camera {camera} for {trial}"
        remedy = f"It has those of {', '.join(time.first_image)}."
        raise InputError(what, where=str(trial.folder / "Sync_Data"), remedy=remedy)
    first_image = time.image(camera, request.first_frame)
    return Source(trial.video(camera), first_image, trial.backgrounds(camera), f"cam{number:02d}")


def _camera(trial: Trial, camera: str, source: Source) -> CameraModel:
    with Movie(source.movie, is_grey(camera)) as movie:
        return read_cal(trial.calibration(camera), source.name, *movie.video.size_px)


def _frame_rate(sources: Mapping[str, Source], time: CommonTime, mocap: Mocap | None) -> float:
    """Frames a second by the motion capture's clock, else as the first movie states it."""
    if mocap is not None and mocap.rate_hz > 0:
        return mocap.rate_hz / time.mocap_per_frame
    camera, source = next(iter(sources.items()))
    with Movie(source.movie, is_grey(camera)) as movie:
        return movie.video.fps


def _write_truth(path: Path, found: Joints, trial: Trial) -> int:
    """Rows from the first known frame on, so that a track can start at the first row; unknown cells stay empty."""
    if not found.valid.any():
        what = f"no imported frame of {trial} has complete motion capture"
        remedy = "Import other frames, or footage alone with --no-truth."
        raise InputError(what, where=str(trial.mocap()), remedy=remedy)
    start = int(found.valid.argmax())
    points = {n: np.where(found.valid[:, None], p, np.nan)[start:] / 1000.0 for n, p in found.points_mm.items()}
    write_truth_file(path, np.arange(start, len(found.valid)), points)
    return int(found.valid.sum())


def _volume(cameras: tuple[CameraModel, ...], mocap: Mocap | None, positions: np.ndarray) -> Volume:
    """The box around all markers of the imported time, with a margin; from the cameras alone without motion capture."""
    if mocap is None:
        return default_volume(cameras)
    rows = slice(max(int(positions[0]) - 1, 0), int(positions[-1]) + 1)
    points = np.concatenate([track[rows] for track in markers_mm(mocap)]) / 1000.0
    return volume_around(points[(points != 0).any(axis=1)])
