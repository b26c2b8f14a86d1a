"""``sagoma smooth``: a take's motion, seen from both sides in time, in a new bag."""

from __future__ import annotations

import argparse
from pathlib import Path

from mocap_packets.fit import FIRST_PERSON
from mocap_pipeline.configuration import Configuration

from ..arguments import add_settings_argument, parse_settings
from ..progress_line import doing
from ..recording.smoothing import smooth_bag
from ..takes.summary_file import finish_take


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("smooth", help="smooth a recorded take offline, in both directions of time")
    parser.add_argument("bag", help="bag that `sagoma record` or `demo` wrote")
    parser.add_argument("target", nargs="?", help="bag to make (default: BAG_smoothed)")
    add_settings_argument(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Smooth the take and print how much of it has a state."""
    target = args.target or args.bag.rstrip("/") + "_smoothed"
    doing(f"smoothing {args.bag}")
    take = smooth_bag(args.bag, target, Configuration.of(parse_settings(args.settings)).ekf)
    finish_take(Path(target))
    others = [f"{sets} of person {person}" for person, sets in sorted(take.states.items()) if person != FIRST_PERSON]
    print(f"smoothed {', '.join([f'{take.states[FIRST_PERSON]} of {take.sets} frame sets', *others])} into {target}")
    print(f"compare: sagoma evaluate {args.bag}; sagoma evaluate {target}")
    return 0
