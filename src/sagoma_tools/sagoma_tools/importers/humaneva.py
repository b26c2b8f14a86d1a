"""Imports a trial of HumanEva-I as a session folder: footage, empty room, rig and, where it is published, the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
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
from capture_rig.video import Video, VideoFile

from .formats import (
    COPY_AGAIN,
    FIRST_USABLE_FRAME,
    Mocap,
    common_time,
    read_c3d,
    read_cal,
    read_ofs,
    save_description,
    volume_around,
    write_truth_file,
)
from .humaneva_joints import joints, markers_mm, measures

CAMERAS = ("C1", "C2", "C3", "BW1", "BW2", "BW3", "BW4")
"""Colour before grey cameras: the order in which the data set's own code takes them."""


@dataclass(frozen=True)
class Trial:
    """The files of one trial, e.g. subject ``S2``, action ``Walking``, number 1; ``root`` holds S1 to S4."""

    root: Path
    subject: str
    action: str
    number: int

    def __str__(self) -> str:
        return f"{self.subject} {self.action}_{self.number}"

    def video(self, camera: str) -> Path:
        return self._existing("Image_Data", f"{self.action}_{self.number}_({camera}).avi")

    def calibration(self, camera: str) -> Path:
        return self._existing("Calibration_Data", f"{camera}.cal")

    def offset(self, camera: str) -> Path:
        return self._existing("Sync_Data", f"{self.action}_{self.number}_({camera}).ofs")

    def has_offset(self, camera: str) -> bool:
        """Return whether there is an ``.ofs`` file of the camera: not every trial has those of all."""
        return (self.root / self.subject / "Sync_Data" / f"{self.action}_{self.number}_({camera}).ofs").is_file()

    @property
    def mocap(self) -> Path:
        return self.root / self.subject / "Mocap_Data" / f"{self.action}_{self.number}.c3d"

    def backgrounds(self, camera: str) -> list[Path]:
        """Return the movies of the empty room for a camera, at least one."""
        folder = self.root / "Background"
        found = sorted(folder.glob(f"Background_*_({camera}).avi"))
        if not found:
            remedy = "Unpack the data set's background movies there."
            raise InputError(f"has no Background_*_({camera}).avi", where=str(folder), remedy=remedy)
        return found

    def _existing(self, kind: str, name: str) -> Path:
        folder = self.root / self.subject / kind
        if not (folder / name).is_file():
            there = ", ".join(sorted(path.stem for path in folder.glob("*" + Path(name).suffix)))
            remedy = f"{self.subject} has {there}." if there else f"Unpack {kind} of {self.subject} there."
            raise InputError("is not there", where=str(folder / name), remedy=remedy)
        return folder / name


def import_trial(
    trial: Trial,
    folder: Path,
    cameras: Sequence[str] = CAMERAS,
    frames: tuple[int, int] | None = None,
    with_truth: bool = True,
    progress: Callable[[int], None] = lambda done: None,
) -> list[str]:
    """Write the session folder ``folder``, all or nothing; return its description, line by line.

    Raises InputError naming the file.

    cameras : by the data set's names. frames : common frames (first, last), counted from 1, or None for all.
    World frame: Vicon's, z up, the floor at z = 0; metres.
    """
    first, last = frames or (FIRST_USABLE_FRAME, FIRST_USABLE_FRAME)
    if first < FIRST_USABLE_FRAME or last < first:
        what = f"{first} {last} is not a range of frames from {FIRST_USABLE_FRAME} on"
        raise InputError(what, where="--frames", remedy="The first five frames of a movie all show the same image.")
    offsets = {c: read_ofs(trial.offset(c)) for c in CAMERAS if c in cameras or trial.has_offset(c)}
    time = common_time(offsets)
    sources = {
        c: Source(trial.video(c), time.image(c, first), trial.backgrounds(c), f"cam{n:02d}", c.startswith("BW"))
        for n, c in enumerate(cameras, 1)
    }
    models = tuple(read_cal(trial.calibration(c), one.name, *_header(one).size_px) for c, one in sources.items())
    fps, mocap, sizes = _header(next(iter(sources.values()))).fps, None, None
    if with_truth:
        mocap, folder_of = read_c3d(trial.mocap), trial.mocap.parent
        sizes = measures(read_c3d(folder_of / "Static.c3d"), folder_of / f"{trial.subject}.mp")
        fps = mocap.rate_hz / time.mocap_per_frame
    known = 0
    with replaced_folder(folder) as partial:
        count, empty_rooms = copy_footage(sources, last - first + 1 if frames else None, partial, fps, progress)
        instants = time.mocap(np.arange(first, first + count))
        if mocap is not None and sizes is not None:
            known = _write_truth(partial / "truth.csv", *joints(mocap, instants, *sizes), trial)
        save_rig(Rig(models, _volume(models, mocap, instants)), partial / "rig.yaml")
        of_cameras = {
            source.name: {"name": camera, "first_image": source.first_image, "background": empty_rooms[camera]}
            for camera, source in sources.items()
        }
        mocap_from = round(float(instants[0]), 4)
        about = {"cameras": of_cameras, "common_frames": [first, first + count - 1], "first_mocap_frame": mocap_from}
        save_description(partial, fps, f"HumanEva-I, {trial}", "humaneva", **about)
    return [
        f"{trial}: {count} frames of {', '.join(cameras)}",
        *(f"empty room of {camera}: {room}" for camera, room in empty_rooms.items()),
        *([f"motion capture is complete in {known} of them ({known / count:.0%})"] if with_truth else []),
    ]


def _header(source: Source) -> Video:
    """Return the movie, closed again: its header holds the images' size and their rate."""
    with Video(source.movie, remedy=REMEDY) as movie:
        return movie


def _write_truth(path: Path, points_mm: dict[str, np.ndarray], valid: np.ndarray, trial: Trial) -> int:
    """Rows from the first known frame on, so that a track can start at the first row; unknown cells stay empty."""
    if not valid.any():
        what = f"no imported frame of {trial} has complete motion capture"
        remedy = "Import other frames, or footage alone with --no-truth."
        raise InputError(what, where=str(trial.mocap), remedy=remedy)
    start = int(valid.argmax())
    points = {name: np.where(valid[:, None], one, np.nan)[start:] / 1000.0 for name, one in points_mm.items()}
    write_truth_file(path, np.arange(start, len(valid)), points)
    return int(valid.sum())


def _volume(cameras: tuple[CameraModel, ...], mocap: Mocap | None, positions: np.ndarray) -> Volume:
    """The box around all markers of the imported time, with a margin; from the cameras alone without motion capture."""
    if mocap is None:
        return default_volume(cameras)
    rows = slice(max(int(positions[0]) - 1, 0), int(positions[-1]) + 1)
    points = np.concatenate([track[rows] for track in markers_mm(mocap)]) / 1000.0
    return volume_around(points[np.isfinite(points).all(axis=1)])


# footage, all cameras in step ----------------------------------------------------------------------------------------


LOSSLESS = ".mkv"
MAX_ROOM_IMAGES = 300
MEAN_IMAGES = 30  # enough for the noise to average out
REMEDY = f"{COPY_AGAIN[:-1]}; it is a .avi with codec XVID."
Image = np.ndarray


@dataclass(frozen=True)
class Source:
    """A camera's movie, its 1-based image to begin with, its movies of the empty room, its name in the session, and
    whether it is a grey camera."""

    movie: Path
    first_image: int
    empty_rooms: list[Path]
    name: str
    grey: bool


def read_images(movie: Path, grey: bool, first: int) -> Iterator[Image]:
    """Yield a movie's images from the 1-based one ``first`` on, grey (h, w) or colour (h, w, 3), uint8.

    Raises InputError when the movie is shorter.
    """
    with Video(movie, remedy=REMEDY) as video:
        skipped = video.skip(first - 1)
        if skipped < first - 1:
            what = f"ends after {skipped} images, before image {first}"
            remedy = "Import other frames, or copy it again from the data set."
            raise InputError(what, where=str(movie), remedy=remedy)
        yield from (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if grey else image for image in video)


def nearest_room(source: Source, image: Image) -> Path:
    """Return the movie of the empty room nearest to an image: three were taken in a week, and the light changed.

    The difference is the median over the pixels, which a person in the image does not change. Raises InputError for a
    movie of images of another size, or without any.
    """
    differences = []
    for path in source.empty_rooms:
        images = list(islice(read_images(path, source.grey, FIRST_USABLE_FRAME), MEAN_IMAGES))
        if not images:
            raise InputError(f"has fewer than {FIRST_USABLE_FRAME} images", where=str(path), remedy=COPY_AGAIN)
        mean = np.mean(images, axis=0, dtype=np.float32)
        if mean.shape != image.shape:
            what = f"its images have shape {mean.shape}, those of the trial {image.shape}"
            raise InputError(what, where=str(path), remedy=COPY_AGAIN)
        differences.append(np.median(np.abs(image - mean)))
    return source.empty_rooms[int(np.argmin(differences))]


def copy_footage(
    sources: Mapping[str, Source], count: int | None, folder: Path, fps: float, progress: Callable[[int], None]
) -> tuple[int, dict[str, str]]:
    """Write NAME.mkv and NAME_background.mkv of every camera; without a count, until one movie ends.

    Returns the number of frames, and the movie of the empty room chosen for each camera, the nearest to its first
    image. Raises InputError when a movie ends too early.
    """
    rooms: dict[str, Path] = {}
    movies = [read_images(one.movie, one.grey, one.first_image) for one in sources.values()]
    done = 0
    with ExitStack() as stack:
        files = [stack.enter_context(VideoFile(folder / (one.name + LOSSLESS), fps)) for one in sources.values()]
        for images in islice(zip(*movies, strict=False), count):
            named = zip(sources.items(), images, strict=True)
            rooms = rooms or {camera: nearest_room(source, image) for (camera, source), image in named}
            for file, image in zip(files, images, strict=True):
                file.write(image)
            done += 1
            progress(done)
    if done < (count or 1):
        what = f"a movie ends after {done} common frames, {(count or 1) - done} too early"
        raise InputError(what, where=str(next(iter(sources.values())).movie.parent), remedy="Import fewer frames.")
    for camera, room in rooms.items():
        with VideoFile(folder / f"{sources[camera].name}_background{LOSSLESS}", fps) as footage:
            for image in islice(read_images(room, sources[camera].grey, FIRST_USABLE_FRAME), MAX_ROOM_IMAGES):
                footage.write(image)
    return done, {camera: room.name for camera, room in rooms.items()}
