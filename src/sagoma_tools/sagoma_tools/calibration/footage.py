"""Opens footage of boards, camera by camera: videos, stills, folders of them, with frame indices that correspond.

A source is NAME=PATH, the footage of one camera: a video, a still, a folder of stills, or a pattern such as
``left=calib/left*.jpg``; or a PATH without a name, a folder (or pattern) with the footage of several cameras, or one
file. There, cameras are named by their files:

- ``camNN.*`` and ``camNN_ANYTHING.*`` belong to camera ``camNN``;
- other stills are numbered views of one camera: ``left01.jpg``, ``left_02.jpg`` of camera ``left``;
- other videos, stills without a number and sub-folders of stills are called as they are.

Pictures that several cameras took at the same time must carry the same frame index: the frame of a video, counted from
0; the number in a still's name, where every camera has numbered stills and most of the numbers are shared, else its
place in natural order (img2 before img10).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from camera_client.frame_source import UndecodableFrame
from camera_client.sources.footage_reader import FootageReader, Stills
from capture_rig.errors import InputError
from capture_rig.session import STILL_SUFFIXES, VIDEO_SUFFIXES
from capture_rig.video import Video

STILLS = (*STILL_SUFFIXES, ".tiff", ".pgm", ".ppm", ".webp")
VIDEOS = (*VIDEO_SUFFIXES, ".m4v", ".mpg", ".webm")
HELP = "Give a folder with camNN.mp4, camNN.png or camNN/*.jpg, one video or still, or NAME=PATH such as left='l*.jpg'."
MIN_SHARED_NUMBERS = 0.5


@dataclass(frozen=True)
class CameraFootage:
    """The footage of one camera: its files (one video, or stills), and the frame index of each still.

    Iterating gives ``(frame_index, image)``, image (H, W) uint8 grey; frames that cannot be decoded are left out.
    ``count``: images, as far as it is known beforehand (0: unknown).
    """

    name: str
    files: tuple[Path, ...]
    frames: tuple[int, ...] | None = None

    @property
    def is_video(self) -> bool:
        return self.frames is None

    @property
    def count(self) -> int:
        if self.frames is not None:
            return len(self.frames)
        reader = self._reader()
        reader.close()
        return reader.frame_count

    @property
    def fps(self) -> float:
        """Frame rate of a video, by its header; 0 for stills, and where the header tells no rate that a camera has."""
        if not self.is_video:
            return 0.0
        reader = self._reader()
        reader.close()
        return reader.fps

    @property
    def where(self) -> str:
        """For messages: the video or still, or the folder of the stills."""
        return str(self.files[0] if len(self.files) == 1 else self.files[0].parent)

    def __iter__(self) -> Iterator[tuple[int, npt.NDArray[np.uint8]]]:
        reader, place = self._reader(), 0
        try:
            while True:
                try:
                    image = reader.read()
                except UndecodableFrame:
                    place += 1
                    continue
                if image is None:
                    return
                yield (place if self.frames is None else self.frames[place]), image
                place += 1
        finally:
            reader.close()

    def _reader(self) -> FootageReader:
        if self.is_video:
            return FootageReader(Video(self.files[0], threads=1), "mono")
        return FootageReader(Stills(self.files[0].parent, list(self.files)), "mono")


@dataclass(frozen=True, eq=False)
class Shots:
    """Some pictures of one running camera, as footage: frame indices count from 0."""

    name: str
    pictures: tuple[np.ndarray, ...]

    @property
    def count(self) -> int:
        return len(self.pictures)

    def __iter__(self) -> Iterator[tuple[int, np.ndarray]]:
        return iter(enumerate(self.pictures))


Footage: TypeAlias = CameraFootage | Shots


def open_footage_of_cameras(sources: Sequence[str]) -> dict[str, CameraFootage]:
    """Footage by camera, in the order of the names. InputError for what does not exist, is empty, or gives a camera
    twice."""
    found: dict[str, tuple[str, list[Path]]] = {}
    for source in sources:
        for name, files in _cameras_of(source):
            if name in found:
                remedy = "Give each camera one source, and each its own name: NAME=PATH."
                raise InputError(f"camera '{name}' is given twice, by {found[name][0]} and by {source}", remedy=remedy)
            found[name] = source, files
    if not found:
        raise InputError("no footage is given", remedy=HELP)
    frames = _frame_indices({name: files for name, (_, files) in found.items()})
    return {
        name: CameraFootage(name, tuple(found[name][1]), frames[name]) for name in sorted(found, key=natural_sort_key)
    }


def natural_sort_key(text: str) -> tuple[tuple[int, int | str], ...]:
    """Sorting key: numbers in the text count as numbers."""
    return tuple((0, int(part)) if part.isdigit() else (1, part) for part in re.split(r"(\d+)", text) if part)


def _cameras_of(source: str) -> list[tuple[str, list[Path]]]:
    name, equals, path = source.partition("=")
    if equals and "/" not in name:
        if not name:
            raise InputError("a source begins with '='", where=source, remedy="Give NAME=PATH.")
        return [(name, _files_of_one(Path(path), source))]
    paths = _entries(Path(source), source)
    cameras: dict[str, list[Path]] = {}
    for entry in paths:
        cameras.setdefault(_camera_name(entry), []).append(entry)
    return [(camera, _one_piece(camera, entries, source)) for camera, entries in cameras.items()]


def _files_of_one(path: Path, source: str) -> list[Path]:
    """Return the files of NAME=PATH: one video, or stills."""
    files = [entry for entry in _inside(path, source) if _kind(entry)]
    videos = [file for file in files if _kind(file) == "video"]
    if not files:
        raise InputError("holds no video and no still", where=source, remedy=HELP)
    if videos and len(files) > 1:
        remedy = "Give one video a camera, or stills only."
        raise InputError(f"holds {len(files)} files, of which {videos[0].name} is a video", where=source, remedy=remedy)
    return files


def _entries(path: Path, source: str) -> list[Path]:
    """Videos, stills and folders of stills in a folder or pattern; or the one file."""
    usable = [entry for entry in _inside(path, source) if _kind(entry) or (entry.is_dir() and _stills_in(entry))]
    if not usable:
        raise InputError("holds no video and no still", where=source, remedy=HELP)
    return usable


def _inside(path: Path, source: str) -> list[Path]:
    """Return what is in a folder or fits a pattern, in natural order; else the one file, which has to be footage."""
    if path.is_dir() or any(mark in path.name for mark in "*?["):
        inside = path.iterdir() if path.is_dir() else path.parent.glob(path.name)
        return sorted(inside, key=lambda entry: natural_sort_key(entry.name))
    if not path.is_file():
        raise InputError("does not exist", where=source, remedy=HELP)
    if not _kind(path):
        remedy = f"Known are {', '.join(VIDEOS + STILLS)}."
        raise InputError(f"'{path.suffix}' is neither a video nor a still", where=source, remedy=remedy)
    return [path]


def _camera_name(entry: Path) -> str:
    stem = entry.name if entry.is_dir() else entry.stem
    if match := re.match(r"(cam(?:era)?[_-]?\d+)(?:[_-].*)?$", stem, re.I):
        return match.group(1)
    if _kind(entry) == "still" and (shared := re.sub(r"[_\-. ]*\d+$", "", stem)):
        return shared
    if _kind(entry) == "still" and stem.isdigit():
        return entry.resolve().parent.name
    return stem


def _one_piece(camera: str, entries: list[Path], source: str) -> list[Path]:
    """Return the files of one camera of a folder: one video, one folder, or stills that are numbered."""
    if len(entries) == 1:
        return _stills_in(entries[0]) if entries[0].is_dir() else entries
    unnumbered = [entry for entry in entries if _kind(entry) != "still" or _number(entry, camera) is None]
    if unnumbered:
        others = ", ".join(entry.name for entry in entries[:4])
        remedy = f"Take one away, or name it: {camera}={unnumbered[0]}."
        raise InputError(f"camera '{camera}' has several pieces of footage ({others})", where=source, remedy=remedy)
    return entries


def _stills_in(folder: Path) -> list[Path]:
    return [file for file in _inside(folder, str(folder)) if _kind(file) == "still"]


def _kind(path: Path) -> str:
    """ "video", "still", or "" for anything else."""
    if path.suffix.lower() in VIDEOS and path.is_file():
        return "video"
    return "still" if path.suffix.lower() in STILLS and path.is_file() else ""


def _number(file: Path, camera: str) -> int | None:
    """Return the last number in a still's name that is not part of the camera's."""
    stem = file.stem.removeprefix(camera)
    numbers = re.findall(r"\d+", stem)
    return int(numbers[-1]) if numbers else None


def _frame_indices(files: dict[str, list[Path]]) -> dict[str, tuple[int, ...] | None]:
    """For each camera the frame indices of its stills, None for a video."""
    numbers = {
        name: [_number(file, name) for file in some] for name, some in files.items() if _kind(some[0]) == "still"
    }
    numbered = len(numbers) == len(files) and _numbers_are_frames(list(numbers.values()))
    result: dict[str, tuple[int, ...] | None] = dict.fromkeys(files)
    for name, some in numbers.items():
        result[name] = tuple(n for n in some if n is not None) if numbered else tuple(range(len(some)))
    return result


def _numbers_are_frames(cameras: list[list[int | None]]) -> bool:
    """Return every still numbered, none twice in a camera, and most of each camera's numbers shared with another."""
    if any(None in numbers or len(set(numbers)) < len(numbers) for numbers in cameras):
        return False
    for one in cameras:
        others = set().union(*(set(other) for other in cameras if other is not one))
        if len(cameras) > 1 and len(others & set(one)) < MIN_SHARED_NUMBERS * min(len(one), len(others)):
            return False
    return True
