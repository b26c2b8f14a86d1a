"""The motions of the persons in a bag: topics /mocap/... and, of several persons, /mocap/bodies/ID/...."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.serialization import deserialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, PointCloud2

from capture_rig.errors import InputError
from motion_export.motion import Motion, Samples
from sagoma_ros.packets import read_reference_points
from stick_figure.skeleton import ANGLE_NAMES

from .reader import bag_topics, read_messages

PERSON_TOPIC = re.compile(r"^/mocap/(?:bodies/(?P<person>\d+)/)?(?P<kind>reference_points|joint_states|torso|state)$")
FIRST_PERSON = 1
TRUSTED = "tracking"
"""The state of every row in a bag that recorded none."""
LOST = "lost"
"""Rows in this state are extrapolated: a gap."""


def recorded_motions(bag: str | Path, rate_hz: float | None = None) -> dict[int, Motion]:
    """Read the motion of every person of a bag, by the person's number; frames in which one is lost are gaps.

    Raises InputError for a bag that cannot be read or holds no tracked person.
    """
    first_again = any(topic.startswith(f"/mocap/bodies/{FIRST_PERSON}/") for topic in bag_topics(bag))
    rows: dict[int, dict[str, dict[int, Any]]] = defaultdict(lambda: defaultdict(dict))
    for message in read_messages(bag, lambda topic: PERSON_TOPIC.match(topic) is not None):
        match = PERSON_TOPIC.match(message.topic)
        assert match is not None
        if first_again and match["person"] is None:
            continue
        kind, person = match["kind"], int(match["person"] or FIRST_PERSON)
        if kind == "state":
            status = deserialize_message(message.data, DiagnosticStatus)
            stamps = [int(value.value) for value in status.values if value.key == "stamp_ns"]
            rows[person][kind].update(dict.fromkeys(stamps, status.message))
        else:
            rows[person][kind][message.stamp_ns] = _READERS[kind](message.data, f"{bag}: {message.topic}")
    name = Path(bag).resolve().name
    found = {person: _samples(kinds) for person, kinds in sorted(rows.items())}
    motions = {
        person: Motion.of_samples(samples, name if len(found) == 1 else f"{name}_{person}", rate_hz)
        for person, samples in found.items()
        if len(samples.stamps_ns) > 1
    }
    if not motions:
        remedy = "Record /mocap/reference_points, /mocap/joint_states and /mocap/torso while the graph tracks a person."
        raise InputError("holds no tracked person", where=str(bag), remedy=remedy)
    return motions


def _samples(kinds: dict[str, dict[int, Any]]) -> Samples:
    """The rows of one person that have points, angles and torso, and are not lost."""
    points, angles, torso, states = (kinds[kind] for kind in ("reference_points", "joint_states", "torso", "state"))
    stamps = [stamp for stamp in sorted(points) if stamp in angles and stamp in torso and states.get(stamp) != LOST]

    def column(values: list[Any], *shape: int) -> np.ndarray:
        return np.array(values, dtype=float).reshape(-1, *shape)

    return Samples(
        np.array(stamps, np.int64),
        column([points[stamp][0] for stamp in stamps], 15, 3),
        column([points[stamp][1] for stamp in stamps], 15, 3, 3),
        column([angles[stamp] for stamp in stamps], 18),
        column([torso[stamp][0] for stamp in stamps], 3),
        column([torso[stamp][1] for stamp in stamps], 3, 3),
        np.array([states.get(stamp, TRUSTED) for stamp in stamps], dtype=str),
    )


def _points(data: bytes, where: str) -> tuple[np.ndarray, np.ndarray]:
    measured = read_reference_points(deserialize_message(data, PointCloud2), where)
    return measured.points_world, measured.covariance


def _angles(data: bytes, where: str) -> np.ndarray:
    message = deserialize_message(data, JointState)
    if list(message.name) != list(ANGLE_NAMES):
        remedy = "Give a bag that this graph recorded."
        raise InputError(f"joint names {list(message.name)} are not the stick figure's", where=where, remedy=remedy)
    return np.array(message.position)


def _torso(data: bytes, where: str) -> tuple[np.ndarray, np.ndarray]:
    pose = deserialize_message(data, PoseWithCovarianceStamped).pose.pose
    p, q = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z]), Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()


_READERS = {"reference_points": _points, "joint_states": _angles, "torso": _torso}
