"""``sagoma replay``: play a bag into the graph, with its own timing, faster or slower, or set by set (lockstep)."""

from __future__ import annotations

import argparse
import threading

from capture_rig.errors import InputError

from ..arguments import StopOnSignal, add_settings_argument, new_run_folder, parse_settings
from ..graph.ros_link import RosLink
from ..graph.topics import SILHOUETTE_SUFFIX
from ..recording.lockstep import lockstep_into, replay_through_graph
from ..recording.reader import bag_topics, input_topics, read_messages
from ..recording.replayer import InputPublishers, LockstepReport, MonotonicClock, play_timed
from ..recording.writer import require_new

SUBSCRIBER_TIMEOUT_S = 30.0


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("replay", help="play a bag through the graph: timed, or set by set (lockstep)")
    parser.add_argument("bag", help="rosbag2 bag (mcap or sqlite3), ours or of `ros2 bag record`")
    parser.add_argument("--rate", type=float, default=1.0, help="speed as a factor of the recorded timing")
    parser.add_argument(
        "--topics",
        choices=("inputs", "outputs", "all"),
        default="inputs",
        help="inputs: what cameras send, for the graph; outputs: the rest, for viewers",
    )
    parser.add_argument("--lockstep", action="store_true", help="send the next frame set when the EKF has answered")
    parser.add_argument("--graph", action="store_true", help="with --lockstep: start the server's nodes for this run")
    parser.add_argument("--output", metavar="BAG", help="with --graph: record what the graph says into this bag")
    parser.add_argument("--rig", help="with --graph: rig YAML (default: the one in the bag's folder)")
    parser.add_argument("--body", help="with --graph: body YAML for the trackers")
    parser.add_argument("--run-folder", help="with --graph: where logs go (default: output/replay-DATE-TIME)")
    add_settings_argument(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replay; 0 when everything was sent (and, in lockstep, answered)."""
    _check(args)
    with StopOnSignal() as stop:
        if args.graph:
            report = replay_through_graph(
                args.bag,
                args.output,
                new_run_folder(args.run_folder, "replay"),
                rig=args.rig,
                body=args.body,
                settings=parse_settings(args.settings),
                cancel=stop,
            )
            return print_report(report)
        with RosLink("sagoma_replayer") as link:
            if args.lockstep:
                return print_report(lockstep_into(link.node, args.bag, cancel=stop))
            return _play(args, link, stop)


def print_report(report: LockstepReport) -> int:
    """What a lockstep replay did, in words; 1 when a set was not answered."""
    print(f"replayed {report.sets} frame sets in lockstep, {len(report.unanswered_ns)} not answered")
    for stamp_ns in report.unanswered_ns[:10]:
        print(f"  no answer to the set of {stamp_ns} ns")
    if report.stray_answers:
        print(f"  {report.stray_answers} answers to sets that were not asked: does something else feed this graph?")
    for topic, count in report.unrecorded.items():
        print(f"  {topic}: {count} messages are missing in the recording")
    return 1 if report.unanswered_ns or report.stray_answers or report.unrecorded else 0


def _play(args: argparse.Namespace, link: RosLink, stop: threading.Event) -> int:
    types = bag_topics(args.bag)
    inputs = set(input_topics(args.bag))
    wanted = {"inputs": inputs, "outputs": set(types) - inputs, "all": set(types)}[args.topics]
    publishers = InputPublishers(link.node, {name: types[name] for name in sorted(wanted)})
    if args.topics == "inputs":
        silhouettes = [name for name in inputs if name.endswith(SILHOUETTE_SUFFIX)]
        publishers.wait_for_subscribers(silhouettes, SUBSCRIBER_TIMEOUT_S)
    count = play_timed(read_messages(args.bag, wanted.__contains__), publishers, MonotonicClock(stop), args.rate)
    print(f"played {count} messages on {len(wanted)} topics")
    return 0


def _check(args: argparse.Namespace) -> None:
    """Refuse combinations that mean nothing, before anything is started."""
    if args.graph != (args.output is not None) or (args.graph and not args.lockstep):
        raise InputError(
            "--graph and --output belong together, with --lockstep",
            where="arguments",
            remedy="Write `sagoma replay BAG --graph --lockstep --output OUT`.",
        )
    if args.rate <= 0:
        raise InputError(
            f"--rate {args.rate:g} is not a speed",
            where="arguments",
            remedy="Give a factor above 0, or --lockstep for as fast as the graph can.",
        )
    if args.output is not None:
        require_new(args.output)
