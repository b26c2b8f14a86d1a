"""The console that commands print to: words whole at any width, plain text into files, colours unless NO_COLOR."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from rich.console import Console, Group, RenderableType
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
