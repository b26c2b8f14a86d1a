"""Imports a trial of HumanEva-I as a session folder: footage, empty room, rig and, where it is published, the truth."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.files import replaced_folder
from capture_rig.rig import Rig, Volume, default_volume, save_rig
from capture_rig.video import Video

from ..overlays import VideoFile
from .formats import (
    COPY_AGAIN,
    FIRST_USABLE_FRAME,
    CommonTime,
    Mocap,
    common_time,
    read_c3d,
    read_cal,
    read_ofs,
    save_description,
    volume_around,
    write_truth_file,
)
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

    @property
    def mocap(self) -> Path:
        return self.folder / "Mocap_Data" / f"{self.action}_{self.number}.c3d"

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
    mocap = read_c3d(trial.mocap) if request.with_truth else None
    beside = trial.mocap.with_name("Static.c3d"), trial.mocap.with_name(f"{trial.subject}.mp")
    sizes = measures(read_c3d(beside[0]), beside[1]) if request.with_truth else None
    fps = _frame_rate(sources, time, mocap)
    with replaced_folder(folder) as partial:
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
        span, first = [int(frames[0]), int(frames[-1])], round(float(time.mocap(frames[:1])[0]), 4)
        about = {"cameras": of_cameras, "common_frames": span, "first_mocap_frame": first}
        save_description(partial, fps, f"HumanEva-I, {trial}", "humaneva", **about)
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
        raise InputError(what, where=str(trial.mocap), remedy=remedy)
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


# footage, all cameras in step ----------------------------------------------------------------------------------------


LOSSLESS = ".mkv"
MAX_ROOM_IMAGES = 300
MEAN_IMAGES = 30  # enough for the noise to average out
COMPARE_EVERY = 60  # images between those that are compared with the movies of the empty room
REMEDY = f"{COPY_AGAIN[:-1]}; it is a .avi with codec XVID."
Image = np.ndarray


class Movie:
    """Reads the images of a movie in order; grey (h, w) or colour (h, w, 3), uint8. Raises InputError."""

    def __init__(self, path: Path, grey: bool) -> None:
        self.path, self.grey = path, grey
        self.video = Video(path, remedy=REMEDY)
        self.read_count = 0

    def skip_to(self, number: int) -> None:
        """Make the 1-based image ``number`` the next one. Raises InputError when the movie is shorter."""
        self.read_count += self.video.skip(number - 1 - self.read_count)
        if self.read_count < number - 1:
            what = f"ends after {self.read_count} images, before image {number}"
            remedy = "Import other frames, or copy it again from the data set."
            raise InputError(what, where=str(self.path), remedy=remedy)

    def read(self) -> Image | None:
        """Return the next image, None at the end."""
        image = self.video.read()
        if image is None:
            return None
        self.read_count += 1
        return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if self.grey else image

    def images(self) -> Iterator[Image]:
        """Yield all remaining images."""
        while (image := self.read()) is not None:
            yield image

    def __enter__(self) -> Movie:
        return self

    def __exit__(self, *raised: object) -> None:
        self.video.close()


def is_grey(camera: str) -> bool:
    """Return whether a camera of the data set is one of the grey ones."""
    return camera.startswith("BW")


def read_in_step(sources: Mapping[str, Source], count: int | None) -> Iterator[dict[str, Image]]:
    """Read ``count`` images of every camera, from its first one on.

    Without a count, until one movie ends. Raises InputError when a movie ends too early.
    """
    with ExitStack() as stack:
        movies = {camera: stack.enter_context(Movie(one.movie, is_grey(camera))) for camera, one in sources.items()}
        for camera, movie in movies.items():
            movie.skip_to(sources[camera].first_image)
        done = 0
        while count is None or done < count:
            images = {camera: movie.read() for camera, movie in movies.items()}
            ended = [camera for camera, image in images.items() if image is None]
            if ended and count is None and done:
                return
            if ended:
                movie = movies[ended[0]]
                what = f"ends after {movie.read_count} images, {(count or 1) - done} too early"
                raise InputError(what, where=str(movie.path), remedy="Import fewer frames.")
            yield {camera: image for camera, image in images.items() if image is not None}
            done += 1


class EmptyRoom:
    """Chooses the movie of the empty room nearest to a trial: three were taken in a week, and the light changed.

    The difference is the median over the pixels, which a person in the image does not change.
    """

    def __init__(self, movies: list[Path], grey: bool) -> None:
        self._movies, self._grey = movies, grey
        self._means = [self._mean(path) for path in movies]
        self._differences: list[list[float]] = []

    def compare(self, image: Image) -> None:
        """Add an image of the trial to the comparison. Raises InputError when it has another size than the movies."""
        for path, mean in zip(self._movies, self._means, strict=True):
            if mean.shape != image.shape:
                what = f"its images have shape {mean.shape}, those of the trial {image.shape}"
                raise InputError(what, where=str(path), remedy=COPY_AGAIN)
        self._differences.append([float(np.median(np.abs(image - mean))) for mean in self._means])

    @property
    def best(self) -> Path:
        """The movie nearest to the images compared so far."""
        return self._movies[int(np.mean(self._differences, axis=0).argmin())]

    def write(self, stem: Path, fps: float) -> None:
        """Copy the best movie's usable images."""
        with self._open(self.best) as movie:
            images = islice(movie.images(), MAX_ROOM_IMAGES)
            with VideoFile(stem.with_name(stem.name + LOSSLESS), fps) as footage:
                for image in images:
                    footage.write(image)

    def _mean(self, path: Path) -> np.ndarray:
        with self._open(path) as movie:
            images = list(islice(movie.images(), MEAN_IMAGES))
        if not images:
            raise InputError(f"has fewer than {FIRST_USABLE_FRAME} images", where=str(path), remedy=COPY_AGAIN)
        return np.asarray(np.mean(images, axis=0, dtype=np.float32))

    def _open(self, path: Path) -> Movie:
        movie = Movie(path, self._grey)
        movie.skip_to(FIRST_USABLE_FRAME)
        return movie


@dataclass(frozen=True)
class Source:
    """A camera's movie, its 1-based image to begin with, its movies of the empty room, and its name in the session."""

    movie: Path
    first_image: int
    empty_rooms: list[Path]
    name: str


def copy_footage(
    sources: dict[str, Source], count: int | None, folder: Path, fps: float, progress: Callable[[int], None]
) -> tuple[int, dict[str, str]]:
    """Write NAME.mkv and NAME_background.mkv of every camera; without a count, until one movie ends.

    Returns the number of frames, and the movie of the empty room chosen for each camera.
    """
    rooms = {camera: EmptyRoom(source.empty_rooms, is_grey(camera)) for camera, source in sources.items()}
    frames = 0
    with ExitStack() as stack:
        files = {
            camera: stack.enter_context(VideoFile(folder / (source.name + LOSSLESS), fps))
            for camera, source in sources.items()
        }
        for images in read_in_step(sources, count):
            for camera, image in images.items():
                if frames % COMPARE_EVERY == 0:
                    rooms[camera].compare(image)
                files[camera].write(image)
            frames += 1
            progress(frames)
    for camera, room in rooms.items():
        room.write(folder / f"{sources[camera].name}_background", fps)
    return frames, {camera: room.best.name for camera, room in rooms.items()}
