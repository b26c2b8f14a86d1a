"""Which movie of the empty room fits a trial: three were taken in a week, and the light changed in between."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np

from capture_rig.errors import InputError

from ..footage_file import FootageFile
from .movies import Image, Movie
from .timing import FIRST_USABLE_FRAME

MOST_IMAGES = 300
MEAN_IMAGES = 30
"""Enough for a mean that the noise does not matter in."""


class EmptyRoom:
    """A camera's movies of the empty room, compared with images of a trial.

    The movie that differs least is the one: by the median over the pixels, which a person in the image does not move.
    """

    def __init__(self, movies: list[Path], grey: bool) -> None:
        self._movies, self._grey = movies, grey
        self._means = [self._mean(path) for path in movies]
        self._differences: list[list[float]] = []

    def compare(self, image: Image) -> None:
        """Take an image of the trial into account. Raises InputError when it has another size than the movies."""
        for path, mean in zip(self._movies, self._means, strict=True):
            if mean.shape != image.shape:
                raise InputError(
                    f"its images have shape {mean.shape}, those of the trial {image.shape}",
                    where=str(path),
                    remedy="Copy it again from the data set.",
                )
        self._differences.append([float(np.median(np.abs(image - mean))) for mean in self._means])

    @property
    def best(self) -> Path:
        """The movie nearest to the images compared so far."""
        return self._movies[int(np.mean(self._differences, axis=0).argmin())]

    def write(self, stem: Path, fps: float) -> None:
        """Copy the best movie's usable images."""
        with self._open(self.best) as movie:
            images = islice(movie.images(), MOST_IMAGES)
            first = next(images)
            with FootageFile(stem, fps, first) as footage:
                footage.write(first)
                for image in images:
                    footage.write(image)

    def _mean(self, path: Path) -> np.ndarray:
        with self._open(path) as movie:
            images = list(islice(movie.images(), MEAN_IMAGES))
        if not images:
            raise InputError(
                f"has fewer than {FIRST_USABLE_FRAME} images",
                where=str(path),
                remedy="Copy it again from the data set.",
            )
        return np.asarray(np.mean(images, axis=0, dtype=np.float32))

    def _open(self, path: Path) -> Movie:
        movie = Movie(path, self._grey)
        movie.skip_to(FIRST_USABLE_FRAME)
        return movie
