"""The motion of one person at a constant rate; gaps are NaN, and filled for formats that cannot hold them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from capture_rig.errors import InputError
from capture_rig.stamps import NS_PER_S
from stick_figure.kinematics import stick_frames
from stick_figure.pose import Pose
from stick_figure.skeleton import T_POSE_ANGLES

Array = np.ndarray
R_ANIMATION_WORLD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""From the axes of REP-103 to those of animation (BVH, glTF): y up, the rest pose faces +z, its left is +x."""
R_BIOMECHANICS_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""To those of biomechanics (OpenSim; Wu & Cavanagh, J. Biomech. 28, 1995): x forward, y up, z right."""
UNTRACKED = ""
"""The state of a frame in a gap."""
SHORTEST_FRAMES = 2
CAMERA_RATES_HZ = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 75.0, 90.0, 100.0, 120.0, 144.0, 200.0, 240.0)
NEAR_A_CAMERA_RATE = 0.005
"""Relative tolerance within which a rate counts as a usual one: stamps jitter by more than cameras' clocks drift."""


@dataclass(frozen=True, eq=False)
class Motion:
    """One person's motion at a constant rate; world frame of REP-103 (z up), metres, radians, seconds.

    name : of the person or take. rate_hz : frames a second. start_ns : stamp of frame 0.
    points_world : (F, 15, 3), order of ``stick_figure.skeleton.POINT_NAMES``; covariance : (F, 15, 3, 3) m^2.
    angles : (F, 18), order of ``ANGLE_NAMES``. torso_position_world : (F, 3); R_world_torso : (F, 3, 3).
    states : (F,) the tracker's state, empty in a gap, where all numbers are NaN.
    """

    name: str
    rate_hz: float
    start_ns: int
    points_world: Array
    covariance: Array
    angles: Array
    torso_position_world: Array
    R_world_torso: Array
    states: Array

    def __len__(self) -> int:
        return len(self.states)

    @classmethod
    def of_samples(
        cls, name: str, stamps_ns: Array, states: Array, columns: Mapping[str, Array], rate_hz: float | None = None
    ) -> Motion:
        """Place samples on frames of a constant rate, each on the nearest frame; frames without a sample are gaps.

        stamps_ns : (N,) increasing; states : (N,); columns : the other arrays of this class by name, a row a sample.
        rate_hz : else that of the median interval. Raises InputError for fewer than two samples or a bad rate.
        """
        if len(stamps_ns) < SHORTEST_FRAMES:
            remedy = "Export a take in which a body moves."
            raise InputError(f"{name} has {len(stamps_ns)} tracked frames", remedy=remedy)
        rate = rate_hz if rate_hz is not None else usual_rate(stamps_ns)
        if not (np.isfinite(rate) and rate > 0):
            raise InputError(f"a rate of {rate} Hz is none", remedy="Give frames a second, above 0.")
        frames = np.rint((stamps_ns - stamps_ns[0]) * (rate / NS_PER_S)).astype(int)
        frames, first = np.unique(frames, return_index=True)
        tracked = np.isin(np.arange(frames[-1] + 1), frames)
        spread = {column: in_frames(values[first], tracked) for column, values in columns.items()}
        all_states = np.full(len(tracked), UNTRACKED, dtype=object)
        all_states[tracked] = states[first]
        return cls(name, float(rate), int(stamps_ns[0]), states=all_states, **spread)

    @cached_property
    def R_world_sticks(self) -> Array:
        """(F, 10, 3, 3) frame of each stick (``stick_figure.skeleton.STICK_NAMES``) by forward kinematics."""
        out = np.full((len(self), 10, 3, 3), np.nan)
        for frame in np.flatnonzero(self.tracked):
            pose = Pose.from_angles(self.torso_position_world[frame], self.R_world_torso[frame], self.angles[frame])
            out[frame] = stick_frames(pose)
        return out

    @cached_property
    def times_s(self) -> Array:
        """(F,) seconds since the first frame."""
        return np.arange(len(self)) / self.rate_hz

    @property
    def tracked(self) -> Array:
        """(F,) bool, False in a gap."""
        return self.states != UNTRACKED

    def frame_at(self, stamp_ns: int) -> int | None:
        """Return the frame nearest to a stamp; None before the first, after the last, and in a gap."""
        frame = round((stamp_ns - self.start_ns) * self.rate_hz / NS_PER_S)
        return frame if 0 <= frame < len(self) and self.states[frame] != UNTRACKED else None

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """First frame, and the one after the last, of each gap."""
        edges = np.flatnonzero(np.diff(np.r_[True, self.tracked, True].astype(int)))
        return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def point_deviations(covariance: Array) -> Array:
    """Return the standard deviation (...) m of points in one direction, of their covariance (..., 3, 3) m^2: the root
    of its mean variance."""
    return np.sqrt(np.trace(covariance, axis1=-2, axis2=-1) / 3.0)


def usual_rate(stamps_ns: Array) -> float:
    """Return the frames a second of stamps (N,) ns: of their median interval, as a usual camera rate where near one."""
    rate = NS_PER_S / float(np.median(np.diff(stamps_ns)))
    nearest = min(CAMERA_RATES_HZ, key=lambda usual: abs(usual - rate))
    return nearest if abs(nearest - rate) <= NEAR_A_CAMERA_RATE * nearest else rate


def in_frames(values: Array, tracked: Array) -> Array:
    """Spread rows of the tracked frames (F,) bool over all frames; NaN in gaps."""
    out = np.full((len(tracked), *values.shape[1:]), np.nan)
    out[tracked] = values
    return out


def fill_linearly(values: Array, tracked: Array) -> Array:
    """Fill the gaps of values (F, ...) by straight lines; before the first and after the last frame they are held."""
    known, every = np.flatnonzero(tracked), np.arange(len(values))
    flat = values.reshape(len(values), -1)
    return np.stack([np.interp(every, known, column[known]) for column in flat.T], axis=1).reshape(values.shape)


def fill_rotations(R: Array, tracked: Array) -> Array:
    """Fill the gaps of rotations (F, 3, 3) by spherical interpolation, the short way (Shoemake 1985)."""
    known = np.flatnonzero(tracked)
    if len(known) == 1:
        return np.broadcast_to(R[known[0]], R.shape).copy()
    every = np.clip(np.arange(len(R)), known[0], known[-1])
    return Slerp(known, Rotation.from_matrix(R[known]))(every).as_matrix()


T_POSE_STICKS = stick_frames(Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES))
"""(10, 3, 3) frames of the sticks in the T-pose of a torso along the world's axes."""


def rotated(R: Array, R_to_from: Array) -> Array:
    """Return rotations (..., 3, 3) expressed in other axes."""
    return R_to_from @ R @ R_to_from.T
