"""The panel in the terminal while views of a board are collected live."""

from __future__ import annotations

from dataclasses import dataclass

from rich.panel import Panel
from rich.table import Table

from rig_calibration.intrinsics.selection import Expected, Targets
from rig_calibration.intrinsics.watching import BoardWatcher

BAR_WIDTH = 24


@dataclass(frozen=True)
class LiveState:
    """How far collecting has come; made by the worker after every image, read by the panel."""

    camera: str
    received: int
    dropped: int
    examined: int
    found: int
    views: int
    progress: dict[str, float]
    expected: Expected | None
    targets: Targets
    advice: str
    last: str
    enough: bool


def state_of(watcher: BoardWatcher, last: str, received: int, dropped: int) -> LiveState:
    """The watcher's state now."""
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
        collector.targets,
        collector.advice(),
        last,
        collector.enough,
    )


def panel(state: LiveState) -> Panel:
    """For a terminal."""
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
    """For a log file."""
    progress = ", ".join(f"{goal} {100 * share:.0f} %" for goal, share in state.progress.items())
    expected = state.expected
    known = f", f ± {100 * expected.focal_sd:.2f} %, centre ± {expected.centre_sd_px:.1f} px" if expected else ""
    return f"{state.camera}: {state.views} views; {progress}{known}; {state.advice or 'enough'}"


def _against(state: LiveState, name: str, scale: float, unit: str) -> tuple[str, str]:
    """The expected standard deviation and its target."""
    target = f"wanted: ± {scale * getattr(state.targets, name):g} {unit}"
    if state.expected is None:
        return "not known yet", target
    value, wanted = getattr(state.expected, name), getattr(state.targets, name)
    return f"[{'green' if value <= wanted else 'yellow'}]± {scale * value:.2f} {unit}[/]", target
