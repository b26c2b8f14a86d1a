"""``sagoma urdf``: the body as a URDF, for robot_state_publisher, rviz, and whatever reads robots."""

from __future__ import annotations

import argparse
import sys

from capture_rig.errors import InputError
from capture_rig.number import number
from ekf_tracker.rep155 import body_id_of, human_urdf
from ekf_tracker.urdf import body_urdf
from mocap_packets.fit import FIRST_PERSON
from stick_figure.body import STATURES_M, Body
from stick_figure.body_file import load_body

from ..graph.topics import FIRST_BODY_ID

STATURE_M = 1.75


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("urdf", help="print the body as a URDF with the joints of /mocap/joint_states")
    parser.add_argument("--body", help="body YAML, as ~/save_body of icp_tracker writes it")
    help_stature = f"an average body of this height in metres (default {STATURE_M})"
    parser.add_argument("--stature", type=number("m", *STATURES_M), help=help_stature)
    help_id = f"what names of links begin with (default {FIRST_BODY_ID}, the first person's)"
    parser.add_argument("--id", default=FIRST_BODY_ID, help=help_id)
    parser.add_argument("--rep155", action="store_true", help="the URDF of REP-155, for /humans/bodies/ID/joint_states")
    parser.add_argument("--output", help="file to write (default: print it)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print or write the URDF."""
    if args.body and args.stature is not None:
        raise InputError("--body has a stature of its own", where="arguments", remedy="Give --body or --stature.")
    body = load_body(args.body) if args.body else Body.from_stature(STATURE_M if args.stature is None else args.stature)
    body_id = body_id_of(args.id, FIRST_PERSON)
    text = human_urdf(body, body_id) if args.rep155 else body_urdf(body, body_id)
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
