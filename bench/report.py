"""What every bench shares: one thread, its arguments, its tables, and one line of JSON at its end.

Imported before numpy: BLAS reads its number of threads once.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

for _pool in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")

import cv2  # noqa: E402
import numpy as np  # noqa: E402

from capture_rig.errors import InputError  # noqa: E402

cv2.setNumThreads(1)


def parser(doc: str | None, quick: str = "") -> argparse.ArgumentParser:
    """Arguments described by a bench's docstring; with --quick, unless ``quick`` (what it leaves out) is empty."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if quick:
        made.add_argument("--quick", action="store_true", help=quick.replace("%", "%%"))
    return made


def add_settings(to: argparse.ArgumentParser) -> None:
    """The argument --set, as of `sagoma up`; read it with sagoma_tools' ``parse_settings``."""
    to.add_argument("--set", dest="settings", action="append", default=[], metavar="NODE.PARAMETER=VALUE")


class Table:
    """Rows that are printed as soon as they are known.

    columns : heading -> format of its values with their width, as "<24", ">8.1f" or ">7d", or all of them as text:
    "clip:<24 | frames:>7d". With ``markdown`` the widths do not matter. None and NaN print as "-".
    """

    def __init__(self, columns: dict[str, str] | str, title: str = "", *, markdown: bool = False) -> None:
        if isinstance(columns, str):
            columns = dict(column.strip().rsplit(":", 1) for column in columns.split("|"))
        self._formats, self._markdown = list(columns.values()), markdown
        print(f"\n{title}" if title else "")
        self._print([format(heading, _of_text(spec)) for heading, spec in columns.items()])
        if markdown:
            print("|" + "---|" * len(columns), flush=True)

    def row(self, *values: object) -> None:
        """One value a column."""
        self._print([_cell(value, spec) for value, spec in zip(values, self._formats, strict=True)])

    def _print(self, cells: Sequence[str]) -> None:
        line = f"| {' | '.join(cell.strip() for cell in cells)} |" if self._markdown else " ".join(cells)
        print(line.rstrip(), flush=True)


def finish(figures: dict[str, Any]) -> None:
    """Print the figures as the last line: JSON, without NaN."""
    print(json.dumps(_plain(figures)))


def execute(main: Callable[[], object]) -> None:
    """Call a bench; what its user got wrong is one line on standard error and exit code 2."""
    try:
        main()
    except InputError as error:
        print(f"{sys.argv[0]}: {error}", file=sys.stderr)
        sys.exit(2)


def _cell(value: object, spec: str) -> str:
    if value is None or (isinstance(value, float) and np.isnan(value)):
        value = "-"
    return format(value, _of_text(spec) if isinstance(value, str) else spec)


def _of_text(spec: str) -> str:
    """The format's alignment and width."""
    return spec.rstrip("dfeg%").partition(".")[0]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and np.isnan(value) else value
