"""A track: the filtered body of a session, one row a frame set; read from a bag or collected in process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState, PointCloud2

from capture_rig.errors import InputError
from mocap_packets.fit import FIRST_PERSON, PART_NAMES
from mocap_packets.state import BodyState
from sagoma_ros.packets import read_reference_points
from stick_figure.skeleton import ANGLE_NAMES

from ..recording.reader import bag_persons, read_messages
from .reasons import nobody_tracked, reasons_of_bag

FIRST_PREFIX = "/mocap"
POINTS, ANGLES, STATE = "reference_points", "joint_states", "state"
POINTS_TOPIC, ANGLES_TOPIC = f"{FIRST_PREFIX}/{POINTS}", f"{FIRST_PREFIX}/{ANGLES}"
NO_STATE = "tracking", ("",) * len(PART_NAMES)
"""The state of every body, and of its parts, in a bag that holds none."""


@dataclass(frozen=True, eq=False)
class Track:
    """The filtered body, in frame order.

    frames : (F,) 0-based video frame of each row.
    points_world : (F, 15, 3) metres, map frame; covariance : (F, 15, 3, 3) m^2.
    angles : (F, 18) rad.
    states : (F,) the tracker's state: "acquiring", "tracking", ...; empty where a frame has no row.
    parts : (F, 5) how far to trust each part of the body (``PART_NAMES``): "good", "doubtful", "lost"; empty where that
    is not known.
    """

    frames: np.ndarray
    points_world: np.ndarray
    covariance: np.ndarray
    angles: np.ndarray
    states: np.ndarray
    parts: np.ndarray

    @classmethod
    def of_states(cls, rows: Sequence[tuple[int, BodyState]]) -> Track:
        """Build from frames and the filter's states at them; no rows make an empty track."""
        frames, states = [frame for frame, _ in rows], [state for _, state in rows]

        def column(values: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
            return np.array(values, dtype=float).reshape(-1, *shape)

        return cls(
            np.array(frames, dtype=int),
            column([state.points_world for state in states], (15, 3)),
            column([state.point_covariance for state in states], (15, 3, 3)),
            column([state.angles for state in states], (18,)),
            np.array([str(state.tracking) for state in states], dtype=str),
            np.array([state.parts for state in states], dtype=str).reshape(-1, len(PART_NAMES)),
        )

    def __len__(self) -> int:
        return len(self.frames)

    def between(self, first: int, end: int) -> Track:
        """Return the rows of frames first, first + 1, ... end - 1."""
        return self.chosen((self.frames >= first) & (self.frames < end))

    def chosen(self, rows: np.ndarray) -> Track:
        """Return some of the rows, by mask or index."""
        return Track(*(column[rows] for column in self._columns))

    def at(self, frames: np.ndarray) -> Track:
        """Return the rows of the given frames, NaN (and no state) where the track has none."""
        row_of = {int(frame): row for row, frame in enumerate(self.frames)}
        rows = np.array([row_of.get(int(frame), -1) for frame in frames], dtype=int)

        def pick(values: np.ndarray) -> np.ndarray:
            absent = "" if values.dtype.kind == "U" else np.nan
            picked = values[rows] if len(values) else np.empty((len(rows), *values.shape[1:]), values.dtype)
            picked[rows < 0] = absent
            return picked

        return Track(np.asarray(frames), *(pick(column) for column in self._columns[1:]))

    @property
    def _columns(self) -> tuple[np.ndarray, ...]:
        return self.frames, self.points_world, self.covariance, self.angles, self.states, self.parts


def track_from_bag(bag: str | Path, frame_of_stamp: Callable[[int], int]) -> Track:
    """Read the first person's track from a bag; ``frame_of_stamp`` converts a stamp in ns into a frame number.

    Raises InputError when the bag holds none.
    """
    track = _read_track(bag, frame_of_stamp, FIRST_PREFIX)
    if not len(track):
        what, reasons = "holds no tracked body", reasons_of_bag(bag)
        if any(reasons):
            raise nobody_tracked(what, str(bag), reasons)
        remedy = f"Record {POINTS_TOPIC}, {ANGLES_TOPIC} while the graph tracks a person."
        raise InputError(what, where=str(bag), remedy=remedy)
    return track


def tracks_from_bag(
    bag: str | Path, frame_of_stamp: Callable[[int], int], *, may_be_empty: bool = False
) -> dict[int, Track]:
    """Read everybody's track, by the person's number; the first person's is there, others' where they have any row.

    Raises InputError as :func:`track_from_bag`, unless the first person's ``may_be_empty``.
    """
    if may_be_empty:
        tracks = {FIRST_PERSON: _read_track(bag, frame_of_stamp, FIRST_PREFIX)}
    else:
        tracks = {FIRST_PERSON: track_from_bag(bag, frame_of_stamp)}
    for body_id, person in bag_persons(bag).items():
        if person != FIRST_PERSON:
            tracks[person] = _read_track(bag, frame_of_stamp, f"{FIRST_PREFIX}/bodies/{body_id}")
    return {person: track for person, track in sorted(tracks.items()) if person == FIRST_PERSON or len(track)}


def _read_track(bag: str | Path, frame_of_stamp: Callable[[int], int], prefix: str) -> Track:
    points: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    angles: dict[int, np.ndarray] = {}
    states: dict[int, tuple[str, tuple[str, ...]]] = {}
    points_topic, angles_topic, state_topic = (f"{prefix}/{what}" for what in (POINTS, ANGLES, STATE))
    for message in read_messages(bag, {points_topic, angles_topic, state_topic}.__contains__):
        if message.topic == state_topic:  # without a header: its values hold the stamp
            status = message.decode(DiagnosticStatus)
            said = {pair.key: pair.value for pair in status.values}
            if "stamp_ns" in said:
                parts = tuple(said.get(part, "") for part in PART_NAMES)
                states[frame_of_stamp(int(said["stamp_ns"]))] = status.message, parts
            continue
        frame = frame_of_stamp(message.stamp_ns)
        if message.topic == points_topic:
            cloud = message.decode(PointCloud2)
            measured = read_reference_points(cloud, f"{bag}: {points_topic}")
            points[frame] = measured.points_world, measured.covariance
        else:
            angles[frame] = _angles(message.decode(JointState), f"{bag}: {angles_topic}")
    frames = sorted(set(points) & set(angles))
    return Track(
        np.array(frames, dtype=int),
        np.array([points[f][0] for f in frames]).reshape(-1, 15, 3),
        np.array([points[f][1] for f in frames]).reshape(-1, 15, 3, 3),
        np.array([angles[f] for f in frames]).reshape(-1, len(ANGLE_NAMES)),
        np.array([states.get(f, NO_STATE)[0] for f in frames], dtype=str),
        np.array([states.get(f, NO_STATE)[1] for f in frames], dtype=str).reshape(-1, len(PART_NAMES)),
    )


def _angles(message: Any, where: str) -> np.ndarray:
    if list(message.name) != list(ANGLE_NAMES):
        remedy = "Give a bag that this graph recorded."
        raise InputError(f"joint names {list(message.name)} are not the stick figure's", where=where, remedy=remedy)
    return np.array(message.position)
