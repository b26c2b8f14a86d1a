"""Smooths everybody's motion in a recorded take into a new bag with the same topics."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from capture_rig.errors import InputError
from ekf_tracker.motion_model import POSE
from ekf_tracker.people_ros import rotations_message, torso_message
from ekf_tracker.settings import EkfSettings
from ekf_tracker.smoother import Set, smooth
from mocap_packets.fit import FIRST_PERSON, ReferencePoints
from mocap_packets.people import parse_bodies
from mocap_packets.state import BodyState
from sagoma_ros.packets import covariance_cloud, joint_state_message, packet_cloud, read_people_points
from stick_figure.body import Body, parse_body
from stick_figure.skeleton import ANGLE_NAMES, TANGENT_NAMES

from ..graph.topics import LATCHED_TOPICS, OF_A_PERSON
from .reader import bag_persons, bag_topics, read_messages, read_provenance, rig_in
from .writer import OFFERED, OFFERED_LATCHED, BagWriter, require_new

FITTED, BODY, BODIES = "/icp/reference_points", "/icp/body", "/icp/bodies"
SMOOTHED = ("joint_states", "torso", "joint_covariance", "joint_rotations", "reference_points")
"""What is smoothed of each person."""


def smooth_bag(bag: str | Path, target: str | Path, settings: EkfSettings | None = None) -> tuple[dict[int, int], int]:
    """Write ``target``: the bag with everybody's motion smoothed. Returns frame sets with a state of each person, by
    number, and all sets. InputError for a bag without fits."""
    require_new(target)
    runs_of, frames = read_fits(bag)
    if not frames:
        remedy = "Record /icp/reference_points and /icp/body: `sagoma record` does."
        raise InputError(f"holds no {FITTED}, from which a take is smoothed", where=str(bag), remedy=remedy)
    states = {person: _states(runs, settings) for person, runs in runs_of.items()}
    prefixes: dict[int, list[str]] = {person: [] for person in states} | {FIRST_PERSON: ["/mocap"]}
    for body_id, person in bag_persons(bag).items():
        prefixes.setdefault(person, []).append(f"/mocap/bodies/{body_id}")
    named = {f"{prefix}/{what}": OF_A_PERSON[what] for n in states for prefix in prefixes[n] for what in SMOOTHED}
    with BagWriter(target) as writer:
        for topic, kind in {**bag_topics(bag), **named}.items():
            writer.add_topic(topic, kind, OFFERED_LATCHED if topic in LATCHED_TOPICS else OFFERED)
        for message in read_messages(bag):
            if message.topic not in named:
                writer.write(message.topic, message.log_ns, message.data)
            if message.topic == FITTED:
                for topic, data in _smoothed_at(message.stamp_ns, frames[message.stamp_ns], states, prefixes):
                    writer.write(topic, message.log_ns, data)
        provenance = {key: value for key, value in read_provenance(bag).items() if key != "software"}
        writer.describe({**provenance, "smoothed_from": str(bag)}, rig_in(bag))
    return {person: len(of_person) for person, of_person in states.items()}, len(frames)


def read_fits(bag: str | Path) -> tuple[dict[int, list[list[Set]]], dict[int, str]]:
    """Return everybody's fits in bag order, each with the body tracked then: for each person, by number, the runs of
    consecutive frame sets with the person; and the name of each set's frame, by its stamp.

    A body is published with the set that it was measured or refined with, before or just after its points; the first
    one serves the sets before it as well.
    """
    bodies, clouds = dict[int, list[tuple[int, Body]]](), list[tuple[int, PointCloud2]]()
    for message in read_messages(bag, {FITTED, BODY, BODIES}.__contains__):
        if message.topic == FITTED:
            clouds.append((message.log_ns, message.decode(PointCloud2)))
            continue
        text, where = message.decode(String).data, f"{bag}: {message.topic}"
        others = parse_bodies(text, where) if message.topic == BODIES else {FIRST_PERSON: parse_body(text, where)}
        for person, body in others.items():
            bodies.setdefault(person, []).append((message.log_ns, body))
    runs_of, frames, before = dict[int, list[list[Set]]](), dict[int, str](), dict[int, ReferencePoints]()
    for log_ns, cloud in clouds:
        stamp_ns = cloud.header.stamp.sec * 1_000_000_000 + cloud.header.stamp.nanosec
        people = dict(read_people_points(cloud, f"{bag}: {FITTED}").of)
        frames[stamp_ns] = cloud.header.frame_id
        for person, points in people.items():
            runs = runs_of.setdefault(person, [])
            if person not in before:
                runs.append([])
            runs[-1].append(Set(stamp_ns, points, _body_at(log_ns, bodies.get(person, []))))
        before = people
    return runs_of, frames


def _body_at(log_ns: int, bodies: list[tuple[int, Body]]) -> Body | None:
    """Return the body that was the last one at a time of the bag, else the first; None without any."""
    last = bisect_right([logged_ns for logged_ns, _ in bodies], log_ns) - 1
    return bodies[max(last, 0)][1] if bodies else None


def _states(runs: list[list[Set]], settings: EkfSettings | None) -> dict[int, BodyState]:
    """Return the smoothed states of one person's runs by stamp; each run has a filter of its own, as it had live."""
    answers = [answer for run in runs for answer in smooth(run, settings)]
    return {answer.stamp_ns: answer for answer in answers if isinstance(answer, BodyState)}


def _smoothed_at(
    stamp_ns: int, frame_id: str, states: Mapping[int, Mapping[int, BodyState]], prefixes: Mapping[int, list[str]]
) -> Iterator[tuple[str, bytes]]:
    """Yield topic and message of everybody who has a state at a frame set."""
    for person, of_person in states.items():
        if stamp_ns in of_person:
            smoothed = [serialize_message(one) for one in _messages_of(of_person[stamp_ns], frame_id)]
            for prefix in prefixes[person]:
                yield from zip((f"{prefix}/{what}" for what in SMOOTHED), smoothed, strict=True)


def _messages_of(state: BodyState, frame_id: str) -> tuple[Any, ...]:
    """Return the messages of `SMOOTHED`."""
    return (
        joint_state_message(ANGLE_NAMES, state.angles, state.rates, state.stamp_ns, frame_id),
        torso_message(state, frame_id),
        covariance_cloud(TANGENT_NAMES, state.covariance[POSE, POSE], state.stamp_ns, frame_id),
        rotations_message(state, frame_id),
        packet_cloud(state.reference_points, state.stamp_ns, frame_id),
    )
