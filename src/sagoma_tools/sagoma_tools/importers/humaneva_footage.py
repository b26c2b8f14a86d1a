"""Copies the footage of a trial, all cameras in step, and the movie of the empty room that fits it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from capture_rig.errors import InputError
from capture_rig.video import Video

from ..overlays import VideoFile
from .formats import COPY_AGAIN, FIRST_USABLE_FRAME

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


def read_in_step(videos: Mapping[str, Path], first: Mapping[str, int], count: int | None) -> Iterator[dict[str, Image]]:
    """Read ``count`` images of every camera, from its 1-based image ``first`` on.

    Without a count, until one movie ends. Raises InputError when a movie ends too early.
    """
    with ExitStack() as stack:
        movies = {camera: stack.enter_context(Movie(path, is_grey(camera))) for camera, path in videos.items()}
        for camera, movie in movies.items():
            movie.skip_to(first[camera])
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
        for images in read_in_step(
            {c: s.movie for c, s in sources.items()}, {c: s.first_image for c, s in sources.items()}, count
        ):
            for camera, image in images.items():
                if frames % COMPARE_EVERY == 0:
                    rooms[camera].compare(image)
                files[camera].write(image)
            frames += 1
            progress(frames)
    for camera, room in rooms.items():
        room.write(folder / f"{sources[camera].name}_background", fps)
    return frames, {camera: room.best.name for camera, room in rooms.items()}
