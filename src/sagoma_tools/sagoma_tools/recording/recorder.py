"""Records topics of the graph into a bag: subscribes reliably and writes the serialized bytes as they arrive.

:class:`Recorder` records any topics, :class:`GraphRecorder` those of a graph that this process started.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Self

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from capture_rig.errors import InputError
from sagoma_bringup.graph import NodeSpec, Role

from ..graph import ANSWER_S, PATIENCE_S
from ..graph.ros_link import RosLink, call_all, in_graph, our_nodes, settled, topics_of
from ..graph.topics import (
    DIAGNOSTICS,
    FIRST_BODY_ID,
    OUTPUT_TOPICS,
    Topic,
    camera_topics,
    cameras_in,
    first_body_id,
    message_class,
    person_topics,
    persons_in,
    topics_of_others,
)
from .reader import canonical_bytes, header_stamp_ns
from .writer import OFFERED, OFFERED_LATCHED, BagWriter

STAMPED_BYTES = 12  # lead-in and stamp of a message that begins with a header
NEWCOMERS_S = 0.3  # period of the search for new cameras and persons


class Recorder:
    """Records topics into one bag from construction to :meth:`close`; ``node`` must be spun by another thread.

    Topics are those of the node's namespace; the bag names them as they are without one.

    canonical : write undefined bytes between fields as zero, so that equal messages are equal bytes in the bag; costs
    some 0.05 ms a message (2 ms for markers), so it is for lockstep, not for live recordings.
    """

    def __init__(
        self,
        node: Node,
        folder: str | Path,
        topics: Iterable[Topic],
        *,
        canonical: bool = False,
        on_failure: Callable[[InputError], object] = lambda error: None,
    ) -> None:
        """``on_failure`` is called once, when the disk is full or fails: by then nothing more is recorded."""
        self._node, self._canonical = node, canonical
        self._writer, self.folder = BagWriter(folder), Path(folder)
        self._arrived = threading.Condition()
        self._last_stamp_ns: dict[str, int] = {}
        self._open = True
        self.failure: InputError | None = None
        self._on_failure = on_failure
        self._subscriptions: dict[str, Any] = {}
        self._discovery: Any = None
        for topic in topics:
            self.add(topic)

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far, by topic."""
        with self._arrived:
            return dict(self._writer.counts)

    def add(self, topic: Topic) -> None:
        """Record this topic too, from now on; the bag has that of a person only once there is something on it."""
        with self._arrived:
            if topic.name in self._subscriptions:
                return
            if not topic.of_person:
                self._announce(topic)
        self._subscriptions[topic.name] = self._node.create_subscription(
            message_class(topic.msgtype),
            in_graph(self._node, topic.name),
            partial(self._on_message, topic, has_header(topic.msgtype)),
            topic.qos,
            raw=True,
        )

    def add_new_sources(self) -> None:
        """Add the topics of new cameras and persons, every NEWCOMERS_S."""

        def add_all() -> None:
            names = topics_of(self._node)
            others = {*persons_in(names)} - {FIRST_BODY_ID}  # whose topics are below /mocap itself
            for topics in (*map(camera_topics, cameras_in(names)), *map(person_topics, sorted(others))):
                for topic in topics:
                    self.add(topic)

        add_all()
        self._discovery = self._node.create_timer(NEWCOMERS_S, add_all, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def wait_for_stamp(self, topic: str, stamp_ns: int, timeout_s: float) -> bool:
        """True as soon as a message of this (stamped) topic with this or a later stamp is written."""
        with self._arrived:
            return self._arrived.wait_for(lambda: self._last_stamp_ns.get(topic, -1) >= stamp_ns, timeout_s)

    def wait_until_quiet(self, quiet_s: float, timeout_s: float) -> bool:
        """True once nothing has arrived for ``quiet_s``: messages under way have been written."""
        deadline_s = time.monotonic() + timeout_s
        with self._arrived:
            while time.monotonic() < deadline_s:
                if not self._arrived.wait(quiet_s):
                    return True
        return False

    def wait_for_count(self, topic: str, count: int, timeout_s: float) -> bool:
        """True as soon as ``count`` messages of ``topic`` are written."""
        with self._arrived:
            return self._arrived.wait_for(lambda: self._writer.counts.get(topic, 0) >= count, timeout_s)

    def close_with_graph(self, rig: Path | None = None) -> dict[str, int]:
        """Close the bag with the parameters of the graph's nodes and their rig file, unless ``rig`` is another."""
        configuration = read_configuration(self._node, sorted(our_nodes(self._node)), ANSWER_S)
        return self.close({"graph": configuration}, rig or rig_of(configuration))

    def close(self, provenance: Mapping[str, Any] | None = None, rig: Path | None = None) -> dict[str, int]:
        """Stop listening and finish the bag; returns the messages written by topic. May be called twice."""
        with self._arrived:
            was_open, self._open = self._open, False
        if was_open:
            if self._discovery is not None:
                self._node.destroy_timer(self._discovery)
            for subscription in self._subscriptions.values():
                self._node.destroy_subscription(subscription)
            try:
                self._writer.describe(provenance or {}, rig)
            finally:
                self._writer.close()
                self.failure = self.failure or self._writer.failure
        return dict(self._writer.counts)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _on_message(self, topic: Topic, stamped: bool, data: bytes) -> None:
        now_ns = self._node.get_clock().now().nanoseconds
        with self._arrived:
            if not self._open or self.failure is not None:
                return
            self._announce(topic)
            written = canonical_bytes(data, topic.msgtype) if self._canonical else data
            try:
                self._writer.write(topic.name, now_ns, written)
            except InputError as error:
                self.failure = error
            if stamped and len(data) >= STAMPED_BYTES:
                self._last_stamp_ns[topic.name] = header_stamp_ns(data)
            self._arrived.notify_all()
        if self.failure is not None:
            self._on_failure(self.failure)

    def _announce(self, topic: Topic) -> None:
        self._writer.add_topic(topic.name, topic.msgtype, OFFERED_LATCHED if topic.latched else OFFERED)


def has_header(msgtype: str) -> bool:
    """Whether a message of this type starts with a std_msgs/Header."""
    fields = message_class(msgtype).get_fields_and_field_types()
    return next(iter(fields.values())) == "std_msgs/Header"


class GraphRecorder(Recorder):
    """Records every topic of ``graph`` into ``bag``, from a node of its own, until it is closed."""

    def __init__(
        self,
        graph: Sequence[NodeSpec],
        bag: str | Path,
        *,
        topics: Iterable[Topic] | None = None,
        provenance: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        """``topics`` by default all of the graph and /diagnostics; ``provenance`` is added to the bag's sagoma.yaml;
        ``options`` as of :class:`Recorder`."""
        cameras = [node.label for node in graph if node.role is Role.CAMERA]
        everything = [*(one for camera in cameras for one in camera_topics(camera)), *server_topics(graph), DIAGNOSTICS]
        self._recorded = tuple(everything if topics is None else topics)
        self._configuration = {node.full_name: dict(node.parameters) for node in graph}
        self._provenance = dict(provenance or {})
        self._link = RosLink("sagoma_recorder")
        try:
            super().__init__(self._link.node, bag, self._recorded, **options)
        except BaseException:
            self._link.close()
            raise

    def wait_for_graph(self) -> None:
        """Return once every topic but latched ones and persons' has a publisher, at the latest after PATIENCE_S.

        Nodes open their publishers when they are configured: call it between configure and activate. A publisher that
        is opened later finds this recorder listening, and its first message is recorded.
        """
        names = {topic.name for topic in self._recorded if not (topic.latched or topic.of_person)}
        settled(lambda: set(filter(self._link.node.count_publishers, names)), len(names), PATIENCE_S)

    def close(self, provenance: Mapping[str, Any] | None = None, rig: Path | None = None) -> dict[str, int]:
        """Finish the bag, with the nodes' parameters and rig; returns the messages by topic. May be called twice."""
        described = {"graph": self._configuration, **self._provenance, **(provenance or {})}
        counts = super().close(described, rig or rig_of(self._configuration))
        self._link.close()
        return counts


def server_topics(graph: Sequence[NodeSpec]) -> list[Topic]:
    """Return the topics that the server publishes, and may publish once there are several persons."""
    return [*OUTPUT_TOPICS, *topics_of_others(first_body_id(node.parameters for node in graph))]


def rig_of(configuration: Mapping[str, Mapping[str, Any]]) -> Path | None:
    """Return the rig file that nodes have by their parameters, if it is on this computer."""
    named = (parameters.get("rig_file") for parameters in configuration.values())
    return next((Path(name) for name in named if name and Path(name).is_file()), None)


def read_configuration(node: Node, names: Sequence[str], timeout_s: float) -> dict[str, dict[str, Any]]:
    """Read the parameters of running nodes: full name -> parameters, without nodes that do not answer.

    ``node`` must be spun by another thread.
    """
    questions = {name: ListParameters.Request() for name in names}
    listed = call_all(node, ListParameters, questions, timeout_s, suffix="/list_parameters", repeatable=True)
    keys = {name: list(reply.result.names) for name, reply in listed.items() if reply is not None}
    requests = {name: GetParameters.Request(names=own) for name, own in keys.items()}
    replies = call_all(node, GetParameters, requests, timeout_s, suffix="/get_parameters", repeatable=True)
    return {
        name: {key: _plain(value) for key, value in zip(keys[name], reply.values, strict=True)}
        for name, reply in replies.items()
        if reply is not None
    }


def _plain(value: Any) -> Any:
    found = parameter_value_to_python(value)
    return found if found is None or isinstance(found, bool | int | float | str) else list(found)
