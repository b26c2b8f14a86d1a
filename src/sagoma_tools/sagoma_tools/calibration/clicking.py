"""Finds a board from its four outer corners, which a person gives by file or by clicks where detection fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.yaml_file import read_mapping, save_mapping
from rig_calibration.boards.board import Board, TargetDetection
from rig_calibration.boards.four_corners import find_from_outer_corners

FORMAT = (
    "Write NAME: [[x, y], [x, y], [x, y], [x, y]] for each camera, or NAME: {corners: [...], frame: 12}: the outermost "
    "inner corners of the print in pixels, in reading order (first row's two ends, then the last row's last and first)."
)


@dataclass(frozen=True, eq=False)
class OuterCorners:
    """The outermost inner corners as a person gave them: (4, 2) px, in one frame or (None) in all of them."""

    pixels: np.ndarray
    frame: int | None = None


def read_corners(path: str | Path) -> dict[str, OuterCorners]:
    """Corners by camera, from a YAML file. Raises InputError naming file, camera, value and remedy."""
    document = read_mapping(Path(path), FORMAT)
    return {str(name): _corners(entry, f"{path}: {name}") for name, entry in document.items()}


def save_corners(path: str | Path, corners: Mapping[str, OuterCorners]) -> None:
    """Write what :func:`read_corners` reads."""
    document = {}
    for name, given in sorted(corners.items()):
        points = np.round(given.pixels, 1).tolist()
        document[name] = points if given.frame is None else {"corners": points, "frame": given.frame}
    save_mapping(path, document, FORMAT, default_flow_style=None, width=120)


def find_from_clicks(
    image: np.ndarray, board: Board, outer_px: np.ndarray, *, model: CameraModel, frame_index: int, target: str
) -> TargetDetection:
    """The board's corners from four rough ones, refined; in whatever order they were clicked, if the board's colours or
    markers tell which way round it lies. Raises InputError when no order fits, for the order that was given."""
    refused: InputError | None = None
    for order in _orders(outer_px, board.half_turn_is_visible):
        try:
            return find_from_outer_corners(
                image, board, outer_px[order], camera=model.name, frame_index=frame_index, target=target, model=model
            )
        except InputError as error:
            refused = refused or error
    assert refused is not None
    raise refused


def _orders(outer_px: np.ndarray, told_apart: bool) -> list[list[int]]:
    """The given order first; then those that run around the board clockwise, as reading order does from in front."""
    given = [0, 1, 2, 3]
    if not told_apart:
        return [given]
    around = [order for order in map(list, permutations(given)) if _runs_clockwise(outer_px[order])]
    return [given, *(order for order in around if order != given)]


def _runs_clockwise(quadrangle: np.ndarray) -> bool:
    """Return whether it turns right at every corner, in an image (y down)."""
    edges = np.roll(quadrangle, -1, axis=0) - quadrangle
    following = np.roll(edges, -1, axis=0)
    return bool((edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0] > 0).all())


def _corners(entry: Any, where: str) -> OuterCorners:
    frame = None
    if isinstance(entry, Mapping):
        unknown = set(entry) - {"corners", "frame"}
        if unknown or "corners" not in entry:
            raise InputError(f"has the keys {sorted(map(str, entry))}", where=where, remedy=FORMAT)
        entry, frame = entry["corners"], entry.get("frame")
    if frame is not None and (not isinstance(frame, int) or isinstance(frame, bool) or frame < 0):
        raise InputError(f"frame = {frame!r} is not the number of a frame", where=where, remedy="Count from 0.")
    try:
        pixels = np.array(entry, float)
    except (TypeError, ValueError):
        pixels = np.empty(0)
    if pixels.shape != (4, 2) or not np.isfinite(pixels).all():
        raise InputError(f"{entry!r} is not four [x, y] corners", where=where, remedy=FORMAT)
    return OuterCorners(pixels, frame)


class Clicks:
    """Collects up to four clicks on one picture and detects the board from them; independent of the window.

    ``fit`` makes a detection of four corners (4, 2), or raises InputError, whose text is then shown.
    """

    def __init__(self, fit: Callable[[np.ndarray], TargetDetection]) -> None:
        self._fit = fit
        self.points: list[tuple[float, float]] = []
        self.detection: TargetDetection | None = None
        self.message = self._next_step()

    def add(self, x: float, y: float) -> None:
        """Add a corner; with the fourth the board is detected, and all four are dropped when that fails."""
        if len(self.points) == 4:
            return
        self.points.append((x, y))
        self.message = self._next_step()
        if len(self.points) == 4:
            self._try()

    def undo(self) -> None:
        """Remove the last corner."""
        self.points, self.detection = self.points[:-1], None
        self.message = self._next_step()

    @property
    def pixels(self) -> np.ndarray:
        """(n, 2) the clicks so far."""
        return np.reshape(np.array(self.points, float), (-1, 2))

    def _try(self) -> None:
        try:
            self.detection = self._fit(self.pixels)
            self.message = f"{len(self.detection)} corners found: Enter to accept, u to take the last click back"
        except InputError as error:
            self.points, self.detection = [], None
            self.message = f"{error} Click again: {_ORDER[0]}"

    def _next_step(self) -> str:
        return f"click {_ORDER[len(self.points)]} (u: undo, Esc: skip this camera)" if len(self.points) < 4 else ""


_ORDER = (
    "the first of the outermost inner corners",
    "the last one of the first row",
    "the last one of the last row",
    "the first one of the last row",
)
