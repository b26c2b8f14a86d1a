"""The console that commands print to: words whole at any width, plain text into files, colours unless NO_COLOR."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

EDGES = "│┃|"  # of tables with a box
LOG_WIDTH = 150  # of tables in a file, unless COLUMNS says otherwise


class CommandConsole(Console):
    """A rich console that breaks no word: paths stay whole, and a table without room becomes a list of its rows.

    Into a file, lines of text are not broken at all, so that grep finds them.
    """

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does, but without markup and highlighting unless asked for: paths hold brackets, too."""
        if len(objects) == 1 and isinstance(objects[0], str | Text):
            markup, highlight = options.pop("markup", False), options.pop("highlight", False)
            text = objects[0]
            objects = (self.render_str(text, markup=markup, highlight=highlight) if isinstance(text, str) else text,)
            options = {"overflow": "ignore", "crop": False, "soft_wrap": not self.is_terminal, **options}
        super().print(*(fitted(self, one) if isinstance(one, Table) else one for one in objects), **options)


def command_console(*, stderr: bool = False, width: int = LOG_WIDTH) -> CommandConsole:
    """Return a console as wide as the terminal or as COLUMNS says; in a file without it ``width`` columns wide."""
    console = CommandConsole(stderr=stderr)
    if console.is_terminal or os.environ.get("COLUMNS", "").isdecimal():
        return console
    return CommandConsole(stderr=stderr, width=width)


def fitted(console: Console, table: Table) -> RenderableType:
    """Return the table, or a list of its rows where a word would be broken at the console's width."""
    lines = console.render_lines(table, console.options, pad=False)
    shown = {word.strip(EDGES) for line in lines for word in "".join(part.text for part in line).split()}
    cells = (cell for column in table.columns for cell in (column.header, *column.cells))
    whole = {word.strip(EDGES) for cell in cells for word in _plain(cell).split()} <= shown
    return table if whole else Group(*_rows(table))


def _rows(table: Table) -> Iterable[Text]:
    if table.title:
        yield Text(str(table.title), style="bold")
    for number, row in enumerate(table.rows):
        first = True
        for column in table.columns:
            cell = list(column.cells)[number]
            text, header = _plain(cell), _plain(column.header)
            if not text:
                continue
            indent = "" if first else "  "
            line = Text(f"{indent}{header}: " if header else indent, style=row.style or "")
            yield line.append_text(cell if isinstance(cell, Text) else Text(text))
            first = False


def _plain(cell: RenderableType) -> str:
    return cell.plain if isinstance(cell, Text) else Text.from_markup(str(cell)).plain


# progress -------------------------------------------------------------------------------------------------------------


LOG_EVERY_S = 10.0
REFRESH_S = 0.25  # of what a terminal shows

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
