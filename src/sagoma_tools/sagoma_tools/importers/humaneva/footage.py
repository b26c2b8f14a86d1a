"""Copies the footage of a trial, all cameras in step, and the empty room that fits it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from ..footage_file import FootageFile
from .empty_room import EmptyRoom
from .movies import is_grey, together

COMPARE_EVERY = 60
"""Images between those that the movies of the empty room are compared with."""


@dataclass(frozen=True)
class Source:
    """A camera's movie, its 1-based image to begin with, its movies of the empty room, and its name in the session."""

    movie: Path
    first_image: int
    empty_rooms: list[Path]
    name: str


@dataclass(frozen=True)
class Footage:
    """How many frames were copied, and which movie of the empty room was taken for each camera."""

    frames: int
    empty_rooms: dict[str, str]


def copy_footage(
    sources: dict[str, Source], count: int | None, folder: Path, fps: float, progress: Callable[[int], None]
) -> Footage:
    """Write NAME.mkv and NAME_background.mkv of every camera; without a count, until one movie ends."""
    rooms = {camera: EmptyRoom(source.empty_rooms, is_grey(camera)) for camera, source in sources.items()}
    frames = 0
    with ExitStack() as stack:
        files: dict[str, FootageFile] = {}
        for images in together(
            {c: s.movie for c, s in sources.items()}, {c: s.first_image for c, s in sources.items()}, count
        ):
            for camera, image in images.items():
                if camera not in files:
                    files[camera] = stack.enter_context(FootageFile(folder / sources[camera].name, fps, image))
                if frames % COMPARE_EVERY == 0:
                    rooms[camera].compare(image)
                files[camera].write(image)
            frames += 1
            progress(frames)
    for camera, room in rooms.items():
        room.write(folder / f"{sources[camera].name}_background", fps)
    return Footage(frames, {camera: room.best.name for camera, room in rooms.items()})
