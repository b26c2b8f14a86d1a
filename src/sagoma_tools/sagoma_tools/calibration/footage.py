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
from contextlib import closing
from dataclasses import dataclass
from itertools import count
from pathlib import Path

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
    """

    name: str
    files: tuple[Path, ...]
    frames: tuple[int, ...] | None = None

    @property
    def is_video(self) -> bool:
        return self.frames is None

    def __len__(self) -> int:
        """Images, as far as it is known beforehand (0: unknown)."""
        with closing(self._reader()) as reader:
            return reader.frame_count

    @property
    def fps(self) -> float:
        """Frame rate of a video by its header; 0 for stills, and if the header has no camera's rate."""
        with closing(self._reader()) as reader:
            return reader.fps

    @property
    def where(self) -> str:
        """For messages: the video or still, or the folder of the stills."""
        return str(self.files[0] if len(self.files) == 1 else self.files[0].parent)

    def __iter__(self) -> Iterator[tuple[int, npt.NDArray[np.uint8]]]:
        with closing(self._reader()) as reader:
            for place in count():
                try:
                    image = reader.read()
                except UndecodableFrame:
                    continue
                if image is None:
                    return
                yield (place if self.frames is None else self.frames[place]), image

    def _reader(self) -> FootageReader:
        first = self.files[0]
        return FootageReader(Video(first, threads=1) if self.is_video else Stills(first, list(self.files)), "mono")


def open_footage_of_cameras(sources: Sequence[str]) -> dict[str, CameraFootage]:
    """Footage by camera, in the order of the names. InputError for missing or empty footage, or a camera given
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
    """Return the cameras of a source, each with its files: one video, or stills."""
    name, equals, path = source.partition("=")
    is_one = bool(equals) and "/" not in name
    if is_one and not name:
        raise InputError("a source begins with '='", where=source, remedy="Give NAME=PATH.")
    entries = [entry for entry in _inside(Path(path if is_one else source), source) if _kind(entry)]
    if not entries:
        raise InputError("holds no video and no still", where=source, remedy=HELP)
    cameras: dict[str, list[Path]] = {}
    for entry in entries:
        cameras.setdefault(name if is_one else _camera_name(entry), []).append(entry)
    for camera, files in cameras.items():
        if len(files) == 1:
            cameras[camera] = _stills_in(files[0]) if files[0].is_dir() else files
        elif odd := [one for one in files if _kind(one) != "still" or (not is_one and _number(one, camera) is None)]:
            others = ", ".join(entry.name for entry in files[:4])
            what, remedy = f"camera '{camera}' has several pieces of footage ({others})", "one video, or stills only"
            raise InputError(what, where=source, remedy=f"Name {remedy}: {camera}={odd[0]}.")
    return list(cameras.items())


def _inside(path: Path, source: str) -> list[Path]:
    """Return the files in a folder or of a pattern, in natural order; else the one file, which has to be footage."""
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


def _stills_in(folder: Path) -> list[Path]:
    return [file for file in _inside(folder, str(folder)) if file.suffix.lower() in STILLS and file.is_file()]


def _kind(path: Path) -> str:
    """ "video", "still", "folder" of stills, or "" for anything else."""
    if path.is_dir():
        return "folder" if _stills_in(path) else ""
    suffix = path.suffix.lower() if path.is_file() else ""
    return "video" if suffix in VIDEOS else "still" if suffix in STILLS else ""


def _number(file: Path, camera: str) -> int | None:
    """Return the last number in a still's name that is not part of the camera's."""
    stem = file.stem.removeprefix(camera)
    numbers = re.findall(r"\d+", stem)
    return int(numbers[-1]) if numbers else None


def _frame_indices(files: dict[str, list[Path]]) -> dict[str, tuple[int, ...] | None]:
    """For each camera the frame indices of its stills, None for a video: their numbers, where all are numbered, none
    twice in a camera, and most of each camera's are shared with another."""
    stills = {name: some for name, some in files.items() if _kind(some[0]) == "still"}
    numbers = {name: [_number(file, name) for file in some] for name, some in stills.items()}
    numbered = len(stills) == len(files)
    for name, own in numbers.items():
        others = {number for other, some in numbers.items() if other != name for number in some}
        shared = len(numbers) == 1 or len(others & set(own)) >= MIN_SHARED_NUMBERS * min(len(own), len(others))
        numbered &= shared and None not in own and len(set(own)) == len(own)
    chosen = numbers if numbered else {name: range(len(some)) for name, some in stills.items()}
    return {name: tuple(n for n in chosen[name] if n is not None) if name in stills else None for name in files}
