"""Decodes footage image by image: a video file, one still, a folder of stills or a pattern of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

import cv2
import numpy as np

from capture_rig.errors import InputError
from capture_rig.session import STILL_SUFFIXES
from capture_rig.video import MONO_TOLERANCE as MONO_TOLERANCE
from capture_rig.video import Video, VideoFacts, is_grey

from ..frame_source import Image, UndecodableFrame

PROBED = 3  # first images that tell whether footage has colour: the very first may be black


class FootageReader(ABC):
    """Images of one piece of footage in order. ``fps`` is the footage's own rate, 0 when it has none."""

    def __init__(self, path: str | Path, channels: str) -> None:
        self.path = Path(path)
        self._channels = channels
        self.fps = 0.0
        self.frame_count = 0

    @abstractmethod
    def rewind(self) -> None:
        """Start again before the first image."""

    @abstractmethod
    def _next(self) -> Image | None:
        """Return the next raw image, None after the last. Raises UndecodableFrame."""

    def close(self) -> None:  # noqa: B027 (stills are closed already)
        """Release the file."""

    def read(self) -> Image | None:
        """The next image, (H, W) or (H, W, 3) as :meth:`probe` found; None after the last. Raises UndecodableFrame."""
        image = self._next()
        return None if image is None else convert_channels(image, self._channels)

    def probe(self) -> tuple[int, ...]:
        """Return the images' shape, from the first one; settles whether they are mono or colour, and rewinds."""
        first, *more = self._first_images()
        if self._channels == "auto":
            self._channels = "mono" if all(map(is_grey, (first, *more))) else "colour"
        self.rewind()
        return convert_channels(first, self._channels).shape

    def _first_images(self) -> list[Image]:
        """Return one image, or as many as tell whether there is colour."""
        found: list[Image] = []
        while len(found) < (PROBED if self._channels == "auto" else 1):
            try:
                image = self._next()
            except UndecodableFrame as error:
                if found:
                    break
                raise InputError(str(error), where=str(self.path), remedy="Check the first image.") from None
            if image is None:
                break
            found.append(image)
        if not found:
            remedy = "Check the file with a video player."
            raise InputError("holds no image that can be decoded", where=str(self.path), remedy=remedy)
        return found


class VideoReader(FootageReader):
    """A video file, with one decoding thread (each further one holds several images), or OpenCV's own choice (0)."""

    def __init__(self, path: str | Path, channels: str, *, threads: int = 1) -> None:
        super().__init__(path, channels)
        self._video = Video(path, threads=threads)
        self.frame_count, self.fps = self._video.frame_count, self._video.fps

    def facts(self) -> VideoFacts:
        """Return what came of the video since its beginning."""
        return VideoFacts.of(self._video)

    def rewind(self) -> None:
        self._video.rewind()

    def close(self) -> None:
        self._video.close()

    def _next(self) -> Image | None:
        return self._video.read()


class StillsReader(FootageReader):
    """Stills in the order of their names."""

    def __init__(self, path: str | Path, files: list[Path], channels: str) -> None:
        super().__init__(path, channels)
        self._files, self.frame_count, self._index = files, len(files), 0

    def rewind(self) -> None:
        self._index = 0

    def _next(self) -> Image | None:
        if self._index >= len(self._files):
            return None
        file = self._files[self._index]
        self._index += 1
        image = cv2.imread(str(file), cv2.IMREAD_ANYCOLOR)
        if image is None:
            raise UndecodableFrame(f"{file} cannot be decoded as an image")
        return image


def open_footage(path: str | Path, channels: str = "auto") -> FootageReader:
    """The reader that fits ``path``: a video file, a still, a folder of stills, or a pattern such as ``f_*.png``.

    ``channels``: "mono", "colour", or "auto" (mono when the first images have no colour). Raises InputError.
    """
    path = Path(path)
    if any(mark in path.name for mark in "*?["):
        return StillsReader(path, _stills(path, sorted(path.parent.glob(path.name))), channels)
    if path.is_dir():
        return StillsReader(path, _stills(path, sorted(path.iterdir())), channels)
    if not path.is_file():
        raise InputError(
            "does not exist",
            where=str(path),
            remedy="Give a video, a folder of stills, or a pattern such as frames/*.png.",
        )
    if path.suffix.lower() in STILL_SUFFIXES:
        return StillsReader(path, [path], channels)
    return VideoReader(path, channels)


def convert_channels(image: Image, channels: str) -> Image:
    """Return the image as "mono" (H, W) or "colour" (H, W, 3) BGR; "auto" leaves it."""
    if channels == "mono" and image.ndim == 3:
        return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if channels == "colour" and image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return np.ascontiguousarray(image)


def _stills(path: Path, candidates: list[Path]) -> list[Path]:
    files = [file for file in candidates if file.suffix.lower() in STILL_SUFFIXES]
    if not files:
        raise InputError(
            "holds no still image", where=str(path), remedy=f"Put files with {', '.join(STILL_SUFFIXES)} there."
        )
    return files
