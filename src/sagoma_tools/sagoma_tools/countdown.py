"""Seconds counted down for somebody who has to leave the room."""

from __future__ import annotations

import threading

from rich.console import Console
from rich.live import Live
from rich.text import Text

SPOKEN = 5  # in a log the last so many seconds have a line each


def count_down(console: Console, what: str, seconds: int, stop: threading.Event) -> bool:
    """Show "WHAT: 10" and so on down to 1, then beep; False when ``stop`` was set meanwhile."""
    if not console.is_terminal:
        return _in_lines(console, what, seconds, stop)
    with Live(console=console, auto_refresh=False, transient=True) as live:
        for left in range(seconds, 0, -1):
            live.update(Text(f"{what}: {left}", style="bold yellow"), refresh=True)
            if stop.wait(1.0):
                return False
    console.bell()
    return True


def _in_lines(console: Console, what: str, seconds: int, stop: threading.Event) -> bool:
    for left in range(seconds, 0, -1):
        if left == seconds or left <= SPOKEN:
            console.print(f"{what}: {left} s", highlight=False)
        if stop.wait(1.0):
            return False
    return True
