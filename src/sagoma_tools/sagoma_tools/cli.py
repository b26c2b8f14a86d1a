"""The ``sagoma`` command: subcommands in the modules of ``commands``, loaded on demand."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module

from capture_rig.errors import InputError
from capture_rig.files import describe_os_error
from sagoma_ros.middleware import use_peers

from .console import BAD_INPUT, FAILED, INTERRUPTED, NO_READER, CommandParser, describe, until_stopped
from .graph import GraphError

COMMANDS = {
    "demo": ("demo",),
    "calibrate": ("calibrate",),
    "background": ("background",),
    "graph": ("up", "start", "suspend", "stop", "view", "studio"),
    "recording": ("record", "replay", "compare", "recover"),
    "takes": ("takes", "smooth", "export", "urdf"),
    "evaluate": ("evaluate",),
    "import_session": ("import",),
    "doctor": ("doctor",),
}
"""Module -> its subcommands, in the order of the help."""
ON_A_GRAPH = {"up", "start", "suspend", "stop", "background", "record", "view", "doctor"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand; statuses: docs/reference/commands.md. Users' errors never show a traceback."""
    try:
        try:
            return run(list(sys.argv[1:] if argv is None else argv))
        finally:
            sys.stdout.flush()
    except GraphError as error:
        return _refuse(error, FAILED)
    except InputError as error:
        return _refuse(error, BAD_INPUT)
    except KeyboardInterrupt:
        return _refuse("interrupted", INTERRUPTED)
    except BrokenPipeError:  # nobody reads the output
        _drop_output()
        return NO_READER
    except OSError as error:  # a file or folder that cannot be used, wherever it was named
        return _refuse(describe_os_error(error, "cannot be used"), BAD_INPUT)


def run(argv: list[str]) -> int:
    """Parse the arguments, and run their command."""
    args, unknown = build_parser(modules_for(argv)).parse_known_args(argv)
    leaf = vars(args).pop("leaf")
    if unknown:
        leaf.error(f"unknown {' '.join(unknown)}")
    if (peers := vars(args).pop("peers", None)) is not None:
        use_peers(peers)
    try:
        return args.run(args)
    finally:
        until_stopped()


def build_parser(modules: Sequence[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """The parser of the whole command line; every subcommand sets ``run``, a function of the parsed arguments."""
    parser = CommandParser("sagoma", description="Markerless motion capture: run, record, replay, measure.")
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name in modules:
        import_module(f".commands.{name}", __package__).add_parser(subparsers)
    for name in ON_A_GRAPH & subparsers.choices.keys():
        text = "the graph's other machines: found by unicast alone, with our Fast DDS profile (docs/how-to/hosts.md)"
        subparsers.choices[name].add_argument("--peers", metavar="ADDRESS,...", help=text)
    describe(parser)
    return parser


def modules_for(argv: Sequence[str]) -> tuple[str, ...]:
    """Return the module of the requested subcommand, or all: each loads in a second or two."""
    return tuple(name for name, commands in COMMANDS.items() if argv and argv[0] in commands) or tuple(COMMANDS)


def _drop_output() -> None:
    """Let stdout lead nowhere: Python flushes it once more at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _refuse(why: object, status: int) -> int:
    print(f"sagoma: {why}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
