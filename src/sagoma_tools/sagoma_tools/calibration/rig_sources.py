"""Where pictures for the rig's calibration come from: files here, running cameras in rig_live."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.progress import Progress

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.boards.board import Board

from .clicking import OuterCorners
from .footage import CameraFootage, open_footage_of_cameras
from .rig_sightings import Seen, find_floor, find_moving, find_wands

Corners = Mapping[str, OuterCorners]


class RigSources(ABC):
    """Pictures of a rig's cameras. ``names`` are all its cameras."""

    names: tuple[str, ...]

    @abstractmethod
    def see_floor(self, board: Board, cameras: Mapping[str, CameraModel], corners: Corners) -> dict[str, Seen]:
        """What those of ``cameras`` that have pictures of the floor show of the board there."""

    @abstractmethod
    def see_moving(self, board: Board, cameras: Mapping[str, CameraModel]) -> dict[str, Seen]:
        """What they show of the carried board."""

    @abstractmethod
    def see_wand(self, marks_m: Sequence[float], cameras: Mapping[str, CameraModel]) -> dict[str, Seen]:
        """What they show of the carried wand with markers at ``marks_m``."""


class FootageSources(RigSources):
    """Stills and videos. Raises InputError for footage that cannot be read."""

    def __init__(
        self, floor: Sequence[str], moving: Sequence[str], wand: Sequence[str], without: Sequence[str], console: Console
    ) -> None:
        self._floor, self._moving, self._wand = (_open(sources) for sources in (floor, moving, wand))
        every = self._floor.keys() | self._moving.keys() | self._wand.keys()
        unknown = sorted(set(without) - every)
        if unknown:
            raise InputError(
                f"there is no footage of camera '{unknown[0]}' to leave out",
                where="--without",
                remedy=f"Known cameras: {', '.join(sorted(every))}.",
            )
        self.names = tuple(sorted(every - set(without)))
        self._console = console

    def see_floor(self, board: Board, cameras: Mapping[str, CameraModel], corners: Corners) -> dict[str, Seen]:
        footage = {name: clip for name, clip in self._floor.items() if name in cameras}
        with self._progress("board on the floor", footage) as progress:
            return find_floor(footage, board, cameras, corners, progress.step)

    def see_moving(self, board: Board, cameras: Mapping[str, CameraModel]) -> dict[str, Seen]:
        footage = {name: clip for name, clip in self._moving.items() if name in cameras}
        if not footage:
            return {}
        with self._progress("carried board", footage) as progress:
            return find_moving(footage, board, progress.step)

    def see_wand(self, marks_m: Sequence[float], cameras: Mapping[str, CameraModel]) -> dict[str, Seen]:
        footage = {name: clip for name, clip in self._wand.items() if name in cameras}
        if not footage:
            return {}
        with self._progress("wand", footage) as progress:
            return find_wands(footage, marks_m, cameras, progress.step)

    def _progress(self, what: str, footage: Mapping[str, CameraFootage]) -> Counter:
        return Counter(self._console, what, footage)


class Counter:
    """Counts pictures on a terminal, silently elsewhere."""

    def __init__(self, console: Console, what: str, footage: Mapping[str, CameraFootage]) -> None:
        self._bar = Progress(console=console, transient=True, disable=not console.is_terminal)
        self._task = self._bar.add_task(f"looking for the {what} in {len(footage)} cameras' pictures", total=None)

    def step(self) -> None:
        """One more picture."""
        self._bar.advance(self._task)

    def __enter__(self) -> Counter:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()


def _open(sources: Sequence[str]) -> dict[str, CameraFootage]:
    return open_footage_of_cameras(sources) if sources else {}
