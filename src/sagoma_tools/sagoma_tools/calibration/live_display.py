"""Shows the progress of a live calibration: a panel in the terminal, lines in a log, a preview image with corners."""

from __future__ import annotations

import time
from collections.abc import Hashable
from dataclasses import dataclass

import cv2
import numpy as np
from rich.console import Console, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table

from rig_calibration.intrinsics.coverage import Coverage
from rig_calibration.intrinsics.selection import BoardImageProcessor, ImageResult, LensAccuracy

BAR_WIDTH = 24
LINE_EVERY_S = 2.0


class LiveReport:
    """Shows a panel on a terminal; elsewhere prints a line when there is news, at most every LINE_EVERY_S."""

    def __init__(self, console: Console) -> None:
        self._console, self._printed_s = console, -LINE_EVERY_S
        self._news: Hashable = None
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None

    def __enter__(self) -> LiveReport:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *of_error: object) -> None:
        if self._live is not None:
            self._live.stop()

    def update(self, panel: RenderableType, line: str, news: Hashable, last: bool = False) -> None:
        """Show the state. news : what differs once there is something to say; last : print it now."""
        now_s = time.monotonic()
        if self._live is not None:
            self._live.update(panel, refresh=True)
        elif news != self._news and (last or now_s - self._printed_s >= LINE_EVERY_S):
            self._news, self._printed_s = news, now_s
            self._console.print(line, highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class LiveState:
    """The progress of collecting views; made by the worker after every image, read by the panel."""

    camera: str
    received: int
    dropped: int
    examined: int
    found: int
    views: int
    progress: dict[str, float]
    expected: LensAccuracy | None
    goals: LensAccuracy
    advice: str
    last: str
    enough: bool


def state_of(watcher: BoardImageProcessor, last: str, received: int, dropped: int) -> LiveState:
    """Return the present state of the image processor."""
    collector = watcher.collector
    return LiveState(
        watcher.camera,
        received,
        dropped,
        watcher.examined,
        watcher.found,
        len(collector),
        collector.coverage.progress(),
        collector.expected,
        collector.goals,
        collector.advice(),
        last,
        collector.enough,
    )


def panel(state: LiveState) -> Panel:
    """Return the state as a panel for a terminal."""
    table = Table.grid(padding=(0, 2))
    for goal, share in state.progress.items():
        filled = round(share * BAR_WIDTH)
        colour = "green" if share >= 1.0 else "yellow"
        table.add_row(goal, f"[{colour}]{'█' * filled}[/]{'░' * (BAR_WIDTH - filled)}", f"{100 * share:.0f} %")
    table.add_row("focal length", *_against(state, "focal_sd", 100.0, "%"))
    table.add_row("principal point", *_against(state, "centre_sd_px", 1.0, "px"))
    table.add_row("views", str(state.views), f"board in {state.found} of {state.examined} images")
    table.add_row("last image", state.last, "")
    return Panel(table, title=f"{state.camera}: {state.advice or 'enough'}", subtitle="Ctrl-C: calibrate with these")


def plain_line(state: LiveState) -> str:
    """Return the state as a line for a log file."""
    progress = ", ".join(f"{goal} {100 * share:.0f} %" for goal, share in state.progress.items())
    expected = state.expected
    known = f", f ± {100 * expected.focal_sd:.2f} %, centre ± {expected.centre_sd_px:.1f} px" if expected else ""
    return f"{state.camera}: {state.views} views; {progress}{known}; {state.advice or 'enough'}"


def _against(state: LiveState, name: str, scale: float, unit: str) -> tuple[str, str]:
    """Return the expected standard deviation and its target."""
    target = f"wanted: ± {scale * getattr(state.goals, name):g} {unit}"
    if state.expected is None:
        return "not known yet", target
    value, wanted = getattr(state.expected, name), getattr(state.goals, name)
    return f"[{'green' if value <= wanted else 'yellow'}]± {scale * value:.2f} {unit}[/]", target


TAKEN, FOUND, COVERED = (60, 220, 60), (40, 160, 255), (90, 160, 60)  # BGR
DEPTH = 0.25  # how strongly covered cells are tinted
TEXT_HEIGHT_SHARE = 0.035


def draw_preview(image: np.ndarray, seen: ImageResult, coverage: Coverage, advice: str) -> np.ndarray:
    """Return the image (H, W[, 3]) as BGR with covered cells tinted, corners marked, and a line of advice."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    height, width = picture.shape[:2]
    cells = cv2.resize(coverage.cells.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    tint = np.array(COVERED, float) * DEPTH
    picture[cells] = (picture[cells] * (1 - DEPTH) + tint).astype(np.uint8)
    if seen.detection is not None:
        colour, radius = TAKEN if seen.taken else FOUND, max(2, width // 200)
        for x, y in np.rint(seen.detection.pixels).astype(int):
            cv2.circle(picture, (int(x), int(y)), radius, colour, max(1, radius // 2))
    _write(picture, advice or "enough", 1)
    _write(picture, "taken" if seen.taken else seen.reason, 2)
    return picture


def _write(picture: np.ndarray, text: str, line: int) -> None:
    """Write a line of text, counted from the bottom, readable on any background."""
    height, width = picture.shape[:2]
    scale = TEXT_HEIGHT_SHARE * height / 22
    needed = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0]
    scale *= min(1.0, 0.97 * width / max(needed, 1))
    place = (int(0.01 * width), int(height - (line - 0.6) * 1.6 * TEXT_HEIGHT_SHARE * height))
    for colour, thickness in (((0, 0, 0), 4), ((255, 255, 255), 1)):
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, thickness, cv2.LINE_AA)
