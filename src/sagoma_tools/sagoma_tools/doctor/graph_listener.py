"""Listens to the running graph for a few seconds, and asks its nodes for their state."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, cast

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import GetState
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CompressedImage

from capture_rig.mask_levels import SHADOW_CANDIDATE
from sagoma_bringup.graph import CAMERA_NODE, SERVER_NODES
from sagoma_ros import mask_png
from sagoma_ros.messages import to_ns, values_of
from sagoma_ros.qos import RESULT, SILHOUETTE_SUBSCRIBER

from ..graph import ANSWER_S
from ..graph.diagnostics_table import DiagnosticsTable, NodeReport
from ..graph.ros_link import RosLink, call_all, is_in_graph, node_names, owners_of, settled, topics_of
from ..graph.topics import SILHOUETTE_SUFFIX, cameras_in

OWN_NAME, HULL = "sagoma_doctor", "/hull_server"
FRAME_SET_TOPIC = "/hull/frame_set"
GET_STATE = "/get_state"
KEPT = 4096  # messages of a topic: the last minute at 60 Hz
DECODED = 60  # masks of a camera
ACTIVE = "active"
PERSON_SHARE, FLOODED = 0.003, 0.5  # of the canvas: a person fills ten times as much as the lower one


@dataclass(frozen=True)
class NodeFacts:
    """One node of the graph.

    state : its lifecycle state, None when it did not answer. copies : how many nodes have this name.
    """

    name: str
    state: str | None = None
    copies: int = 1
    report: NodeReport | None = None

    @property
    def camera(self) -> str:
        """The camera of a client node; "" for another node."""
        space, _, name = self.name.rpartition("/")
        return space.strip("/") if name == CAMERA_NODE else ""

    @property
    def message(self) -> str:
        """Its last message; "" where it does not report."""
        return "" if self.report is None else self.report.message

    def value(self, key: str) -> str:
        """Return a value of its diagnostics; "" where there is none."""
        return "" if self.report is None else self.report.values.get(key, "")


@dataclass(frozen=True)
class SilhouetteFacts:
    """One camera's messages while the doctor listened.

    masks : silhouettes received; lost : missing between the first and the last.
    share : of foreground, the median of those decoded; age_s : from capture to arrival here, the median.
    """

    camera: str
    masks: int = 0
    lost: int = 0
    share: float = 0.0
    age_s: float = 0.0


@dataclass(frozen=True)
class GraphFacts:
    """The running graph as seen from here.

    sets : diagnostics of the hull server's frame sets. expected : the cameras of the rig file, where one is given.
    """

    domain: int
    nodes: tuple[NodeFacts, ...] = ()
    cameras: tuple[SilhouetteFacts, ...] = ()
    sets: tuple[Mapping[str, str], ...] = ()
    sets_hz: float = 0.0
    simulated_time: bool = False
    expected: tuple[str, ...] = ()

    def node(self, name: str) -> NodeFacts | None:
        """Return the node with this fully qualified name."""
        return next((node for node in self.nodes if node.name == name), None)

    def client(self, camera: str) -> NodeFacts | None:
        """Return the client node of a camera."""
        return self.node(f"/{camera}/{CAMERA_NODE}")

    @property
    def seeing(self) -> list[str]:
        """The cameras most of whose masks have a person's share of foreground."""
        return [facts.camera for facts in self.cameras if PERSON_SHARE <= facts.share < FLOODED]

    @property
    def room_empty(self) -> bool:
        """Whether all masks are as good as empty."""
        return all(facts.share < PERSON_SHARE for facts in self.cameras if facts.masks)


Heard = deque[tuple[Any, Mapping[str, int]]]
"""Messages of a topic and their times; one thread appends, another copies."""


def collect_graph(
    seconds: float, expected: Sequence[str] = (), domain_id: int | None = None, namespace: str = ""
) -> GraphFacts:
    """Listen for ``seconds`` to the graph of a namespace; also to ``expected`` cameras for which no publisher is found.

    Nodes are named as in a graph without a namespace.
    """
    with RosLink(OWN_NAME, namespace=namespace, domain_id=domain_id) as link:
        node = link.node
        reports, sets = DiagnosticsTable(node), _listen(node, DiagnosticArray, f"{namespace}{FRAME_SET_TOPIC}", RESULT)
        count = len(expected) + len(SERVER_NODES) if expected else 1  # a whole graph, or any node
        lifecycle = settled(lambda: owners_of(node, "get_state", "lifecycle_msgs/srv/GetState"), count, ANSWER_S)
        cameras = sorted({*expected, *cameras_in(topics_of(node))})
        sent = [f"{namespace}/{name}{SILHOUETTE_SUFFIX}" for name in cameras]
        masks = [_listen(node, CompressedImage, topic, SILHOUETTE_SUBSCRIBER) for topic in sent]
        ends_s = time.monotonic() + seconds
        requests = {name + GET_STATE: GetState.Request() for name in lifecycle}
        states = call_all(node, GetState, requests, ANSWER_S, repeatable=True)
        threading.Event().wait(max(ends_s - time.monotonic(), 0.0))
        copies = Counter(node_names(node))
        names = sorted({*lifecycle, *(name for name in reports.names() if is_in_graph(node, name))})
        heard = sets.copy()
        span_s = 1e-9 * (heard[-1][1]["received_timestamp"] - heard[0][1]["received_timestamp"]) if heard else 0.0
        labels = {service: reply and reply.current_state.label for service, reply in states.items()}
        nodes = tuple(
            NodeFacts(name.removeprefix(namespace), labels.get(name + GET_STATE), copies[name], reports.report(name))
            for name in names
        )
        silhouettes = tuple(
            silhouette_facts(name, node.count_publishers(topic), mask.copy())
            for name, topic, mask in zip(cameras, sent, masks, strict=True)
        )
        results = tuple(values_of(each.status[0]) if each.status else {} for each, _ in heard)
        rate_hz, domain = (len(heard) - 1) / span_s if span_s > 0 else 0.0, node.context.get_domain_id()
        clock = node.count_publishers("/clock") > 0
        return GraphFacts(domain, nodes, silhouettes, results, rate_hz, clock, tuple(expected))


def _listen(node: Node, kind: type, topic: str, qos: QoSProfile) -> Heard:
    """Subscribe, and return the queue into which messages and their times are put."""
    heard: Heard = deque(maxlen=KEPT)

    def on_message(message: Any, info: Any) -> None:
        heard.append((message, info))

    # rclpy's annotation has a callback that gets the message alone
    node.create_subscription(kind, topic, cast(Callable[[Any], None], on_message), qos)
    return heard


def silhouette_facts(camera: str, publishers: int, masks: Heard) -> SilhouetteFacts:
    """Return the facts about a camera's messages; without losses where several publish them."""
    if not masks:
        return SilhouetteFacts(camera)
    data = [bytes(message.data) for message, _ in masks]
    numbers = [number for _, each in masks if (number := each.get("publication_sequence_number")) is not None]
    decoded = [mask_png.decode(each) for each in data[:: -(-len(data) // DECODED)]]
    return SilhouetteFacts(
        camera,
        len(data),
        lost=numbers[-1] - numbers[0] + 1 - len(numbers) if publishers == 1 and numbers else 0,
        share=median([float((mask > SHADOW_CANDIDATE).mean()) for mask in decoded if mask is not None] or [0.0]),
        age_s=1e-9 * median(each["received_timestamp"] - to_ns(message.header.stamp) for message, each in masks),
    )
