"""``sagoma recover``: make a readable bag of one whose writer was killed."""

from __future__ import annotations

import argparse

from ..recording.writer import recover_bag


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("recover", help="make a readable bag of one whose recorder was killed")
    parser.add_argument("bag", help="folder with an .mcap file and no metadata.yaml")
    parser.add_argument("target", nargs="?", help="folder to make (default: BAG_recovered)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Recover what can be read, and say what that was."""
    target = args.target or args.bag.rstrip("/") + "_recovered"
    counts = recover_bag(args.bag, target)
    for name, count in sorted(counts.items()):
        print(f"{count:7d}  {name}")
    print(f"recovered {sum(counts.values())} messages into {target}")
    return 0
