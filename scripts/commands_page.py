"""Prints a page from the commands' parsers: python scripts/commands_page.py > docs/reference/commands.md."""

from __future__ import annotations

import argparse
import sys
from textwrap import fill

from sagoma_tools.cli import build_parser
from sagoma_tools.console import HELP, STATUSES, CommandHelp, commands_of

PAGE = """# Commands

Every command with the exit statuses of its own, and what all of them keep to. `sagoma COMMAND --help` has the arguments
and examples. This page is printed from `sagoma_tools/console.py` by `python scripts/commands_page.py`.

| status | meaning, where the command's own line says nothing else |
|---|---|
{statuses}

{commands}

## Output

- **Messages** begin with `sagoma:`, stand on stderr, and say what is wrong, where, and the remedy. Results stand on
  stdout; `--json`, where there is one, is for programs.
- **Numbers** are finite and within a range that the message names with its unit.
- **Progress** stands on stderr, on a terminal alone, in a line that goes when it is over.
- **Pipes and files** get plain text without escape codes; colours only on terminals, none with `NO_COLOR` set.
- **Width**: text is broken at that of the terminal, or of `COLUMNS`, into a file nowhere; paths and rows of tables
  never.
- **Ctrl-C** ends a command in order: what it started is stopped, what it recorded is readable.
"""


def page(parser: argparse.ArgumentParser) -> str:
    """Return docs/reference/commands.md."""
    lines = []
    for name, _, text in commands_of(parser):
        meant = "; ".join(
            f"{status}: {meaning}" for status, meaning in sorted(HELP.get(name, CommandHelp()).statuses.items())
        )
        line = f"- `sagoma {name}`: {text}{f' ({meant})' if meant else ''}"
        lines.append(fill(line, 120, subsequent_indent="  ", break_on_hyphens=False))
    statuses = "\n".join(f"| {status} | {meaning} |" for status, meaning in STATUSES.items())
    return PAGE.format(commands="\n".join(lines), statuses=statuses)


if __name__ == "__main__":
    sys.stdout.write(page(build_parser()))
