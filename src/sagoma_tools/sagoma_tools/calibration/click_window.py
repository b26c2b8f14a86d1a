"""A window to click a board's outer corners; without a display, a picture with a grid to read them off."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.backend_bases import Event, KeyEvent, MouseButton, MouseEvent
from matplotlib.figure import Figure

from capture_rig.errors import InputError
from capture_rig.files import write_text
from rig_calibration.boards.board import TargetDetection

from .clicking import FORMAT, Clicks

WINDOW_BACKENDS = ("QtAgg", "TkAgg", "Gtk3Agg", "MacOSX", "WXAgg")
ACCEPT_KEY, UNDO_KEY, SKIP_KEY = "enter", "u", "escape"
GRID_STEP_PX = 50
GRID_PICTURE_PX = 1600
LIME, RED = "#39ff14", "#ff3030"


class ClickWindow:
    """Shows a picture on a figure and turns its events into clicks; closes the figure when it is decided."""

    def __init__(self, figure: Figure, name: str, image: np.ndarray, clicks: Clicks) -> None:
        self.clicks, self.accepted = clicks, False
        self._figure, self._name = figure, name
        self._axes = figure.add_subplot()
        self._axes.imshow(image if image.ndim == 2 else image[..., ::-1], cmap="gray", vmin=0, vmax=255)
        (self._marks,) = self._axes.plot([], [], "+", color=RED, markersize=14)
        (self._found,) = self._axes.plot([], [], ".", color=LIME, markersize=4)
        figure.canvas.mpl_connect("button_press_event", self._on_click)
        figure.canvas.mpl_connect("key_press_event", self._on_key)
        self._draw()

    def _on_click(self, event: Event) -> None:
        toolbar = getattr(self._figure.canvas, "toolbar", None)
        zooming = bool(toolbar is not None and getattr(toolbar, "mode", ""))
        if not isinstance(event, MouseEvent) or zooming or event.button != MouseButton.LEFT:
            return
        if event.inaxes is self._axes and event.xdata is not None and event.ydata is not None:
            self.clicks.add(event.xdata, event.ydata)
            self._draw()

    def _on_key(self, event: Event) -> None:
        if not isinstance(event, KeyEvent):
            return
        if event.key == UNDO_KEY:
            self.clicks.undo()
            self._draw()
        elif event.key == SKIP_KEY or (event.key == ACCEPT_KEY and self.clicks.detection is not None):
            self.accepted = event.key == ACCEPT_KEY
            plt.close(self._figure)

    def _draw(self) -> None:
        self._marks.set_data(*self.clicks.pixels.T)
        found = self.clicks.detection
        self._found.set_data(*(found.pixels.T if found is not None else ([], [])))
        self._axes.set_title(f"{self._name}: {self.clicks.message}", fontsize=9, wrap=True)
        self._figure.canvas.draw_idle()


def click_corners(name: str, image: np.ndarray, fit: Callable[[np.ndarray], TargetDetection]) -> np.ndarray | None:
    """Four outer corners (4, 2) px that ``fit`` accepts, clicked in a window; None when the person skips the camera."""
    window = ClickWindow(plt.figure(figsize=(12, 9), constrained_layout=True), name, image, Clicks(fit))
    plt.show(block=True)
    return window.clicks.pixels if window.accepted else None


def open_display() -> bool:
    """Choose a library that draws windows; False when there is no display or no such library."""
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
    height, width = image.shape[:2]
    scale = max(1, round(GRID_PICTURE_PX / width))
    picture = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    for x in range(0, width, GRID_STEP_PX):
        _draw_line(picture, (x, 0), (x, height), scale, str(x), (x * scale + 3, 14))
    for y in range(0, height, GRID_STEP_PX):
        _draw_line(picture, (0, y), (width, y), scale, str(y), (3, y * scale - 3))
    path = folder / f"{name}_click.png"
    if not cv2.imwrite(str(path), picture):
        raise InputError("cannot be written", where=str(path), remedy="Name an output in a folder that may be written.")
    return path


def write_template(path: Path, names: list[str]) -> None:
    """Write a corners file whose numbers a person replaces."""
    lines = [f"# {FORMAT}", "# Replace every number; delete the cameras that need none."]
    lines += [f"{name}: [[0, 0], [1, 0], [1, 1], [0, 1]]" for name in names]
    write_text(path, "\n".join(lines) + "\n")


def _draw_line(
    picture: np.ndarray, start: tuple[int, int], end: tuple[int, int], scale: int, text: str, place: tuple[int, int]
) -> None:
    """A line between pixel centres of the picture before it was enlarged, with its coordinate."""
    one, two = (tuple(round((value + 0.5) * scale - 0.5) for value in point) for point in (start, end))
    cv2.line(picture, one, two, (0, 255, 255), 1)
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_PLAIN, 1.0, (0, 0, 0), 3)
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_PLAIN, 1.0, (0, 255, 255), 1)
