"""``sagoma export``, ``smooth`` and ``urdf``: a recorded take smoothed and in files of other programs; the body."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.number import FRAME_RATE, number
from ekf_tracker.rep155 import body_id_of, human_urdf
from ekf_tracker.urdf import body_urdf
from mocap_packets.fit import FIRST_PERSON
from mocap_pipeline.configuration import Configuration
from stick_figure.body import STATURES_M, Body, load_body

from ..arguments import add_settings_argument, add_takes_argument, bag_of, parse_settings
from ..console import doing
from ..graph.topics import FIRST_BODY_ID
from ..recording.smoothing import smooth_bag
from ..takes.exporting import EXPORTS, FORMATS, Options, export_take
from ..takes.measure import finish_take

ALL = "all"
STATURE_M = 1.75
MASS = number("kg", 2, 500)


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommands."""
    _add_smooth(subparsers)
    _add_export(subparsers)
    _add_urdf(subparsers)


def _add_export(subparsers: argparse._SubParsersAction) -> None:
    parser = subparsers.add_parser("export", help="write a take as BVH, glTF, C3D, TRC, OpenSim or CSV")
    option = parser.add_argument
    option("take", help="bag that `sagoma record`, `demo` or `smooth` wrote, or a take's name")
    help_format = "one or several of bvh, glb, c3d, trc, opensim (.osim and .mot), csv; or all"
    option("--format", nargs="+", default=[ALL], choices=(*FORMATS, ALL), metavar="FORMAT", help=help_format)
    option("--output", metavar="FOLDER", help="where the files go (default: TAKE/export)")
    option("--rate", type=FRAME_RATE, metavar="HZ", help="frames a second of the files (default: the take's own)")
    option("--mass", type=MASS, metavar="KG", help="of the person, for the OpenSim model (default: a BMI of 22)")
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


def _add_smooth(subparsers: argparse._SubParsersAction) -> None:
    parser = subparsers.add_parser("smooth", help="smooth a recorded take offline, in both directions of time")
    parser.add_argument("bag", help="bag that `sagoma record` or `demo` wrote")
    parser.add_argument("target", nargs="?", help="bag to make (default: BAG_smoothed)")
    add_settings_argument(parser)
    parser.set_defaults(run=run_smooth)


def run_smooth(args: argparse.Namespace) -> int:
    """Smooth the take and print how much of it has a state."""
    target = args.target or args.bag.rstrip("/") + "_smoothed"
    doing(f"smoothing {args.bag}")
    take = smooth_bag(args.bag, target, Configuration.of(parse_settings(args.settings)).ekf)
    finish_take(Path(target))
    others = [f"{sets} of person {person}" for person, sets in sorted(take.states.items()) if person != FIRST_PERSON]
    print(f"smoothed {', '.join([f'{take.states[FIRST_PERSON]} of {take.sets} frame sets', *others])} into {target}")
    print(f"compare: sagoma evaluate {args.bag}; sagoma evaluate {target}")
    return 0


def _add_urdf(subparsers: argparse._SubParsersAction) -> None:
    parser = subparsers.add_parser("urdf", help="print the body as a URDF with the joints of /mocap/joint_states")
    parser.add_argument("--body", help="body YAML, as ~/save_body of icp_tracker writes it")
    help_stature = f"an average body of this height in metres (default {STATURE_M})"
    parser.add_argument("--stature", type=number("m", *STATURES_M), help=help_stature)
    help_id = f"what names of links begin with (default {FIRST_BODY_ID}, the first person's)"
    parser.add_argument("--id", default=FIRST_BODY_ID, help=help_id)
    parser.add_argument("--mass", type=MASS, metavar="KG", help="of the person (default: a BMI of 22)")
    parser.add_argument("--rep155", action="store_true", help="the URDF of REP-155, for /humans/bodies/ID/joint_states")
    parser.add_argument("--output", help="file to write (default: print it)")
    parser.set_defaults(run=run_urdf)


def run_urdf(args: argparse.Namespace) -> int:
    """Print or write the URDF."""
    if args.body and args.stature is not None:
        raise InputError("--body has a stature of its own", where="arguments", remedy="Give --body or --stature.")
    body = load_body(args.body) if args.body else Body.from_stature(STATURE_M if args.stature is None else args.stature)
    body_id = body_id_of(args.id, FIRST_PERSON)
    text = (human_urdf if args.rep155 else body_urdf)(body, body_id, args.mass)
    if not args.output:
        sys.stdout.write(text)
        return 0
    try:
        with open(args.output, "x") as file:
            file.write(text)
    except FileExistsError:
        raise InputError("exists already", where=args.output, remedy="Give another name, or move it away.") from None
    except OSError as error:
        remedy = "Give a folder that exists and that you may write to."
        raise InputError(f"cannot be written ({error.strerror})", where=args.output, remedy=remedy) from error
    print(f"written: {args.output}")
    return 0
