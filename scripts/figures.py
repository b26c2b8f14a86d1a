#!/usr/bin/env python3
"""Writes the recorded figures into the pages: ``scripts/figures.py [--check]``.

docs/figures/NAME.json is a record: figures and tables of one command, with machine, commit and date, as a bench's
``--record`` writes it. docs/figures/rows.yaml describes the tables of the pages and the rows in them:

    tables:
      TABLE: [ROW, ...]              # of the rows below,
      TABLE: NAME                    # or the first table that the command of a record printed
    rows:
      ROW:
        what: what is measured
        figure: "{NAME[KEY]:.1f} mm" # format strings over the records' figures
        more: " ({NAME[KEY]:.0%})"   # stands in the table called "all" alone
        measures: [PACKAGE, ...]     # of src/, whose code the figure depends on

A record whose figures are but a ``text`` was taken from a page: its words stand for those of its rows. A table stands
in a page between ``<!-- figures: TABLE -->`` and ``<!-- /figures -->``. Rows whose record is older than
the code that they measure are named.
"""

from __future__ import annotations

import json
import re
import string
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml
from measure_code import BUDGET

BLOCK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- /figures -->)", re.S)
LONG = "all"
"""The table with every row, and with what they say more."""
PAGES = ("README.md", "docs/**/*.md")


class FigureError(Exception):
    """A row, record or page that does not fit the others."""


@dataclass(frozen=True)
class Figures:
    """The records and rows of a tree."""

    tree: Path

    @property
    def folder(self) -> Path:
        return self.tree / "docs" / "figures"

    @cached_property
    def records(self) -> dict[str, dict[str, Any]]:
        """Name to command, commit, date, machine and figures."""
        files = sorted(path for path in self.folder.glob("*.json") if path.name != BUDGET.name)
        return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in files}

    @cached_property
    def described(self) -> dict[str, Any]:
        """``tables`` and ``rows``."""
        return yaml.safe_load((self.folder / "rows.yaml").read_text(encoding="utf-8"))

    def rendered(self, page: Path) -> str:
        """The text of a page with its tables as they should be."""
        return BLOCK.sub(lambda block: block[1] + self.table(block[2]) + block[3], page.read_text(encoding="utf-8"))

    def table(self, name: str) -> str:
        """A table of Markdown; FigureError for one that is not described."""
        described = self.described["tables"].get(name)
        if isinstance(described, list):
            heading = ["what", "figure", "command", *(["taken"] if name == LONG else [])]
            return _markdown([heading, *(self.cells(row, long=name == LONG) for row in described)])
        if described not in self.records:
            raise FigureError(f"rows.yaml has no table {name!r}, or one of a record that is not there")
        return _markdown(self.records[described]["tables"][0])

    def cells(self, name: str, long: bool) -> list[str]:
        """A row: what, figure, the commands of its records; in a long table when and of which commit they are, too."""
        row = self.described["rows"][name]
        template = row["figure"] + (row.get("more", "") if long else "")
        try:
            records = [self.records[record] for record in records_of(template)]
            in_words = [record["figures"]["text"] for record in records if "text" in record["figures"]]
            figures = {key: record["figures"] for key, record in self.records.items()}
            figure = "; ".join(in_words) or template.format_map(figures)
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise FigureError(f"row {name!r}: {template!r} does not fit the records: {error!r}") from None
        commands = dict.fromkeys(f"`{record['command']}`" for record in records)
        taken = dict.fromkeys(map(_taken, records))
        return [row["what"], figure, "; ".join(commands), *(["; ".join(taken)] if long else [])]

    def stale(self) -> list[str]:
        """A line for each row that was recorded before the last change of the code that it measures.

        FigureError without a history: where there is no git, or only the last commits (a shallow clone).
        """
        if self._git("rev-parse", "--is-shallow-repository") != "false":
            raise FigureError("no history of the tree (no git, or a shallow clone): ages of figures are unknown")
        return [line for name, row in self.described["rows"].items() for line in self._stale(name, row)]

    def _stale(self, name: str, row: Mapping[str, Any]) -> list[str]:
        folders = [f"src/{package}/{package}" for package in row["measures"]]
        changed = self._git("log", "-1", "--format=%h", "--", *folders)
        lines = []
        for record in records_of(row["figure"] + row.get("more", "")):
            taken = (self.records[record]["commit"] or "").partition("-")
            if self._git("merge-base", "--is-ancestor", changed, taken[0] or "none") is None:
                lines.append(f"{name}: {record} is of {taken[0][:7] or 'no commit'}, the code changed in {changed}")
            elif taken[2]:
                lines.append(f"{name}: {record} is of {taken[0][:7]} with changes that no commit holds")
        return lines

    def _git(self, *words: str) -> str | None:
        """What git says; None where it fails or there is none."""
        try:
            command = ["git", "-C", str(self.tree), *words]
            return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
        except (OSError, subprocess.CalledProcessError):
            return None


def _taken(record: Mapping[str, Any]) -> str:
    """When and of which commit a record is; and that its times are those of a busy machine."""
    machine = {"load": 0.0, "cores": 1} | record.get("machine", {})
    busy = f", load {machine['load']:.0f}" if machine["load"] > machine["cores"] else ""
    return f"{record['date'][:10]}, {(record['commit'] or 'no commit')[:7]}{busy}"


def _markdown(rows: list[list[str]]) -> str:
    """A table, its headings first."""
    heading, *others = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([heading, "|" + "---|" * len(rows[0]), *others]) + "\n"


def records_of(template: str) -> list[str]:
    """The records that a format string takes figures from, in its order."""
    fields = (field for _, field, _, _ in string.Formatter().parse(template) if field)
    return list(dict.fromkeys(re.split(r"[.\[]", field)[0] for field in fields))


def pages_of(tree: Path) -> list[Path]:
    """The pages that may hold tables."""
    return [path for pattern in PAGES for path in sorted(tree.glob(pattern))]


def main(tree: Path, check: bool) -> int:
    """Write the pages, or only compare them; 1 where one differs and may not be written."""
    figures = Figures(tree)
    try:
        texts = {page: figures.rendered(page) for page in pages_of(tree)}
        differing = [page for page, text in texts.items() if text != page.read_text(encoding="utf-8")]
    except FigureError as error:
        print(error, file=sys.stderr)
        return 1
    for page in differing:
        if not check:
            page.write_text(texts[page], encoding="utf-8")
        print(f"{page.relative_to(tree)}: {'differs from the records; run make figures' if check else 'written'}")
    try:
        for line in figures.stale():
            print(f"older than its code: {line}")
    except FigureError as error:
        print(error)
    return 1 if check and differing else 0


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parents[1], "--check" in sys.argv[1:]))
