"""Decodes footage image by image: a video file, one still, a folder of stills or a pattern of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from capture_rig.errors import InputError
from capture_rig.session import STILL_SUFFIXES
from capture_rig.video import MONO_TOLERANCE as MONO_TOLERANCE
from capture_rig.video import Video, is_grey

from ..frame_source import Image, UndecodableFrame

PROBED = 3  # first images that tell whether footage has colour: the very first may be black


class Stills:
    """Stills in the order given, with the methods of a Video."""

    fps = 0.0

    def __init__(self, path: str | Path, files: list[Path]) -> None:
        self.path, self._files, self.frame_count, self._index = Path(path), files, len(files), 0

    def read(self) -> Image | None:
        """Return the next image, None after the last. Raises UndecodableFrame."""
        if self._index >= len(self._files):
            return None
        file = self._files[self._index]
        self._index += 1
        image = cv2.imread(str(file), cv2.IMREAD_ANYCOLOR)
        if image is None:
            raise UndecodableFrame(f"{file} cannot be decoded as an image")
        return image

    def rewind(self) -> None:
        self._index = 0

    def close(self) -> None:
        """Do nothing: stills are closed already."""


class FootageReader:
    """Images of one piece of footage in order. ``fps`` is the footage's own rate, 0 when it has none."""

    def __init__(self, images: Video | Stills, channels: str) -> None:
        self._images, self._channels = images, channels
        self.path, self.fps, self.frame_count = images.path, images.fps, images.frame_count
        self.rewind, self.close = images.rewind, images.close

    def read(self, loop: bool = False) -> Image | None:
        """The next image, (H, W) or (H, W, 3) as :meth:`probe` found; None after the last, or with ``loop`` the first.

        Raises UndecodableFrame, and in a loop InputError where the file went away.
        """
        image = self._images.read()
        if image is None and loop:
            self.rewind()
            image = self._images.read()
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
                image = self._images.read()
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


def open_footage(path: str | Path, channels: str = "auto") -> FootageReader:
    """The reader that fits ``path``: a video file, a still, a folder of stills, or a pattern such as ``f_*.png``.

    ``channels``: "mono", "colour", or "auto" (mono when the first images have no colour). A video is decoded by one
    thread, for each further one holds several images. Raises InputError.
    """
    path = Path(path)
    is_pattern = any(mark in path.name for mark in "*?[")
    if is_pattern or path.is_dir():
        candidates = sorted(path.parent.glob(path.name) if is_pattern else path.iterdir())
        files = [file for file in candidates if file.suffix.lower() in STILL_SUFFIXES]
        if not files:
            remedy = f"Put files with {', '.join(STILL_SUFFIXES)} there."
            raise InputError("holds no still image", where=str(path), remedy=remedy)
        return FootageReader(Stills(path, files), channels)
    if not path.is_file():
        remedy = "Give a video, a folder of stills, or a pattern such as frames/*.png."
        raise InputError("does not exist", where=str(path), remedy=remedy)
    if path.suffix.lower() in STILL_SUFFIXES:
        return FootageReader(Stills(path, [path]), channels)
    return FootageReader(Video(path, threads=1), channels)


def convert_channels(image: Image, channels: str) -> Image:
    """Return the image as "mono" (H, W) or "colour" (H, W, 3) BGR; "auto" leaves it."""
    if channels == "mono" and image.ndim == 3:
        return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if channels == "colour" and image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return np.ascontiguousarray(image)
