"""``sagoma doctor``: faults of this machine, the rig or the running graph, with remedies."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.rig import load_rig, save_rig
from capture_rig.settings import number
from capture_rig.stop_signals import StopOnSignal

from ..console import CommandConsole, doing, until_stopped
from ..doctor.cameras import examine_camera
from ..doctor.findings import CheckResult, about, exit_status, show, summary
from ..doctor.graph import examine_graph
from ..doctor.hosts import PORT, examine_hosts, serve
from ..doctor.machine import examine_machine
from ..doctor.rig import examine_rig, needed_parts
from ..graph import ANSWER_S
from ..graph.ros_link import add_namespace_argument, namespace_argument

DESCRIPTION = (
    "Examine this machine; with --rig also a rig and its calibration, with --live also the running graph, with "
    "--camera also a camera PC's parameter file and its camera"
)


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    help_text = "examine this machine, a rig, a camera PC, the running graph: findings with remedies"
    parser = subparsers.add_parser("doctor", help=help_text, description=DESCRIPTION)
    option = parser.add_argument
    option("what", nargs="?", choices=["camera"], help="'camera PARAMS.yaml' is --camera PARAMS.yaml")
    option("parameters", nargs="?", metavar="PARAMS.yaml", type=Path, help=argparse.SUPPRESS)
    help_camera = "a camera's parameter file (any number of times)"
    option("--camera", action="append", default=[], metavar="PARAMS.yaml", type=Path, help=help_camera)
    option("--open", action="store_true", help="take control of those cameras for a moment, as their clients would")
    option("--rig", metavar="RIG.yaml", type=Path, help="the rig file")
    help_regions = "write the rig file of the parts of the pictures that the volume needs, which the report lists"
    option("--regions", metavar="FILE.yaml", type=Path, help=help_regions)
    option("--live", action="store_true", help="listen to the running graph")
    add_namespace_argument(parser)
    option("--seconds", type=number("s", 0.1, 3600), default=ANSWER_S, help="how long to listen (default: %(default)g)")
    help_host = "another machine of the graph: does it answer, which packets get there?"
    option("--host", action="append", default=[], metavar="ADDRESS", help=help_host)
    help_answer = "serve another machine's --host with the ROS settings of the nodes here; until Ctrl-C"
    option("--answer", action="store_true", help=help_answer)
    option("--no-machine", action="store_true", help="leave this machine out")
    option("--json", action="store_true", help="print one line of JSON instead of text")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Examine and print; the exit status is the gravest finding's."""
    if args.what and args.parameters is None:
        raise InputError("no parameter file is given", where="doctor camera", remedy="Write: sagoma doctor camera FILE")
    if args.answer:
        return answer()
    if args.regions is not None:
        if args.rig is None:
            raise InputError("no rig is given", where="doctor --regions", remedy="Add --rig RIG.yaml.")
        save_rig(needed_parts(load_rig(args.rig)), args.regions)
    doing("examining")
    findings = list(examined(args))
    until_stopped()
    status = exit_status(findings)
    if args.json:
        listed = [finding.as_dict() for finding in findings]
        print(json.dumps({"status": status, "summary": summary(findings), "findings": listed}))
    else:
        show(findings, CommandConsole())
    return status


def answer() -> int:
    """Answer the doctor of other machines until Ctrl-C."""
    with StopOnSignal() as stop:
        text = f"answering `sagoma doctor --host` on UDP port {PORT}; Ctrl-C ends it"
        until_stopped()
        serve(stop, ready=lambda: print(text, flush=True))
    return 0


def examined(args: argparse.Namespace) -> Iterator[CheckResult]:
    """Yield the findings on everything that the arguments name."""
    if not args.no_machine:
        yield from examine_machine()
    for path in [*args.camera, *filter(None, [args.parameters])]:
        yield from about(f"camera file {path}", examine_camera(path, args.open))
    yield from examine_hosts(args.host)
    if args.rig is not None:
        yield from about("rig", examine_rig(args.rig))
    if args.live:
        yield from about("graph", examine_graph(args.seconds, args.rig, namespace=namespace_argument(args)))
