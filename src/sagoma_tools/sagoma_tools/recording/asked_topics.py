"""Topics that a user asks the recorder for by name, of whatever nodes: found in the running graph, with their types."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_path
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg

from ..graph.ros_link import in_graph, topics_of
from ..graph.topics import Topic, message_class
from .reader import TYPES


def matches_any(names: Iterable[str]) -> Callable[[str], bool]:
    """Return whether a topic is one of ``names``, or below one: ``/humans`` are all that begin with ``/humans/``."""
    wanted = tuple("/" + name.strip("/") for name in names)
    return lambda topic: any(topic == name or topic.startswith(f"{name}/") for name in wanted)


class AskedTopics:
    """Finds topics in the graph as they appear; ``on_unknown(topic, type)`` is called once for each that cannot be
    recorded, because its type is not installed here."""

    def __init__(self, node: Node, wanted: Callable[[str], bool], on_unknown: Callable[[str, str], None]) -> None:
        self._node, self._wanted, self._on_unknown = node, wanted, on_unknown
        self._seen: set[str] = set()

    def new(self) -> list[Topic]:
        """Return the topics that have appeared since the last call."""
        found = []
        for name, msgtype in topics_of(self._node).items():
            if name in self._seen or not self._wanted(name):
                continue
            offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(in_graph(self._node, name))]
            if not offered:  # nobody publishes it yet, so nobody says how
                continue
            self._seen.add(name)
            if not is_known(msgtype):
                self._on_unknown(name, msgtype)
                continue
            kept = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
            unreliable = any(qos.reliability == ReliabilityPolicy.BEST_EFFORT for qos in offered)
            found.append(Topic(name, msgtype, repeatable=False, latched=kept, best_effort=unreliable))
        return found


def is_known(msgtype: str) -> bool:
    """Return whether messages of a type can be received and written here; learns its definition where installed."""
    try:
        message_class(msgtype)
        if msgtype not in TYPES.fielddefs:
            _learn(msgtype)
    except (ImportError, AttributeError, ValueError, PackageNotFoundError, OSError):
        return False
    return True


def _learn(msgtype: str) -> None:
    """Add a type's definition, and those that it holds, from the package where it is installed."""
    package, folder, name = msgtype.split("/")
    text = (get_package_share_path(package) / folder / f"{name}.msg").read_text()
    types = get_types_from_msg(text, msgtype)
    TYPES.register(types)
    for _, fields in types.values():
        for _, described in fields:
            kind: Any = described
            while kind[0] not in (Nodetype.BASE, Nodetype.NAME):  # of an array, what it is of
                kind = kind[1][0]
            node, inner = kind
            if node is Nodetype.NAME and str(inner) not in TYPES.fielddefs:
                _learn(str(inner))
