"""Smooths the first person of a recorded take into a new bag with the same topics."""

from __future__ import annotations

from bisect import bisect_right
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from capture_rig.errors import InputError
from capture_rig.files import copy_file
from ekf_tracker.settings import EkfSettings
from ekf_tracker.smoother import Set, check_stamps, smooth
from ekf_tracker.state import POSE
from ekf_tracker.state_ros import rotations_message, torso_message
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.state import BodyState
from sagoma_ros.packets import covariance_cloud, joint_state_message, packet_cloud, read_people_points
from stick_figure.body import Body
from stick_figure.body_file import parse_body
from stick_figure.skeleton import ANGLE_NAMES, TANGENT_NAMES

from ..graph.topics import OUTPUT_TOPICS
from .reader import SIDECAR_RIG, bag_topics, read_messages, read_provenance
from .writer import OFFERED, OFFERED_LATCHED, BagWriter, require_new

FITTED, BODY = "/icp/reference_points", "/icp/body"
SMOOTHED = (
    "/mocap/joint_states",
    "/mocap/torso",
    "/mocap/joint_covariance",
    "/mocap/joint_rotations",
    "/mocap/reference_points",
)
LATCHED = {topic.name for topic in OUTPUT_TOPICS if topic.latched}


class SmoothedTake(NamedTuple):
    """What was smoothed: frame sets with a state, and all of them; messages of the new bag by topic."""

    states: int
    sets: int
    counts: dict[str, int]


def smooth_bag(bag: str | Path, target: str | Path, settings: EkfSettings | None = None) -> SmoothedTake:
    """Write ``target``: the bag with the first person's motion smoothed. InputError for a bag without fits."""
    require_new(target)
    sets = read_sets(bag)
    if not sets:
        remedy = "Record /icp/reference_points and /icp/body: `sagoma record` does."
        raise InputError(f"holds no {FITTED}, from which a take is smoothed", where=str(bag), remedy=remedy)
    check_stamps([one.stamp_ns for one, _ in sets], str(bag))
    frame_of = {one.stamp_ns: frame_id for one, frame_id in sets}
    states = {s.stamp_ns: s for s in smooth((one for one, _ in sets), settings) if isinstance(s, BodyState)}
    kinds = bag_topics(bag)
    with BagWriter(target) as writer:
        for topic, kind in {**kinds, **{name: _kind(name) for name in SMOOTHED}}.items():
            writer.add_topic(topic, kind, OFFERED_LATCHED if topic in LATCHED else OFFERED)
        for message in read_messages(bag):
            if message.topic not in SMOOTHED:
                writer.write(message.topic, message.log_ns, message.data)
            if message.topic == FITTED and message.stamp_ns in states:
                _write(writer, message.log_ns, states[message.stamp_ns], frame_of[message.stamp_ns])
        rig = Path(bag) / SIDECAR_RIG
        provenance = {key: value for key, value in read_provenance(bag).items() if key != "software"}
        writer.describe({**provenance, "smoothed_from": str(bag)})
        if rig.is_file():
            copy_file(rig, writer.folder / SIDECAR_RIG)
    return SmoothedTake(len(states), len(sets), writer.counts)


def read_sets(bag: str | Path) -> list[tuple[Set, str]]:
    """Return the first person's fits in bag order, each with the body that was followed then, and its frame's name.

    A body is published with the set that it was measured or refined with, before or just after its points; the first
    one serves the sets before it as well.
    """
    bodies, fits = list[tuple[int, Body]](), list[tuple[int, PointCloud2]]()
    for message in read_messages(bag, {FITTED, BODY}.__contains__):
        if message.topic == BODY:
            text = message.decode(String).data
            bodies.append((message.log_ns, parse_body(text, f"{bag}: {BODY}")))
        else:
            fits.append((message.log_ns, message.decode(PointCloud2)))
    logged, sets = [log_ns for log_ns, _ in bodies], list[tuple[Set, str]]()
    for log_ns, cloud in fits:
        points = read_people_points(cloud, f"{bag}: {FITTED}").of[FIRST_PERSON]
        body = bodies[max(bisect_right(logged, log_ns) - 1, 0)][1] if bodies else None
        stamp_ns = cloud.header.stamp.sec * 1_000_000_000 + cloud.header.stamp.nanosec
        sets.append((Set(stamp_ns, points, body), cloud.header.frame_id))
    return sets


def _write(writer: BagWriter, log_ns: int, state: BodyState, frame_id: str) -> None:
    messages: tuple[Any, ...] = (
        joint_state_message(ANGLE_NAMES, state.angles, state.rates, state.stamp_ns, frame_id),
        torso_message(state, frame_id),
        covariance_cloud(TANGENT_NAMES, state.covariance[POSE, POSE], state.stamp_ns, frame_id),
        rotations_message(state, frame_id),
        packet_cloud(state.reference_points, state.stamp_ns, frame_id),
    )
    for topic, message in zip(SMOOTHED, messages, strict=True):
        writer.write(topic, log_ns, serialize_message(message))


def _kind(name: str) -> str:
    return next(topic.msgtype for topic in OUTPUT_TOPICS if topic.name == name)
