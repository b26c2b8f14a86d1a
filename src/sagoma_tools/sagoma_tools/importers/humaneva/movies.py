"""The data set's movies, read frame after frame from the beginning: seeking in them is not exact."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np

from capture_rig.errors import InputError

Image = np.ndarray


class Movie:
    """Images of a file in order; grey (h, w) or colour (h, w, 3), uint8."""

    def __init__(self, path: Path, grey: bool) -> None:
        self.path, self.grey = path, grey
        self._capture = cv2.VideoCapture(str(path))
        self.read_count = 0
        if not self._capture.isOpened():
            raise InputError(
                "cannot be opened as a video",
                where=str(path),
                remedy="Copy it again from the data set; it is a .avi with codec XVID.",
            )

    @property
    def fps(self) -> float:
        return float(self._capture.get(cv2.CAP_PROP_FPS))

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images."""
        return int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))

    def skip_to(self, number: int) -> None:
        """Make the 1-based image ``number`` the next one; InputError when the movie is shorter."""
        while self.read_count < number - 1:
            if not self._capture.grab():
                raise InputError(
                    f"ends after {self.read_count} images, before image {number}",
                    where=str(self.path),
                    remedy="Import other frames, or copy it again from the data set.",
                )
            self.read_count += 1

    def read(self) -> Image | None:
        """The next image, None at the end."""
        read, image = self._capture.read()
        if not read:
            return None
        self.read_count += 1
        return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if self.grey else image

    def images(self) -> Iterator[Image]:
        """All images that are left."""
        while (image := self.read()) is not None:
            yield image

    def __enter__(self) -> Movie:
        return self

    def __exit__(self, *raised: object) -> None:
        self._capture.release()


def is_grey(camera: str) -> bool:
    """Whether a camera of the data set is one of the grey ones."""
    return camera.startswith("BW")


def together(videos: Mapping[str, Path], first: Mapping[str, int], count: int | None) -> Iterator[dict[str, Image]]:
    """``count`` images of every camera, from its 1-based image ``first`` on; without a count, until one movie ends.

    Raises InputError when a movie ends too early.
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
                raise InputError(
                    f"ends after {movie.read_count} images, {(count or 1) - done} too early",
                    where=str(movie.path),
                    remedy="Import fewer frames.",
                )
            yield {camera: image for camera, image in images.items() if image is not None}
            done += 1
