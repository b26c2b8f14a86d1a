"""A track: what the graph said of a session, one row a frame set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, PointCloud2

from capture_rig.errors import InputError
from sagoma_ros.clouds import REFERENCE_POINTS, from_cloud, split_reference_points
from stick_figure.skeleton import ANGLE_NAMES

from ..bags import read_messages

POINTS_TOPIC, ANGLES_TOPIC = "/mocap/reference_points", "/mocap/joint_states"


@dataclass(frozen=True, eq=False)
class Track:
    """The filtered body, in frame order.

    frames : (F,) 0-based video frame of each row.
    points_world : (F, 15, 3) metres, map frame; covariance : (F, 15, 3, 3) m^2.
    angles : (F, 18) rad.
    """

    frames: np.ndarray
    points_world: np.ndarray
    covariance: np.ndarray
    angles: np.ndarray

    def between(self, first: int, end: int) -> Track:
        """The rows of frames first, first + 1, ... end - 1."""
        rows = (self.frames >= first) & (self.frames < end)
        return Track(self.frames[rows], self.points_world[rows], self.covariance[rows], self.angles[rows])

    def at(self, frames: np.ndarray) -> Track:
        """The rows of the given frames, NaN where the track has none."""
        row_of = {int(frame): row for row, frame in enumerate(self.frames)}
        rows = np.array([row_of.get(int(frame), -1) for frame in frames])
        absent = rows < 0

        def pick(values: np.ndarray) -> np.ndarray:
            picked = values[rows] if len(values) else np.full((len(rows), *values.shape[1:]), np.nan)
            picked[absent] = np.nan
            return picked

        return Track(np.asarray(frames), pick(self.points_world), pick(self.covariance), pick(self.angles))


def track_from_bag(bag: str | Path, frame_of_stamp: Callable[[int], int]) -> Track:
    """The track that a bag of the graph's topics holds; ``frame_of_stamp`` turns a stamp in ns into a frame number."""
    points: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    angles: dict[int, np.ndarray] = {}
    for message in read_messages(bag, {POINTS_TOPIC, ANGLES_TOPIC}.__contains__):
        frame = frame_of_stamp(message.stamp_ns)
        if message.topic == POINTS_TOPIC:
            cloud = from_cloud(
                deserialize_message(message.data, PointCloud2), REFERENCE_POINTS, f"{bag}: {POINTS_TOPIC}"
            )
            points[frame] = split_reference_points(cloud)[:2]
        else:
            angles[frame] = _angles(deserialize_message(message.data, JointState), f"{bag}: {ANGLES_TOPIC}")
    frames = sorted(set(points) & set(angles))
    if not frames:
        raise InputError("holds no tracked body", where=str(bag),
                         remedy=f"Record {POINTS_TOPIC}, {ANGLES_TOPIC} while the graph tracks somebody.")  # fmt: skip
    return Track(
        np.array(frames),
        np.stack([points[f][0] for f in frames]),
        np.stack([points[f][1] for f in frames]),
        np.stack([angles[f] for f in frames]),
    )


def _angles(message: Any, where: str) -> np.ndarray:
    if list(message.name) != list(ANGLE_NAMES):
        raise InputError(f"joint names {list(message.name)} are not the stick figure's", where=where,
                         remedy="Give a bag that this graph recorded.")  # fmt: skip
    return np.array(message.position)
