"""The progress line of a command: what it does and how far it is, once it has been silent for three seconds.

On a terminal it is one line on stderr, which the next output replaces; elsewhere a plain line every ten seconds, so
that a log shows where the time went. Commands name their steps with :func:`doing`; a step without a name is the
command's own.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, TextIO

SILENT_S = 3.0  # longer than that people wonder whether it hangs (Nielsen: attention is lost after 1 to 10 s)
STEP_S = 1.0  # a step that has only just begun is perhaps over before it is read
LOG_EVERY_S = 10.0
REFRESH_S = 0.25
FALLBACK_COLUMNS = 80
CLEAR = "\r\x1b[K"

_running: ProgressLine | None = None


def doing(what: str, total: int | None = None) -> Callable[..., None]:
    """Name the present step ("tracking frames"); the function returned takes how many of ``total`` are done.

    It may be told the total as well, where that is known only later. Without a command around (a library's user, a
    test) both do nothing.
    """
    line = _running
    if line is None:
        return lambda done, total=None: None
    return line.begin(what, total)


def until_stopped(what: str) -> None:
    """Name the present step, which lasts until somebody stops it: in a log it is said once, by whoever calls this."""
    if _running is not None:
        _running.begin(what, None, endless=True)


class ProgressLine:
    """Watches stdout and stderr while a command runs; a context manager.

    endless : until a step is named, it is one that lasts until it is stopped.
    """

    def __init__(self, command: str, *, endless: bool = False, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s, self._endless = now_s, endless
        self._lock = threading.RLock()
        self._over = threading.Event()
        self._what, self._done, self._total = command, None, None  # type: tuple[str, int | None, int | None]
        self._began_s = self._heard_s = self._logged_s = now_s()
        self._shown = False
        self._thread = threading.Thread(target=self._run, name="progress line", daemon=True)

    def __enter__(self) -> ProgressLine:
        global _running
        self._outer, self._stdout, self._stderr = _running, sys.stdout, sys.stderr
        sys.stdout, sys.stderr = _Heard(self._stdout, self), _Heard(self._stderr, self)  # type: ignore[assignment]
        _running = self
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        global _running
        self._over.set()
        self._thread.join()
        self.heard()
        _running = self._outer
        sys.stdout, sys.stderr = self._stdout, self._stderr

    def begin(self, what: str, total: int | None, *, endless: bool = False) -> Callable[..., None]:
        """Begin a step, as :func:`doing` and :func:`until_stopped` do."""
        with self._lock:
            self._endless = endless
            self._what, self._done, self._total, self._began_s = what, None, total, self._now_s()

        def tell(done: int, total: int | None = None) -> None:
            if self._what == what:
                self._done, self._total = done, total or self._total

        return tell

    def heard(self) -> None:
        """Take the line away: somebody else is about to write."""
        with self._lock:
            self._heard_s = self._now_s()
            if self._shown:
                self._stderr.write(CLEAR)
                self._stderr.flush()
                self._shown = False

    def line(self) -> str:
        """Return what is being done, how far it is, and since when."""
        passed = f"{self._now_s() - self._began_s:.0f} s"
        if self._done is None:
            return f"{self._what} ... {passed}"
        if not self._total:
            return f"{self._what}: {self._done}, {passed}"
        return f"{self._what}: {self._done} of {self._total} ({100 * self._done // self._total} %), {passed}"

    def speak(self) -> None:
        """Show the line when there was silence for long enough."""
        with self._lock:
            now_s = self._now_s()
            if now_s - self._heard_s < SILENT_S or now_s - self._began_s < STEP_S:
                return
            if self._stderr.isatty():
                columns = columns_of(self._stderr)
                self._stderr.write(CLEAR + self.line()[: columns - 1])
                self._shown = True
            elif not self._endless and now_s - self._logged_s >= (LOG_EVERY_S if self._logged_s > self._heard_s else 0):
                self._stderr.write(self.line() + "\n")
                self._logged_s = now_s
            self._stderr.flush()

    def _run(self) -> None:
        while not self._over.wait(REFRESH_S):
            try:
                self.speak()
            except (OSError, ValueError):  # stderr is closed: nobody listens
                return


class _Heard:
    """A stream that tells the progress line whenever something is written."""

    def __init__(self, stream: TextIO, line: ProgressLine) -> None:
        self._stream, self._line = stream, line

    def write(self, text: str) -> int:
        self._line.heard()
        return self._stream.write(text)

    def writelines(self, lines: Any) -> None:
        self._line.heard()
        self._stream.writelines(lines)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def columns_of(stream: TextIO) -> int:
    """Return the width of a terminal: COLUMNS, else its own."""
    given = os.environ.get("COLUMNS", "")
    if given.isdecimal() and int(given) > 0:
        return int(given)
    try:
        return os.get_terminal_size(stream.fileno()).columns or FALLBACK_COLUMNS
    except (OSError, ValueError, AttributeError):
        return FALLBACK_COLUMNS
