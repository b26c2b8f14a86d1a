"""The topics of the graph: inputs, outputs, and which of them replay to the same bytes."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from ekf_tracker.rep155 import body_id_of
from icp_tracker.settings import MOST_PERSONS
from sagoma_ros.qos import LATCHED

SILHOUETTE_SUFFIX = "/silhouette/compressed"
CAMERA_INFO_SUFFIX = "/camera_info"
LATENCY_TOPIC = "/mocap/latency"  # last of the messages of a frame set, one to each set: its answer
DIAGNOSTICS_TOPIC = "/diagnostics"
CLOCK_TOPIC = "/clock"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_TOPIC = re.compile(r"^/(?P<camera>[^/]+)/silhouette/compressed$")
PERSON_TOPIC = re.compile(r"^/mocap/bodies/(?P<body_id>[^/]+)/(?P<what>[a-z_]+)$")
FIRST_BODY_ID = "b0001"  # where the graph sets no other


def _reliable(durability: DurabilityPolicy) -> QoSProfile:
    """Return the QoS of lossless topics: deep enough for a recorder that lags behind for a second."""
    options = {"reliability": ReliabilityPolicy.RELIABLE, "durability": durability}
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000, **options)


LOSSLESS = _reliable(DurabilityPolicy.VOLATILE)


@dataclass(frozen=True)
class Topic:
    """One topic: absolute name, message type, whether a lockstep replay repeats its bytes exactly, whether the last
    message is kept for later subscribers, and whether it comes with a person, who may never come."""

    name: str
    msgtype: str
    repeatable: bool = True
    latched: bool = False
    of_person: bool = False

    @property
    def qos(self) -> QoSProfile:
        """How a recorder subscribes."""
        # deep even where messages are kept: /tf_static has several publishers, each of which keeps its own
        return _reliable(DurabilityPolicy.TRANSIENT_LOCAL if self.latched else DurabilityPolicy.VOLATILE)


OF_A_PERSON = {
    "joint_states": "sensor_msgs/msg/JointState",
    "torso": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "joint_rotations": "sensor_msgs/msg/MultiDOFJointState",
    "joint_covariance": "sensor_msgs/msg/PointCloud2",
    "reference_points": "sensor_msgs/msg/PointCloud2",
    "skeleton": "visualization_msgs/msg/MarkerArray",
    "state": "diagnostic_msgs/msg/DiagnosticStatus",
    "robot_description": "std_msgs/msg/String",
}
"""What is published of each person, with its type: of the first under /mocap, of everybody under /mocap/bodies/ID."""
KEPT = ("robot_description",)
"""Those of which later subscribers get the last message."""
OUTPUT_TOPICS: tuple[Topic, ...] = (
    Topic("/hull/contour_rays", "sensor_msgs/msg/PointCloud2"),
    Topic("/hull/centerline", "sensor_msgs/msg/PointCloud2"),
    Topic("/hull/voxels", "sensor_msgs/msg/PointCloud2"),
    Topic("/hull/frame_set", "diagnostic_msgs/msg/DiagnosticArray", repeatable=False),  # carries measured latencies
    Topic("/hull/thinning", "diagnostic_msgs/msg/DiagnosticArray", repeatable=False, latched=True),  # live only
    Topic("/icp/reference_points", "sensor_msgs/msg/PointCloud2"),
    Topic("/icp/fit", "diagnostic_msgs/msg/DiagnosticArray"),
    Topic("/icp/body", "std_msgs/msg/String", latched=True),
    Topic("/icp/bodies", "std_msgs/msg/String", latched=True),
    *(Topic(f"/mocap/{what}", msgtype, latched=what in KEPT) for what, msgtype in OF_A_PERSON.items()),
    Topic("/mocap/point_names", "std_msgs/msg/String", latched=True),
    Topic(LATENCY_TOPIC, "diagnostic_msgs/msg/DiagnosticArray", repeatable=False),  # carries measured latencies
    Topic("/ekf/prediction", "sensor_msgs/msg/MultiDOFJointState"),
)
LATCHED_TOPICS = {topic.name for topic in OUTPUT_TOPICS if topic.latched}
DIAGNOSTICS = Topic(DIAGNOSTICS_TOPIC, "diagnostic_msgs/msg/DiagnosticArray", repeatable=False)


def offered_qos(name: str) -> QoSProfile:
    """Return how a player offers a topic: kept for later subscribers where its publisher keeps it."""
    return LATCHED if name in LATCHED_TOPICS else LOSSLESS


def camera_topics(camera: str) -> tuple[Topic, ...]:
    """Return the topics from one camera client to the hull server: camera_info, then silhouette."""
    return (
        Topic(f"/{camera}{CAMERA_INFO_SUFFIX}", CAMERA_INFO),
        Topic(f"/{camera}{SILHOUETTE_SUFFIX}", "sensor_msgs/msg/CompressedImage"),
    )


def person_topics(body_id: str) -> tuple[Topic, ...]:
    """Return the topics of one person under /mocap/bodies/ID."""
    return tuple(
        Topic(f"/mocap/bodies/{body_id}/{what}", kind, latched=what in KEPT, of_person=True)
        for what, kind in OF_A_PERSON.items()
    )


def topics_of_others(first_id: str = FIRST_BODY_ID) -> tuple[Topic, ...]:
    """Return the topics of all possible persons but the first one, whose are a copy of /mocap/..."""
    others = [body_id_of(first_id, person) for person in range(2, MOST_PERSONS + 1)]
    return tuple(topic for body_id in others for topic in person_topics(body_id))


def first_body_id(parameters: Iterable[Mapping[str, Any]]) -> str:
    """Return the id of the first person by the nodes' parameters."""
    return next((str(given["body_id"]) for given in parameters if "body_id" in given), FIRST_BODY_ID)


def persons_in(topic_names: Iterable[str]) -> tuple[str, ...]:
    """Return the ids of the bodies that have topics of their own among ``topic_names``, in order."""
    matches = (PERSON_TOPIC.match(name) for name in topic_names)
    return tuple(sorted({match["body_id"] for match in matches if match and match["what"] in OF_A_PERSON}))


def cameras_in(topic_names: Iterable[str]) -> tuple[str, ...]:
    """Return the cameras that publish silhouettes among ``topic_names``, in name order."""
    matches = (CAMERA_TOPIC.match(name) for name in topic_names)
    return tuple(sorted({match["camera"] for match in matches if match}))


def image_topics(types: Mapping[str, str]) -> tuple[str, ...]:
    """Return the topics of images, silhouettes apart, among those of these ``types``, in name order."""
    return tuple(sorted(t for t, kind in types.items() if kind in IMAGE_TYPES and not t.endswith(SILHOUETTE_SUFFIX)))


def type_of(topic: str) -> str | None:
    """Return the message type of a topic of the graph; None for any other topic."""
    camera, person = CAMERA_TOPIC.match(topic), PERSON_TOPIC.match(topic)
    if camera:
        return camera_topics(camera["camera"])[1].msgtype
    if person:
        return OF_A_PERSON.get(person["what"])
    return _TYPES.get(topic)


_TYPES = {topic.name: topic.msgtype for topic in (*OUTPUT_TOPICS, DIAGNOSTICS)}


def message_class(msgtype: str) -> Any:
    """Return the Python class of a message type written ``package/msg/Name``; ImportError when it is not installed."""
    package, kind, name = msgtype.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)
