"""Each person's motion in a bag, set by set: /mocap/... of the first, /mocap/bodies/ID/... of others."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, PointCloud2

from capture_rig.errors import InputError
from mocap_packets.fit import PART_NAMES, ReferencePoints
from motion_export.motion import Motion
from sagoma_ros.messages import values_of
from sagoma_ros.packets import read_reference_points
from stick_figure.skeleton import ANGLE_NAMES

from ..graph.topics import FIRST_BODY_ID
from .reader import BagMessage, read_messages

POINTS, ANGLES, TORSO, STATE = "reference_points", "joint_states", "torso", "state"
ROW_TOPIC = re.compile(rf"^/mocap/(?:bodies/(?P<body_id>[^/]+)/)?(?P<kind>{POINTS}|{ANGLES}|{TORSO}|{STATE})$")
TRUSTED = "tracking"
"""The state of every row in a bag that recorded none."""
LOST = "lost"
"""Rows in this state are extrapolated: a gap."""
State = tuple[str, tuple[str, ...]]
"""The tracker's state, and that of each part of the body (``PART_NAMES``), empty where unknown."""
NO_STATE: State = TRUSTED, ("",) * len(PART_NAMES)


@dataclass
class PersonRows:
    """One person's messages by the stamp of their frame set, ns; angles (18,) rad; torso: place (3,) m, R (3, 3)."""

    points: dict[int, ReferencePoints] = field(default_factory=dict)
    angles: dict[int, np.ndarray] = field(default_factory=dict)
    torso: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    states: dict[int, State] = field(default_factory=dict)

    def update(self, kind: str, row: BagMessage) -> None:
        """Add a message. Raises InputError for one that is damaged, or of another skeleton."""
        try:
            if kind == STATE:  # without a header: its values hold the stamp
                status = row.decode(DiagnosticStatus)
                said = values_of(status)
                if "stamp_ns" in said:
                    self.states[int(said["stamp_ns"])] = status.message, tuple(said.get(p, "") for p in PART_NAMES)
            elif kind == POINTS:
                where = f"{row.bag}: {row.topic}"
                self.points[row.stamp_ns] = read_reference_points(row.decode(PointCloud2), where)
            elif kind == ANGLES:
                self.angles[row.stamp_ns] = _angles(row)
            else:
                self.torso[row.stamp_ns] = _torso(row)
        except InputError:
            raise
        except ValueError as error:  # an invalid number, a rotation of zeros
            raise row.damaged(f"holds what cannot be: {error}") from None


def read_person_rows(
    bag: str | Path, kinds: Collection[str] = (POINTS, ANGLES, TORSO, STATE)
) -> defaultdict[str, PersonRows]:
    """Return the rows of every person of a bag, by the body's id. Raises InputError."""
    rows: defaultdict[str, PersonRows] = defaultdict(PersonRows)
    for message in read_messages(bag, lambda topic: kind_of(topic) in kinds):
        match = ROW_TOPIC.match(message.topic)
        assert match is not None
        rows[match["body_id"] or FIRST_BODY_ID].update(match["kind"], message)
    return rows


def kind_of(topic: str) -> str | None:
    """Return person and kind of a person's topic, None of any other topic."""
    match = ROW_TOPIC.match(topic)
    return match["kind"] if match else None


def recorded_motions(bag: str | Path, rate_hz: float | None = None) -> dict[str, Motion]:
    """Read the motion of every person of a bag, by the body's id; frames in which one is lost are gaps.

    Raises InputError for a bag that cannot be read or holds no tracked person.
    """
    rows = read_person_rows(bag)
    found = {body_id: _samples(of_person) for body_id, of_person in sorted(rows.items())}
    found = {body_id: samples for body_id, samples in found.items() if len(samples[0]) > 1}
    name = Path(bag).resolve().name
    if not found:
        remedy = "Record /mocap/reference_points, /mocap/joint_states and /mocap/torso while the graph tracks a person."
        raise InputError("holds no tracked person", where=str(bag), remedy=remedy)
    return {
        body_id: Motion.of_samples(name if len(found) == 1 else f"{name}_{body_id}", *samples, rate_hz)
        for body_id, samples in found.items()
    }


def _samples(rows: PersonRows) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Stamps, states and columns of a `Motion` of the rows that have points, angles and torso, and are not lost."""
    states = {stamp: state for stamp, (state, _) in rows.states.items()}
    stamps = [s for s in sorted(rows.points) if s in rows.angles and s in rows.torso and states.get(s) != LOST]

    def column(values: list[Any], *shape: int) -> np.ndarray:
        return np.array(values, dtype=float).reshape(-1, *shape)

    columns = {
        "points_world": column([rows.points[stamp].points_world for stamp in stamps], 15, 3),
        "covariance": column([rows.points[stamp].covariance for stamp in stamps], 15, 3, 3),
        "angles": column([rows.angles[stamp] for stamp in stamps], 18),
        "torso_position_world": column([rows.torso[stamp][0] for stamp in stamps], 3),
        "R_world_torso": column([rows.torso[stamp][1] for stamp in stamps], 3, 3),
    }
    return np.array(stamps, np.int64), np.array([states.get(stamp, TRUSTED) for stamp in stamps], dtype=str), columns


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
