"""Plays a bag's messages into the live graph: with the timing of the exposures, or set by set (lockstep).

In lockstep the next frame set is published when the EKF has answered the one before, so nothing is dropped and
nothing depends on how fast anything runs: the same bag gives the same bytes. The graph is one that runs, or one that is
started for the replay.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock as ClockMessage

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from mocap_packets.frame_set import TIME_JUMP_NS, FrameSet
from sagoma_bringup.graph import LOSSLESS_SETTINGS, ONE_PROCESS, THREE_PROCESSES, build_graph
from sagoma_ros.images import absence_message
from sagoma_ros.messages import to_stamp

from ..console import doing
from ..graph import ANSWER_S, PATIENCE_S, ROUND_S
from ..graph.ros_link import RosLink, settled
from ..graph.supervisor import Supervisor
from ..graph.topics import (
    CLOCK_TOPIC,
    LATENCY_TOPIC,
    LOSSLESS,
    SILHOUETTE_SUFFIX,
    camera_topics,
    cameras_in,
    message_class,
    offered_qos,
)
from .reader import (
    SIDECAR_RIG,
    BagMessage,
    bag_cameras,
    bag_topics,
    frame_tolerance_ns,
    header_stamp_ns,
    input_topics,
    read_frame_sets,
)
from .recorder import GraphRecorder, server_topics

SERVER_ALONE = "`sagoma up --rig RIG --only server`"
CLOCK_HZ = 100.0  # latencies by a clock of steps are that coarse: 10 ms, a set at 100 Hz


def waiting(stop: threading.Event) -> Callable[[float], bool]:
    """Return a function that waits until so many seconds from now on have passed; False once ``stop`` is set, which
    wakes it."""
    began_s = time.monotonic()
    return lambda due_s: not stop.wait(max(0.0, began_s + due_s - time.monotonic()))


def simulated_clock(node: Node) -> Callable[[int], None]:
    """Return a function that publishes a time on /clock, for nodes with `use_sim_time`, as ``ros2 bag play --clock``
    gives that of the recording."""
    publisher = node.create_publisher(ClockMessage, CLOCK_TOPIC, LOSSLESS)
    return lambda time_ns: publisher.publish(ClockMessage(clock=to_stamp(time_ns)))


class InputPublishers:
    """Publishes the topics of a bag reliably."""

    def __init__(self, node: Node, topics: Mapping[str, str]) -> None:
        """``topics``: name -> message type."""
        self._node = node
        self._publishers: dict[str, Publisher] = {
            name: node.create_publisher(message_class(msgtype), name, offered_qos(name))
            for name, msgtype in topics.items()
        }

    def wait_for_subscribers(self, topics: Iterable[str], timeout_s: float) -> None:
        """Return once every one of ``topics`` has a subscriber; InputError names those that have none in time."""
        names = {*topics}
        heard = settled(lambda: set(filter(self._node.count_subscribers, names)), len(names), timeout_s)
        if missing := names.difference(heard):
            remedy = f"Start the hull server ({SERVER_ALONE}), or check ROS_DOMAIN_ID and its rig's camera names."
            raise InputError(f"no subscriber within {timeout_s:g} s", where=", ".join(sorted(missing)), remedy=remedy)

    def require_no_other(self, topics: Iterable[str]) -> None:
        """Raises InputError when another node publishes one of ``topics``, as a live camera does: bodies would leap
        between the two. Looks until discovery is quiet."""
        names, own = tuple(topics), self._node.get_fully_qualified_name()

        def others() -> set[str]:
            found = (info for name in names for info in self._node.get_publishers_info_by_topic(name))
            return {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found} - {own}

        if live := settled(others, 0, ANSWER_S):
            remedy = f"Stop the cameras, run the server alone ({SERVER_ALONE}), or use another ROS_DOMAIN_ID."
            raise InputError("live cameras publish these silhouettes already", where=", ".join(live), remedy=remedy)

    def publish(self, message: BagMessage) -> None:
        """Publish the serialized message as it is."""
        self._publishers[message.topic].publish(message.data)

    def publish_absences(self, frame_set: FrameSet[list[BagMessage]]) -> None:
        """Say of every camera with a topic here that lacks in the set that it has no frame: nobody waits for it."""
        for camera in cameras_in(self._publishers):
            if camera not in frame_set.frames:
                self._publishers[f"/{camera}{SILHOUETTE_SUFFIX}"].publish(absence_message(frame_set.stamp_ns))


def timed_by_exposures(messages: Iterable[BagMessage], pictures: Collection[str]) -> Iterator[BagMessage]:
    """Yield the messages with log times as of a recording during which the stamps of ``pictures`` kept step with time.

    They do not in a take of footage at rate 0 or of cameras in slow motion; played by its log times, its stamps would
    fall behind time, which a server takes for a queue. What is no picture goes with the picture before it.
    """
    time_ns = newest_ns = last_log_ns = 0
    for message in messages:
        stamp_ns = message.stamp_ns if message.topic in pictures else 0
        if stamp_ns and newest_ns and stamp_ns > newest_ns - TIME_JUMP_NS:
            time_ns, newest_ns = time_ns + max(stamp_ns - newest_ns, 0), max(stamp_ns, newest_ns)
        elif stamp_ns or not newest_ns:  # a beginning, or no picture has come yet: as recorded
            time_ns, newest_ns = time_ns + message.log_ns - last_log_ns, stamp_ns
        last_log_ns = message.log_ns
        yield replace(message, log_ns=time_ns)


def play_timed(
    messages: Iterable[BagMessage],
    publishers: InputPublishers,
    wait: Callable[[float], bool],
    rate: float = 1.0,
    show: Callable[[int], None] | None = None,
    hz: float = CLOCK_HZ,
) -> int:
    """Publish each message when its log time has come, ``rate`` times as fast as recorded; returns how many.

    wait : as :func:`waiting` makes it. show : gets the bag's time, ``hz`` times a second, from the first message to the
    last.
    """
    count, ticks, first_ns = 0, 0, 0
    for message in messages:
        first_ns = first_ns or message.log_ns
        due_s = (message.log_ns - first_ns) / 1e9 / rate
        while show is not None and (ticks == 0 or ticks / hz < due_s):
            if not wait(ticks / hz):
                return count
            show(first_ns + round(ticks / hz * rate * 1e9))
            ticks += 1
        if not wait(due_s):
            break
        publishers.publish(message)
        count += 1
    return count


@dataclass
class LockstepReport:
    """The result of a lockstep replay: frame sets published, the stamps of those that the EKF never answered, and how
    many messages of topics with one a set are missing in the recording."""

    sets: int = 0
    unanswered_ns: list[int] = field(default_factory=list)
    unrecorded: dict[str, int] = field(default_factory=dict)


class Answers:
    """The EKF's answers: it publishes one latency for every frame set, last of all, stamped with the set's stamp."""

    def __init__(self, node: Node) -> None:
        self._arrived = threading.Condition()
        self._stamps: set[int] = set()
        self._subscription = node.create_subscription(
            DiagnosticArray, LATENCY_TOPIC, self._on_answer, LOSSLESS, raw=True
        )

    def wait_for(self, stamp_ns: int, timeout_s: float) -> bool:
        """True as soon as the answer to the set with this stamp has come."""
        with self._arrived:
            return self._arrived.wait_for(lambda: stamp_ns in self._stamps, timeout_s)

    def _on_answer(self, data: bytes) -> None:
        with self._arrived:
            self._stamps.add(header_stamp_ns(data))
            self._arrived.notify_all()


def play_lockstep(
    frame_sets: Iterable[FrameSet[list[BagMessage]]],
    publishers: InputPublishers,
    answers: Answers,
    *,
    timeout_s: float,
    cancel: threading.Event | None = None,
    progress: Callable[[int], None] = lambda sets: None,
) -> LockstepReport:
    """Publish one frame set after another, each when the EKF has answered the last.

    A set that is not answered within ``timeout_s`` is noted and the next one follows; InputError when the very first
    one is not, since then the graph does not run or is not connected. ``cancel`` ends it between two sets.
    """
    report = LockstepReport()
    for frame_set in frame_sets:
        if cancel is not None and cancel.is_set():
            break
        for frame in frame_set.frames.values():  # cameras in name order
            for message in frame:
                publishers.publish(message)
        publishers.publish_absences(frame_set)
        report.sets += 1
        progress(report.sets)
        if not answers.wait_for(frame_set.stamp_ns, timeout_s):
            report.unanswered_ns.append(frame_set.stamp_ns)
            if report.sets == 1:
                what = f"no answer to the first frame set within {timeout_s:g} s"
                remedy = "All of hull_server, icp_tracker and ekf_tracker must be active."
                raise InputError(what, where=LATENCY_TOPIC, remedy=remedy)
    return report


# through a graph started for it ---------------------------------------------------------------------------------------


TOLERANCE = "hull_server.tolerance_s"
PER_SET = (
    "/hull/contour_rays",
    "/hull/centerline",
    "/hull/voxels",
    "/icp/reference_points",
    "/icp/fit",
    "/ekf/prediction",
    LATENCY_TOPIC,
)
# topic -> the node that must listen to it before the first set is sent, where each has a process of its own
LISTENERS = {"/hull/products": "icp_tracker", "/icp/people": "ekf_tracker", "/ekf/prediction": "icp_tracker"}


def replay_through_graph(
    bag: str | Path,
    output: str | Path,
    run_folder: str | Path,
    *,
    rig: str | Path | None = None,
    body: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    cancel: threading.Event | None = None,
    server: str = ONE_PROCESS,
) -> LockstepReport:
    """Start hull server, ICP and EKF, replay the bag's frame sets in lockstep, record their output into ``output``.

    rig : by default the one that lies in the bag's folder.
    server : ONE_PROCESS or THREE_PROCESSES; the bytes are the same.
    settings : parameters as for :func:`sagoma_bringup.graph.build_graph`; they win over the lossless ones.
    """
    rig_file = matching_rig(bag, rig)
    measured = {TOLERANCE: frame_tolerance_ns(bag) / 1e9}
    chosen = {**LOSSLESS_SETTINGS, **measured, **(settings or {})}
    graph = build_graph(rig=rig_file, body=body, settings=chosen)
    made_from = {"replayed_from": str(Path(bag).resolve()), "mode": "lockstep"}
    with Supervisor(graph, run_folder, server, cancel=cancel) as supervisor:
        doing(f"starting {len(graph)} nodes")
        supervisor.configure()
        with (
            GraphRecorder(graph, output, topics=server_topics(graph), provenance=made_from, canonical=True) as recorder,
            RosLink("sagoma_replayer") as link,
        ):
            recorder.wait_for_graph()
            supervisor.activate()
            if server == THREE_PROCESSES:  # else they hand over in memory
                wait_for_listeners(link.node, PATIENCE_S)
            tolerance_ns = round(chosen[TOLERANCE] * 1e9)  # sets are formed here as the hull server forms them
            cameras = load_rig(rig_file).names
            report = lockstep_into(link.node, bag, cameras, tolerance_ns=tolerance_ns, cancel=cancel)
            recorder.wait_until_quiet(ROUND_S, PATIENCE_S)
            report.unrecorded = {t: n for t in PER_SET if (n := report.sets - recorder.counts[t]) != 0}
    return report


def lockstep_into(
    node: Node,
    bag: str | Path,
    cameras: Sequence[str] = (),
    *,
    tolerance_ns: int | None = None,
    cancel: threading.Event | None = None,
) -> LockstepReport:
    """Replay a bag in lockstep into a running graph; ``node`` must be spun by another thread.

    cameras : those of the graph, where they are known: it waits for none that the bag does not have.
    """
    types = bag_topics(bag)
    answers = Answers(node)
    topics = {topic.name: topic.msgtype for camera in cameras for topic in camera_topics(camera)}
    publishers = InputPublishers(node, topics | {name: types[name] for name in input_topics(bag)})
    silhouettes = [f"/{camera}{SILHOUETTE_SUFFIX}" for camera in {*cameras, *bag_cameras(bag)}]
    publishers.wait_for_subscribers(silhouettes, PATIENCE_S)
    publishers.require_no_other(silhouettes)
    frame_sets = read_frame_sets(bag, frame_tolerance_ns(bag) if tolerance_ns is None else tolerance_ns)
    done = doing("replaying frame sets")
    return play_lockstep(frame_sets, publishers, answers, timeout_s=PATIENCE_S, cancel=cancel, progress=done)


def wait_for_listeners(node: Node, timeout_s: float) -> None:
    """Return once the server's nodes subscribe to each other. Raises InputError naming missing subscriptions."""

    def heard() -> set[str]:
        infos = {topic: node.get_subscriptions_info_by_topic(topic) for topic in LISTENERS}
        return {topic for topic, listener in LISTENERS.items() if listener in {one.node_name for one in infos[topic]}}

    if missing := sorted(set(LISTENERS) - {*settled(heard, len(LISTENERS), timeout_s)}):
        what = f"not heard by {', '.join(sorted({LISTENERS[topic] for topic in missing}))} within {timeout_s:g} s"
        raise InputError(what, where=", ".join(missing), remedy="All three nodes of the server must be active.")


def matching_rig(bag: str | Path, rig: str | Path | None) -> Path:
    """The rig file to replay a bag with; InputError when there is none, or when its cameras are not the bag's."""
    rig_file = Path(rig) if rig is not None else Path(bag) / SIDECAR_RIG
    if not rig_file.is_file():
        raise InputError("there is no rig file", where=str(rig_file), remedy="Give one with --rig.")
    known, recorded = load_rig(rig_file).names, bag_cameras(bag)
    unknown = [name for name in recorded if name not in known]
    if unknown:
        what = f"the bag has silhouettes of {', '.join(unknown)}, which the rig does not know"
        raise InputError(what, where=str(rig_file), remedy=f"Known cameras: {', '.join(known)}.")
    return rig_file
