"""``sagoma export``: the motion of a recorded take as files of other programs."""

from __future__ import annotations

import argparse
from pathlib import Path

from capture_rig.number import number

from ..arguments import FRAME_RATE, add_takes_argument, bag_of
from ..takes.exporting import EXPORTS, FORMATS, Options, export_take

ALL = "all"


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("export", help="write a take as BVH, glTF, C3D, TRC, OpenSim or CSV")
    option = parser.add_argument
    option("take", help="bag that `sagoma record`, `demo` or `smooth` wrote, or a take's name")
    help_format = "one or several of bvh, glb, c3d, trc, opensim (.osim and .mot), csv; or all"
    option("--format", nargs="+", default=[ALL], choices=(*FORMATS, ALL), metavar="FORMAT", help=help_format)
    option("--output", metavar="FOLDER", help="where the files go (default: TAKE/export)")
    option("--rate", type=FRAME_RATE, metavar="HZ", help="frames a second of the files (default: the take's own)")
    option(
        "--mass",
        type=number("kg", 2, 500),
        metavar="KG",
        help="of the person, for the OpenSim model (default: a BMI of 22)",
    )
    option("--constant-bones", action="store_true", help="BVH without position channels below the root")
    option("--overwrite", action="store_true", help="replace files of earlier exports")
    add_takes_argument(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write every person of the take in every format wanted, and print what was written and what a format lost."""
    formats = list(FORMATS) if ALL in args.format else args.format
    take = bag_of(args.take, args.takes)
    folder = Path(args.output) if args.output else take / EXPORTS
    export_take(take, folder, formats, Options(args.rate, args.mass, args.constant_bones, args.overwrite), tell=print)
    return 0
