"""Finds a board from its four outer corners, which a person gives where detection fails: by clicks in a window, or in a
file; without a display, a picture with a grid to read them off and a file to fill in."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.files import describe_os_error, write_text
from capture_rig.yaml_file import read_mapping, save_mapping
from rig_calibration.boards.board import Board, TargetDetection
from rig_calibration.boards.four_corners import find_from_outer_corners

if TYPE_CHECKING:  # matplotlib takes a second to load
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMAT = (
    "Write NAME: [[x, y], [x, y], [x, y], [x, y]] for each camera, or NAME: {corners: [...], frame: 12}: the outermost "
    "inner corners of the print in pixels, in reading order (first row's two ends, then the last row's last and first)."
)
ORDER = (
    "the first of the outermost inner corners",
    "the last one of the first row",
    "the last one of the last row",
    "the first one of the last row",
)
WINDOW_BACKENDS = ("QtAgg", "TkAgg", "Gtk3Agg", "MacOSX", "WXAgg")
ACCEPT_KEY, UNDO_KEY, SKIP_KEY = "enter", "u", "escape"
GRID_STEP_PX, GRID_PICTURE_PX = 50, 1600
LIME, RED, YELLOW = "#39ff14", "#ff3030", "#ffff00"


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


class ClickWindow:
    """Shows a picture on a figure and collects four clicks on it, from which ``fit`` detects the board; its InputError
    is shown, and drops the clicks. Closes the figure when the person accepts the detection or skips the camera."""

    def __init__(self, figure: Figure, name: str, image: np.ndarray, fit: Callable[[np.ndarray], TargetDetection]):
        self.points: list[tuple[float, float]] = []
        self.detection: TargetDetection | None = None
        self.message, self.accepted = "", False
        self._figure, self._name, self._fit = figure, name, fit
        self._axes = figure.add_subplot()
        _show(self._axes, image)
        (self._marks,) = self._axes.plot([], [], "+", color=RED, markersize=14)
        (self._found,) = self._axes.plot([], [], ".", color=LIME, markersize=4)
        figure.canvas.mpl_connect("button_press_event", self._on_click)
        figure.canvas.mpl_connect("key_press_event", self._on_key)
        self._update()

    @property
    def pixels(self) -> np.ndarray:
        """(n, 2) the clicks so far."""
        return np.reshape(np.array(self.points, float), (-1, 2))

    def _on_click(self, event: Any) -> None:
        zooming = bool(getattr(getattr(self._figure.canvas, "toolbar", None), "mode", ""))
        if zooming or event.button != 1 or event.inaxes is not self._axes or len(self.points) == 4:
            return
        self.points.append((event.xdata, event.ydata))
        refused = ""
        if len(self.points) == 4:
            try:
                self.detection = self._fit(self.pixels)
            except InputError as error:
                self.points, refused = [], f"{error} Click again: "
        self._update(refused)

    def _on_key(self, event: Any) -> None:
        if event.key == UNDO_KEY:
            self.points, self.detection = self.points[:-1], None
            self._update()
        elif event.key == SKIP_KEY or (event.key == ACCEPT_KEY and self.detection is not None):
            from matplotlib import pyplot as plt

            self.accepted = event.key == ACCEPT_KEY
            plt.close(self._figure)

    def _update(self, refused: str = "") -> None:
        """Draw clicks, corners and what is to be done next."""
        self.message = f"{refused}click {ORDER[len(self.points) % 4]} (u: undo, Esc: skip this camera)"
        if self.detection is not None:
            self.message = f"{len(self.detection)} corners found: Enter to accept, u to take the last click back"
        self._marks.set_data(*self.pixels.T)
        self._found.set_data(*([[], []] if self.detection is None else self.detection.pixels.T))
        self._axes.set_title(f"{self._name}: {self.message}", fontsize=9, wrap=True)
        self._figure.canvas.draw_idle()


def click_corners(name: str, image: np.ndarray, fit: Callable[[np.ndarray], TargetDetection]) -> np.ndarray | None:
    """Four outer corners (4, 2) px that ``fit`` accepts, clicked in a window; None when the person skips the camera."""
    from matplotlib import pyplot as plt

    window = ClickWindow(plt.figure(figsize=(12, 9), constrained_layout=True), name, image, fit)
    plt.show(block=True)
    return window.pixels if window.accepted else None


def open_display() -> bool:
    """Choose a library that draws windows; False when there is no display or no such library."""
    from matplotlib import pyplot as plt

    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    for backend in WINDOW_BACKENDS:
        try:
            plt.switch_backend(backend)
            return True
        except (ImportError, RuntimeError):  # that library is not installed, or the display does not answer
            continue
    return False


def write_click_help(folder: Path, name: str, image: np.ndarray) -> Path:
    """Write NAME_click.png, the picture enlarged under a grid of pixel coordinates; returns its path."""
    from matplotlib.figure import Figure

    height, width = image.shape[:2]
    figure = Figure(figsize=(GRID_PICTURE_PX / 100, GRID_PICTURE_PX / 100 * height / width), layout="constrained")
    axes = figure.add_subplot()
    _show(axes, image)
    axes.set(xticks=range(0, width, GRID_STEP_PX), yticks=range(0, height, GRID_STEP_PX))
    axes.tick_params(labelsize=7, labelrotation=45)
    axes.grid(color=YELLOW, linewidth=0.5)
    path = folder / f"{name}_click.png"
    try:
        figure.savefig(path, dpi=100)
    except OSError as error:
        raise describe_os_error(error, "cannot be written", path) from None
    return path


def _show(axes: Axes, image: np.ndarray) -> None:
    axes.imshow(image if image.ndim == 2 else image[..., ::-1], cmap="gray", vmin=0, vmax=255)


def write_template(path: Path, names: list[str]) -> None:
    """Write a corners file whose numbers a person replaces."""
    lines = [f"# {FORMAT}", "# Replace every number; delete the cameras that need none."]
    lines += [f"{name}: [[0, 0], [1, 0], [1, 1], [0, 1]]" for name in names]
    write_text(path, "\n".join(lines) + "\n")
