"""Runs a `sagoma` command that ends with a line of JSON, and records its figures as those of a bench.

python bench/sagoma_command.py --record=demo demo
python bench/sagoma_command.py --record=real_4cam evaluate ../shared/data/real_4cam --json
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys

from report import execute, finish, parser

from capture_rig.errors import InputError


def main() -> None:
    """Run the command, show what it prints, and take its last line as the figures."""
    given = parser(__doc__)
    given.add_argument("command", nargs=argparse.REMAINDER, help="subcommand of sagoma with its arguments")
    words = given.parse_args().command
    line = ""
    with subprocess.Popen([sys.executable, "-m", "sagoma_tools.cli", *words], stdout=subprocess.PIPE, text=True) as run:
        for following in run.stdout or ():
            print(line, end="", flush=True)
            line = following
    if run.returncode or not line.startswith("{"):
        remedy = "Give one that ends well and with a line of JSON: demo, or evaluate SESSION --json."
        raise InputError(
            f"it ended with status {run.returncode} and the line {line!r}", where=" ".join(words), remedy=remedy
        )
    finish(json.loads(line), command=["sagoma", *words])


if __name__ == "__main__":
    execute(main)
