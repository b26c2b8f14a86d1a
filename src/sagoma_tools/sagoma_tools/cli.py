"""The ``sagoma`` command: one subcommand a module in ``commands``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from capture_rig.errors import InputError
from capture_rig.files import describe_os_error

from .commands import (
    background,
    calibrate,
    demo,
    doctor,
    evaluate,
    export,
    graph,
    import_session,
    recording,
    smooth,
    takes,
    urdf,
    view,
)
from .graph.supervisor import GraphError

COMMANDS = (
    demo,
    calibrate,
    background,
    graph,
    recording,
    takes,
    smooth,
    view,
    evaluate,
    export,
    import_session,
    urdf,
    doctor,
)
GRAPH_FAILED, BAD_INPUT = 1, 2


def build_parser() -> argparse.ArgumentParser:
    """The parser of the whole command line; every subcommand sets ``run``, a function of the parsed arguments."""
    parser = argparse.ArgumentParser("sagoma", description="Markerless motion capture: run, record, replay, measure.")
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand; 0 when it did what it was asked, 1 when the graph failed, 2 for input it cannot use."""
    args = build_parser().parse_args(argv)
    try:
        return args.run(args)
    except GraphError as error:
        print(f"sagoma: {error}", file=sys.stderr)
        return GRAPH_FAILED
    except InputError as error:
        print(f"sagoma: {error}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:  # who read our output has gone; there is nobody to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BAD_INPUT
    except OSError as error:  # a file or folder that cannot be used, wherever it was named
        print(f"sagoma: {describe_os_error(error, 'cannot be used')}", file=sys.stderr)
        return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
