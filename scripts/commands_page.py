"""Prints docs/commands.md from the commands' parsers: python scripts/commands_page.py > docs/commands.md."""

from __future__ import annotations

import argparse
import sys

from sagoma_tools.cli import build_parser
from sagoma_tools.command_help import HELP, STATUSES, commands_of

PAGE = """# The commands: what all of them keep to

`sagoma COMMAND --help` says what a command does, its arguments, examples and exit statuses. This page is printed from
`sagoma_tools/command_help.py` (`python scripts/commands_page.py`); a test runs over all commands and holds both.

## Exit statuses

| status | meaning, where the command's own line says nothing else |
|---|---|
{statuses}

| command | does | statuses of its own |
|---|---|---|
{rows}

Commands that run until they are stopped (`up`, `record`, `view`, `studio`) end with 0 after Ctrl-C: it is their end.
`make demo` and `make test` hand the status of their command on.

## Output

- **Messages** begin with `sagoma:`, stand on stderr, and say what is wrong, where, and the remedy. Results stand on
  stdout; `--json`, where there is one, is for programs.
- **Numbers** are finite and within a range that the message names with its unit; no option takes NaN or infinity.
- **Progress**: on a terminal what is done, how far and since when, on stderr, in a line that goes when it is over;
  elsewhere a plain line every ten seconds. A command that runs until it is stopped shows none.
- **Pipes and files** get plain text: no escape codes, no carriage returns, lines of text unbroken (grep finds them).
- **Width**: that of the terminal, or of `COLUMNS`. No path is broken; a table that does not fit becomes a list of its
  rows. Into a file tables are 150 columns wide unless `COLUMNS` says otherwise.
- **Colours** only on terminals; none with `NO_COLOR` set.
- **Ctrl-C** ends a command in order: what it started is stopped, what it recorded is readable.
"""


def page(parser: argparse.ArgumentParser) -> str:
    """Return docs/commands.md."""
    rows = []
    for name, _, text in commands_of(parser):
        meant = "; ".join(f"{status}: {meaning}" for status, meaning in sorted(HELP[name].statuses.items()))
        rows.append(f"| `sagoma {name}` | {text} | {meant} |")
    statuses = "\n".join(f"| {status} | {meaning} |" for status, meaning in STATUSES.items())
    return PAGE.format(rows="\n".join(rows), statuses=statuses)


if __name__ == "__main__":
    sys.stdout.write(page(build_parser()))
