"""``sagoma record | replay | compare | recover``: bags of the graph's topics."""

from __future__ import annotations

import argparse
import sys
import threading
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.settings import SECONDS, number
from capture_rig.stop_signals import StopOnSignal

from ..arguments import add_server_argument, add_settings_argument, new_run_folder, next_steps, parse_settings
from ..console import INTERRUPTED, doing, until_stopped
from ..graph import PATIENCE_S
from ..graph.ros_link import RosLink, add_namespace_argument, namespace_argument
from ..graph.topics import (
    CAMERA_INFO,
    CLOCK_TOPIC,
    DIAGNOSTICS,
    OUTPUT_TOPICS,
    SILHOUETTE_SUFFIX,
    camera_topics,
    cameras_in,
    image_topics,
    topics_of_others,
)
from ..recording.reader import bag_digest, bag_topics, default_comparison, first_difference, input_topics, read_messages
from ..recording.recorder import Recorder
from ..recording.replayer import (
    CLOCK_HZ,
    InputPublishers,
    LockstepReport,
    lockstep_into,
    play_timed,
    replay_through_graph,
    simulated_clock,
    timed_by_exposures,
    waiting,
)
from ..recording.writer import recover_bag, require_new
from ..takes.measure import finish_take


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the four subcommands."""
    parser = subparsers.add_parser("record", help="record the running graph into a rosbag2 bag (mcap) until Ctrl-C")
    parser.add_argument("bag", help="folder to make")
    parser.add_argument("--rig", help="rig YAML: record its cameras from the first frame on, and copy it into the bag")
    add_namespace_argument(parser)
    parser.add_argument("--seconds", type=SECONDS, help="stop after so long (default: run until Ctrl-C)")
    parser.set_defaults(run=record)

    parser = subparsers.add_parser("replay", help="play a bag through the graph: timed, or set by set (lockstep)")
    parser.add_argument("bag", help="rosbag2 bag (mcap or sqlite3), ours or of `ros2 bag record`")
    parser.add_argument("--rate", type=number("times", 1e-3, 1000), default=1.0, help="speed over the recorded one")
    help_topics = "inputs: what cameras send, for the graph; outputs: the rest, for viewers"
    parser.add_argument("--topics", choices=("inputs", "outputs", "all"), default="inputs", help=help_topics)
    parser.add_argument("--loop", action="store_true", help="begin again at the end, until Ctrl-C")
    rate, help_clock = number("Hz", 0.1, 10000), "publish the bag's time on /clock, for nodes with use_sim_time"
    parser.add_argument("--clock", nargs="?", type=rate, const=CLOCK_HZ, metavar="HZ", help=help_clock)
    parser.add_argument("--lockstep", action="store_true", help="send the next frame set when the EKF has answered")
    parser.add_argument("--graph", action="store_true", help="with --lockstep: start the server's nodes for this run")
    parser.add_argument("--output", metavar="BAG", help="with --graph: record the graph's output into this bag")
    parser.add_argument("--rig", help="with --graph: rig YAML (default: the one in the bag's folder)")
    parser.add_argument("--body", help="with --graph: body YAML for the trackers")
    add_server_argument(parser)
    add_settings_argument(parser)
    parser.set_defaults(run=replay)

    parser = subparsers.add_parser("compare", help="compare two bags byte for byte, topic by topic")
    parser.add_argument("a", help="a bag")
    parser.add_argument("b", help="another bag")
    parser.add_argument("--topics", nargs="+", help="topics to compare (default: all that must be the same)")
    parser.set_defaults(run=compare)

    parser = subparsers.add_parser("recover", help="make a readable bag of one whose recorder was killed")
    parser.add_argument("bag", help="folder with an .mcap file and no metadata.yaml")
    parser.add_argument("target", nargs="?", help="folder to make (default: BAG_recovered)")
    parser.set_defaults(run=recover)


def record(args: argparse.Namespace) -> int:
    """Record until stopped; cameras that the rig does not name, and persons, are found as they appear."""
    cameras = load_rig(args.rig).names if args.rig else ()
    of_cameras = [topic for camera in cameras for topic in camera_topics(camera)]
    with StopOnSignal() as stop, RosLink("sagoma_recorder", namespace=namespace_argument(args)) as link:

        def report_failure(error: InputError) -> None:
            print(f"sagoma: {error}", file=sys.stderr, flush=True)
            stop.set()

        topics = [*of_cameras, *OUTPUT_TOPICS, *topics_of_others(), DIAGNOSTICS]
        recorder = Recorder(link.node, args.bag, topics, on_failure=report_failure)
        recorder.add_new_sources()
        print(f"recording into {args.bag}; Ctrl-C ends it", flush=True)
        until_stopped()
        stop.wait(args.seconds)
        doing("closing the bag")
        counts = recorder.close_with_graph(Path(args.rig) if args.rig else None)
    finish_take(Path(args.bag))
    print_counts(counts)
    if any(counts.values()):
        print(next_steps(args.bag))
    return 0 if recorder.failure is None else 1


def replay(args: argparse.Namespace) -> int:
    """Replay a bag; 0 when everything was sent (and, in lockstep, answered)."""
    check_replay(args)
    with StopOnSignal() as stop:
        if args.graph:
            run_folder = new_run_folder(None, "replay")
            settings = parse_settings(args.settings)
            graph = {"rig": args.rig, "body": args.body, "settings": settings, "server": args.server}
            report = replay_through_graph(args.bag, args.output, run_folder, **graph, cancel=stop)
            return INTERRUPTED if stop.is_set() else print_report(report)
        with RosLink("sagoma_replayer") as link:
            if args.lockstep:
                report = lockstep_into(link.node, args.bag, cancel=stop)
                return INTERRUPTED if stop.is_set() else print_report(report)
            return replay_timed(args, link, stop)


def replay_timed(args: argparse.Namespace, link: RosLink, stop: threading.Event) -> int:
    """Publish the wanted topics with the timing of the bag."""
    types = bag_topics(args.bag)
    images = () if cameras_in(types) else image_topics(types)  # for clients with `source: topic`
    infos = {name for name, kind in types.items() if images and kind == CAMERA_INFO}
    inputs = {*images, *infos} if images else set(input_topics(args.bag))
    wanted = {"inputs": inputs, "outputs": set(types) - inputs, "all": set(types)}[args.topics]
    show = None if args.clock is None else simulated_clock(link.node)
    if show is not None:
        wanted.discard(CLOCK_TOPIC)  # one clock is enough
    publishers = InputPublishers(link.node, {name: types[name] for name in sorted(wanted)})
    pictures = [name for name in inputs & wanted if name in images or name.endswith(SILHOUETTE_SUFFIX)]
    if args.topics == "inputs":
        publishers.wait_for_subscribers(pictures, PATIENCE_S)
    if pictures:
        publishers.require_no_other(pictures)
    count = times = 0
    doing("playing the bag")
    while not (stop.is_set() or (times and not args.loop)):
        messages = timed_by_exposures(read_messages(args.bag, wanted.__contains__), pictures)
        count += play_timed(messages, publishers, waiting(stop), args.rate, show, args.clock or CLOCK_HZ)
        times += 1
        if not count:
            break
    print(f"played {count} messages on {len(wanted)} topics" + (f", in {times} rounds" if args.loop else ""))
    return INTERRUPTED if stop.is_set() and not args.loop else 0


def check_replay(args: argparse.Namespace) -> None:
    """Raises InputError for arguments that do not go together, before anything is started."""
    if args.graph != (args.output is not None) or (args.graph and not args.lockstep):
        remedy = "Write `sagoma replay BAG --graph --lockstep --output OUT`."
        raise InputError("--graph and --output belong together, with --lockstep", where="arguments", remedy=remedy)
    if args.output is not None:
        require_new(args.output)


def print_report(report: LockstepReport) -> int:
    """Print the result of a lockstep replay; 1 when a set was not answered."""
    print(f"replayed {report.sets} frame sets in lockstep, {len(report.unanswered_ns)} not answered")
    for stamp_ns in report.unanswered_ns[:10]:
        print(f"  no answer to the set of {stamp_ns} ns")
    for topic, count in report.unrecorded.items():
        print(f"  {topic}: {count} messages are missing in the recording")
    return 1 if report.unanswered_ns or report.unrecorded else 0


def compare(args: argparse.Namespace) -> int:
    """Print one line a topic with its SHA-256; 0 when all agree."""
    topics = args.topics or sorted({*default_comparison(args.a), *default_comparison(args.b)})
    if not topics:
        remedy = "Name the topics to compare with --topics."
        raise InputError("neither bag holds an output of the graph", where=f"{args.a}, {args.b}", remedy=remedy)
    doing(f"reading {args.a} and {args.b}")
    digests_a, digests_b = bag_digest(args.a, topics), bag_digest(args.b, topics)
    different = [topic for topic in topics if digests_a[topic] != digests_b[topic]]
    for topic in topics:
        verdict = "DIFFERENT" if topic in different else "identical"
        print(f"{verdict}  {digests_a[topic].count:6d} messages  sha256 {digests_a[topic].sha256[:16]}  {topic}")
    for topic in different:
        print(first_difference(args.a, args.b, topic))
    print("the bags differ" if different else f"identical on {len(topics)} topics")
    return 1 if different else 0


def recover(args: argparse.Namespace) -> int:
    """Copy the readable messages of a damaged bag into a new one, and print their number by topic."""
    target = args.target or args.bag.rstrip("/") + "_recovered"
    recovery = recover_bag(args.bag, target)
    finish_take(Path(target))
    print_counts(recovery.counts)
    print(f"{recovery}: {target}")
    return 0


def print_counts(counts: dict[str, int]) -> None:
    """Print the number of messages of each topic."""
    for name, count in sorted(counts.items()):
        print(f"{count:7d}  {name}")
