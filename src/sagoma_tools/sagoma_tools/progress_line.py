"""The progress of a command: its present step, and how far that is, on stderr.

On a terminal a line that is drawn again and goes when the step ends, output above it; elsewhere a plain line every ten
seconds, so that a log shows where the time went. Commands name their steps with :func:`doing`.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

LOG_EVERY_S = 10.0

_running: ProgressLine | None = None


def doing(what: str, total: int | None = None) -> Callable[..., None]:
    """Name the present step ("tracking frames"); the function returned takes how many of ``total`` are done.

    It may be told the total as well, where that is known only later. Without a command around (a library's user, a
    test) both do nothing.
    """
    return (lambda done, total=None: None) if _running is None else _running.begin(what, total)


def until_stopped() -> None:
    """End the present step: from here on the command runs until somebody stops it, and shows no progress."""
    if _running is not None:
        _running.end()


class ProgressLine:
    """Shows the steps of a command while it runs; a context manager."""

    def __init__(self) -> None:
        self._lock, self._ended = threading.RLock(), threading.Event()
        self._progress: Progress | None = None

    def __enter__(self) -> ProgressLine:
        global _running
        self._outer, _running = _running, self
        return self

    def __exit__(self, *error: object) -> None:
        global _running
        self.end()
        _running = self._outer

    def begin(self, what: str, total: int | None) -> Callable[..., None]:
        """Begin a step, as :func:`doing` does."""
        with self._lock:
            self.end()
            text = TextColumn("{task.description}{task.fields[done]}", markup=False)
            console = Console(stderr=True, soft_wrap=True)  # what is printed meanwhile goes through it unchanged
            shared = sys.stdout.isatty()
            columns = text, BarColumn(), TimeElapsedColumn()
            progress = Progress(*columns, console=console, transient=True, redirect_stdout=shared)
            task = progress.add_task(what, total=total, done="")
            if console.is_terminal:
                progress.start()
            else:
                self._ended = threading.Event()
                threading.Thread(target=_log, args=(progress, self._ended), name="progress", daemon=True).start()
            self._progress = progress

        def update(done: int, total: int | None = None) -> None:
            whole = total or progress.tasks[0].total
            share = f" of {whole:.0f} ({100 * done / whole:.0f} %)" if whole else ""
            progress.update(task, completed=done, total=total, done=f": {done}{share}")

        return update

    def end(self) -> None:
        """End the present step."""
        with self._lock:
            self._ended.set()
            if self._progress is not None and self._progress.console.is_terminal:
                self._progress.stop()
            self._progress = None


def _log(progress: Progress, ended: threading.Event) -> None:
    """Write to stderr what is done, how far it is and since when, now and then until it has ended."""
    began_s = time.monotonic()
    while not ended.wait(LOG_EVERY_S):
        (task,) = progress.tasks
        passed_s = time.monotonic() - began_s
        print(f"{task.description}{task.fields['done']}, {passed_s:.0f} s", file=sys.stderr, flush=True)
