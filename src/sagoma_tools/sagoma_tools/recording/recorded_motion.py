"""The motions of the persons in a bag: topics /mocap/... and, of several persons, /mocap/bodies/ID/...."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, PointCloud2

from capture_rig.errors import InputError
from motion_export.motion import Motion, Samples
from sagoma_ros.packets import read_reference_points
from stick_figure.skeleton import ANGLE_NAMES

from ..graph.topics import FIRST_BODY_ID
from .reader import BagMessage, read_messages

ROW_TOPIC = re.compile(r"^/mocap/(?:bodies/(?P<body_id>[^/]+)/)?(?P<kind>reference_points|joint_states|torso|state)$")
TRUSTED = "tracking"
"""The state of every row in a bag that recorded none."""
LOST = "lost"
"""Rows in this state are extrapolated: a gap."""


def recorded_motions(bag: str | Path, rate_hz: float | None = None) -> dict[str, Motion]:
    """Read the motion of every person of a bag, by the body's id; frames in which one is lost are gaps.

    Raises InputError for a bag that cannot be read or holds no tracked person.
    """
    rows: dict[str, dict[str, dict[int, Any]]] = defaultdict(lambda: defaultdict(dict))
    for message in read_messages(bag, lambda topic: ROW_TOPIC.match(topic) is not None):
        match = ROW_TOPIC.match(message.topic)
        assert match is not None
        kind, body_id = match["kind"], match["body_id"] or FIRST_BODY_ID
        try:
            if kind == "state":
                status = message.decode(DiagnosticStatus)
                stamps = [int(value.value) for value in status.values if value.key == "stamp_ns"]
                rows[body_id][kind].update(dict.fromkeys(stamps, status.message))
            else:
                rows[body_id][kind][message.stamp_ns] = _READERS[kind](message)
        except InputError:
            raise
        except ValueError as error:  # a number that is none, a rotation of zeros
            raise message.damaged(f"holds what cannot be: {error}") from None
    found = {body_id: _samples(kinds) for body_id, kinds in sorted(rows.items())}
    found = {body_id: samples for body_id, samples in found.items() if len(samples.stamps_ns) > 1}
    name = Path(bag).resolve().name
    if not found:
        remedy = "Record /mocap/reference_points, /mocap/joint_states and /mocap/torso while the graph tracks a person."
        raise InputError("holds no tracked person", where=str(bag), remedy=remedy)
    return {
        body_id: Motion.of_samples(samples, name if len(found) == 1 else f"{name}_{body_id}", rate_hz)
        for body_id, samples in found.items()
    }


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


def _points(row: BagMessage) -> tuple[np.ndarray, np.ndarray]:
    measured = read_reference_points(row.decode(PointCloud2), f"{row.bag}: {row.topic}")
    return measured.points_world, measured.covariance


def _angles(row: BagMessage) -> np.ndarray:
    message = row.decode(JointState)
    if list(message.name) != list(ANGLE_NAMES) or len(message.position) != len(ANGLE_NAMES):
        what, remedy = f"joint names {list(message.name)} are not the stick figure's", "Give a bag of this graph."
        raise InputError(what, where=f"{row.bag}: {row.topic}", remedy=remedy)
    return np.array(message.position)


def _torso(row: BagMessage) -> tuple[np.ndarray, np.ndarray]:
    pose = row.decode(PoseWithCovarianceStamped).pose.pose
    p, q = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z]), Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()


_READERS = {"reference_points": _points, "joint_states": _angles, "torso": _torso}
