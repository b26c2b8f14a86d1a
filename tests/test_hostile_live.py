"""A running graph under hostile messages: nothing dies, tracking goes on, and what was refused is counted.

The whole graph runs on footage of the virtual studio, every node a process. Topics and services are those that the
graph has (introspection), so new ones are attacked too.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_messages import Attack, attacks, requests, with_stamp
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from sagoma_bringup.graph import THREE_PROCESSES, build_graph
from sagoma_tools.graph.ros_link import RosLink, call_all, settled
from sagoma_tools.graph.supervisor import Supervisor
from sagoma_tools.graph.topics import LATENCY_TOPIC, OUTPUT_TOPICS, message_class, type_of
from stick_figure.body import Body
from virtual_studio.recording.session import RenderSettings, write_session
from virtual_studio.rig import ring

FPS, SECONDS = 4.0, 40.0  # of the footage, which is played again and again; a slow rate, for busy machines
ALIVE_ANSWERS, ALIVE_TIMEOUT_S = 5, 20.0
LISTEN_S = 3.0  # for a valid message of each topic
CALL_TIMEOUT_S, DISCOVERY_TIMEOUT_S = 2.0, 5.0
SOON_NS = 20_000_000  # attacks are later than the last set by so much: what is old is dropped unread
NEAR_NS = 60_000_000_000
NOT_OURS = ("/rosout", "/parameter_events", "/clock")
REPEAT, PAUSE_S = 4, 5e-3


class Target:
    """The running graph, and what can be seen of it from outside."""

    def __init__(self, supervisor: Supervisor, link: RosLink) -> None:
        self.supervisor, self.link = supervisor, link
        self._changed = threading.Condition()
        self._answers = 0
        self.latest_ns = time.time_ns()
        kind = message_class(type_of(LATENCY_TOPIC) or "")
        link.node.create_subscription(kind, LATENCY_TOPIC, self._answered, 100, raw=True)

    def _answered(self, data: bytes) -> None:
        with self._changed:
            self._answers += 1
            with suppress(struct.error):
                sec, nanosec = struct.unpack_from("<iI", data, 4)
                stamp_ns = sec * 1_000_000_000 + nanosec
                if abs(stamp_ns - time.time_ns()) < NEAR_NS:  # none that an attack brought about
                    self.latest_ns = stamp_ns
            self._changed.notify_all()

    def goes_on(self) -> bool:
        """Return whether the filter answers more sets, and all processes live."""
        with self._changed:
            goal = self._answers + ALIVE_ANSWERS
            answered = self._changed.wait_for(lambda: self._answers >= goal, ALIVE_TIMEOUT_S)
        return answered and all(map(self.supervisor.processes.alive, self.supervisor.states()))

    def wait_for_tracking(self, timeout_s: float) -> bool:
        return self.supervisor.diagnostics.wait_until(lambda: self.state().startswith("tracking"), timeout_s)

    def state(self) -> str:
        report = self.supervisor.diagnostics.report("/ekf_tracker")
        return report.message if report is not None else "?"

    def tells(self, counters: Set[str]) -> bool:
        """Return whether the nodes come to tell of something by each of these counters in their diagnostics."""
        table = self.supervisor.diagnostics

        def told() -> bool:
            reports = filter(None, (table.report(node.full_name) for node in self.supervisor.graph))
            return counters <= {key for report in reports for key, text in report.values.items() if text.strip("0")}

        return table.wait_until(told, ALIVE_TIMEOUT_S)


@contextmanager
def running_graph(folder: Path) -> Iterator[Target]:
    """A graph that tracks the studio's person until the block ends."""
    session = folder / "session"
    if not session.exists():
        body, look = Body.from_stature(1.75), RenderSettings(seed=17)
        write_session(session, ring(2, True), body, fps=FPS, seconds=SECONDS, motion="t_pose_only", settings=look)
    settings = {"icp_tracker.bodies.folder": str(folder / "bodies"), "hull_server.mesh.folder": str(folder / "meshes")}
    graph = build_graph(session=session, loop=True, settings={**settings, "hull_server.thin_out": False})
    with Supervisor(graph, folder / "run", THREE_PROCESSES) as supervisor:
        supervisor.configure()
        supervisor.activate()
        with RosLink("hostile") as link:
            target = Target(supervisor, link)
            if not target.wait_for_tracking(90.0):
                raise SystemExit(f"the graph does not track: {target.state()}")
            yield target


def _types(link: RosLink) -> dict[str, str]:
    return {name: kinds[0] for name, kinds in link.node.get_topic_names_and_types()}


def valid_messages(link: RosLink, topics: Mapping[str, str]) -> dict[str, Any]:
    """Return a message of each topic as it is sent there; an empty one where none was heard."""
    heard: dict[str, bytes] = {}
    subscriptions = []
    for topic, kind in topics.items():
        info = link.node.get_publishers_info_by_topic(topic)
        kept = any(one.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for one in info)
        durability = DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=durability)
        take = lambda data, topic=topic: heard.__setitem__(topic, data)  # noqa: E731
        subscriptions.append(link.node.create_subscription(message_class(kind), topic, take, qos, raw=True))
    end_s = time.monotonic() + LISTEN_S
    while len(heard) < len(topics) and time.monotonic() < end_s:
        time.sleep(0.05)
    for subscription in subscriptions:
        link.node.destroy_subscription(subscription)
    kinds = {topic: message_class(kind) for topic, kind in topics.items()}
    return {t: deserialize_message(heard[t], kind) if t in heard else kind() for t, kind in kinds.items()}


class Attacker:
    """Sends attacks into the graph from a node of its own."""

    def __init__(self, target: Target, seed: int = 1) -> None:
        self._target, self._rng = target, np.random.default_rng(seed)
        known = settled(lambda: set(_types(target.link)), len(OUTPUT_TOPICS), DISCOVERY_TIMEOUT_S)
        ours = (topic for topic in known if topic not in NOT_OURS and "/transition_event" not in topic)
        self.topics = {topic: _types(target.link)[topic] for topic in ours}
        self._valid = valid_messages(target.link, self.topics)

    def send(self, attack: Attack) -> None:
        """Send it on every topic that it applies to; the graph goes on."""
        target, publishers = self._target, self._open()
        for topic, valid in self._valid.items():
            for number in range(REPEAT):
                with suppress(AssertionError, OverflowError, UnicodeEncodeError):  # the type itself refuses a value
                    fresh = with_stamp(valid, target.latest_ns + (number + 1) * SOON_NS)
                    message = attack(valid if fresh is None else fresh, self._rng)
                    if message is None:
                        break
                    publishers[topic].publish(message)
                    time.sleep(PAUSE_S)
        self._survived()
        for publisher in publishers.values():
            target.link.node.destroy_publisher(publisher)

    def _open(self) -> dict[str, Publisher]:
        """Return a new publisher a topic, known to its subscribers: after bytes that are none the middleware takes
        nothing more from a publisher."""
        node, qos = self._target.link.node, QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        made = {topic: node.create_publisher(type(self._valid[topic]), topic, qos) for topic in self.topics}
        end_s = time.monotonic() + DISCOVERY_TIMEOUT_S
        while time.monotonic() < end_s:
            if all(p.get_subscription_count() >= node.count_subscribers(topic) for topic, p in made.items()):
                break
            time.sleep(0.05)
        return made

    def call(self) -> None:
        """Send hostile requests to every service; the graph goes on."""
        target = self._target
        for name, (kind, *_) in target.link.node.get_service_names_and_types():
            srv = message_class(kind)
            for request in requests(srv):
                if hasattr(request, "transition"):
                    request.transition.id = 255
                with suppress(AssertionError, UnicodeEncodeError, OverflowError):
                    call_all(target.link.node, srv, {name: request}, CALL_TIMEOUT_S)
        self._survived()

    def _survived(self) -> None:
        assert self._target.goes_on(), "a process died, or the filter answers no more"
        self._target.wait_for_tracking(ALIVE_TIMEOUT_S)


TRIES = 3  # on a busy machine a message's stamp may be passed when it comes: it is refused for that
COUNTED = {"bad_images", "bad_predictions", "bad_hulls", "bad_keypoints", "bad_rules"}


@pytest.mark.slow
def test_the_graph_tracks_on_under_hostile_messages_and_counts_them(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with running_graph(tmp_path) as target:
        attacker = Attacker(target)
        for _ in range(TRIES):
            for attack in attacks(time.time_ns):
                attacker.send(attack)
            if told := target.tells(COUNTED):
                break
        assert told
        attacker.call()
    written = [*tmp_path.parent.rglob("sagoma_was_here*"), *Path("/tmp").glob("sagoma_was_here*")]
    assert written == [] and not (Path.home() / "sagoma_was_here").exists()
