"""Quality of service of every topic of the graph, and the name that the graph has for it, in one place.

Publishers are reliable (REP-2003), so that recorders miss nothing; the live hull server subscribes best effort, because
a lost silhouette costs one view of one frame set while a repeated one would delay them all, unless heartbeats come as
often as our DDS profile has them (parameter resend, docs/how-to/hosts.md). Queues are bounded; dead readers are free.
"""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

DEPTH = 20  # below this, five cameras at 100 frames a second lose messages on a busy machine


def _profile(
    reliability: ReliabilityPolicy, depth: int = DEPTH, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
) -> QoSProfile:
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability)


SILHOUETTE_PUBLISHER = _profile(ReliabilityPolicy.RELIABLE)
SILHOUETTE_SUBSCRIBER = _profile(ReliabilityPolicy.BEST_EFFORT)
SILHOUETTE_RELIABLE_SUBSCRIBER = _profile(ReliabilityPolicy.RELIABLE)
RESULT = _profile(ReliabilityPolicy.RELIABLE)
LATCHED = _profile(ReliabilityPolicy.RELIABLE, depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATCHED_BY_MANY = _profile(  # every publisher's message: depth 1 would keep the last one's alone
    ReliabilityPolicy.RELIABLE, depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
TF = _profile(ReliabilityPolicy.RELIABLE, depth=100)  # as tf2_ros offers it


def graph_topic(node: Node, topic: str) -> str:
    """Return ``topic`` as the whole graph has it; a camera's node stands in a namespace of its own below the graph's.

    "hull/thinning" for /studio/cam01/camera_client is "/studio/hull/thinning"; an absolute topic stays as it is.
    """
    if topic.startswith("/"):
        return topic
    return f"{node.get_namespace().rpartition('/')[0]}/{topic}"
