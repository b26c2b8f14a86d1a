"""What every bench shares: one thread, its arguments, its tables, and one line of JSON at its end.

With ``--record`` the figures are kept in docs/figures, with machine, commit, date and command; `make figures` writes
those into the pages. Run by itself it does so for a `sagoma` command that ends with a line of JSON:

    python bench/report.py --record=demo demo
    python bench/report.py --record=real_4cam evaluate ../shared/data/real_4cam --json

Imported before numpy: BLAS reads its number of threads once.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

for _pool in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")

import cv2  # noqa: E402
import numpy as np  # noqa: E402

from capture_rig.errors import InputError  # noqa: E402
from capture_rig.files import write_text  # noqa: E402

cv2.setNumThreads(1)

TREE = Path(__file__).resolve().parents[1]
sys.path += [str(TREE / "models"), str(TREE / "tests" / "support")]  # what benches share with these
FIGURES = TREE / "docs" / "figures"
MEASURED = ("src", "bench", "models")
"""A change in these folders that no commit holds makes the recorded commit a dirty one."""
SHARED_IN_PAGES = "../shared/data"
_asked = argparse.Namespace(record=None, commit=None)
"""record : the name under which the figures are to be recorded, "" for the command's own, None for no record; commit :
of the code when this was asked, at the start."""
_tables: list[list[list[str]]] = []
"""The cells of all tables printed so far, headings first."""


def parser(doc: str | None, quick: str = "") -> argparse.ArgumentParser:
    """Arguments described by a bench's docstring; with --quick, unless ``quick`` (what it leaves out) is empty."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if quick:
        made.add_argument("--quick", action="store_true", help=quick.replace("%", "%%"))
    _asked.record = None
    kept = "keep the figures in docs/figures/NAME.json (default: named after the command)"
    made.add_argument("--record", nargs="?", const="", metavar="NAME", action=_Record, help=kept)
    return made


class _Record(argparse.Action):
    """Remembers for ``finish`` that the figures are to be recorded."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        _asked.record, _asked.commit = values, commit()


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
        self._formats, self._markdown, self._kept = list(columns.values()), markdown, list[list[str]]()
        _tables.append(self._kept)
        print(f"\n{title}" if title else "")
        self._print([format(heading, _of_text(spec)) for heading, spec in columns.items()])
        if markdown:
            print("|" + "---|" * len(columns), flush=True)

    def row(self, *values: object) -> None:
        """One value a column."""
        self._print([_cell(value, spec) for value, spec in zip(values, self._formats, strict=True)])

    def _print(self, cells: Sequence[str]) -> None:
        self._kept.append([" ".join(cell.split()) for cell in cells])
        line = f"| {' | '.join(cell.strip() for cell in cells)} |" if self._markdown else " ".join(cells)
        print(line.rstrip(), flush=True)


def finish(figures: dict[str, Any], command: Sequence[str] = ()) -> None:
    """Print the figures as the last line: JSON, without NaN; record them if that is asked for.

    command : that measured them, if it is not this program's own.
    """
    plain = _plain(figures)
    print(json.dumps(plain), flush=True)
    if _asked.record is not None:
        words = [_in_pages(word) for word in command or _own_command()]
        path = FIGURES / f"{_asked.record or name_of(words)}.json"
        write_text(path, _record_text(words, plain))
        print(f"recorded: {path}", file=sys.stderr)
        _asked.record = None


def name_of(command: Iterable[str]) -> str:
    """Return the name of a command's record: tracking_quick for ``python bench/tracking.py --quick``."""
    words = [re.sub(r"\W+", "_", Path(word).stem if "/" in word else word.lstrip("-")) for word in command]
    return "_".join(word for word in words if word and word not in ("python", "sagoma"))


def machine() -> dict[str, Any]:
    """Return what this runs on: processor, cores, Python; and how busy it is."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", info.read_text()) if info.exists() else []
    processor = names[0] if names else platform.processor() or platform.machine()
    load = round(os.getloadavg()[0], 1)
    return {"processor": processor, "cores": os.cpu_count(), "python": platform.python_version(), "load": load}


def machine_line() -> str:
    """Return :func:`machine` in a line."""
    here = machine()
    return f"{here['processor']}, {here['cores']} cores, Python {here['python']}; load {here['load']}"


def commit() -> str | None:
    """Return the commit of this tree, with "-dirty" where its code has changed since; None without git."""
    try:
        head = _git("rev-parse", "HEAD")
        return head + ("-dirty" if _git("status", "--porcelain", "--", *MEASURED) else "")
    except (OSError, subprocess.CalledProcessError):
        return None


def _git(*words: str) -> str:
    done = subprocess.run(["git", "-C", str(TREE), *words], check=True, capture_output=True, text=True)
    return done.stdout.strip()


def _own_command() -> list[str]:
    """The words that started this program, without ``--record`` and its name."""
    words = sys.argv[1:]
    place = next(k for k, word in enumerate(words) if word.startswith("--record"))
    named_apart = words[place] == "--record" and bool(_asked.record)
    del words[place : place + 1 + named_apart]
    return ["python", os.path.relpath(Path(sys.argv[0]).resolve(), TREE), *words]


def _in_pages(word: str) -> str:
    """A word of a command as the pages have it: test data lie beside the tree."""
    shared = os.environ.get("SAGOMA_SHARED_DATA")
    return word.replace(shared, SHARED_IN_PAGES) if shared else word


def _record_text(command: Sequence[str], figures: dict[str, Any]) -> str:
    """The text of a record: readable, and one line a figure and a row of a table."""
    date = datetime.now(UTC).strftime("%Y-%m-%d %H:%M")
    head = {"command": shlex.join(command), "commit": _asked.commit, "date": date, "machine": machine()}
    parts = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    values = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in figures.items()]
    parts.append('"figures": {\n' + ",\n".join(values) + "\n }")
    tables = ["  [\n" + ",\n".join(f"   {json.dumps(row)}" for row in table) + "\n  ]" for table in _tables]
    parts.append('"tables": [\n' + ",\n".join(tables) + "\n ]")
    return "{\n " + ",\n ".join(parts) + "\n}\n"


def execute(main: Callable[[], object]) -> None:
    """Call a bench; what its user got wrong is one line on standard error and exit code 2."""
    try:
        main()
        if _asked.record is not None:
            raise InputError("this bench ends without a line of JSON", where="--record", remedy="Leave it out.")
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


def run_sagoma() -> None:
    """Run a `sagoma` command, show what it prints, and take its last line as the figures."""
    given = parser(__doc__)
    given.add_argument("command", nargs=argparse.REMAINDER, help="subcommand of sagoma with its arguments")
    words = given.parse_args().command
    line = ""
    with subprocess.Popen([sys.executable, "-m", "sagoma_tools.cli", *words], stdout=subprocess.PIPE, text=True) as run:
        for following in run.stdout or ():
            print(line, end="", flush=True)
            line = following
    if run.returncode or not line.startswith("{"):
        said = f"it ended with status {run.returncode} and the line {line!r}"
        remedy = "Give one that ends well and with a line of JSON: demo, or evaluate SESSION --json."
        raise InputError(said, where=" ".join(words), remedy=remedy)
    finish(json.loads(line), command=["sagoma", *words])


if __name__ == "__main__":
    execute(run_sagoma)
