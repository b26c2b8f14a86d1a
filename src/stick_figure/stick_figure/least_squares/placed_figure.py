"""Poses and bodies as the plain arrays that the compiled kernels work on, and back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stick_figure.body import Body
from stick_figure.pose import Pose


class State(NamedTuple):
    """A pose as arrays that a solver changes in place.

    t0 (3,) torso centre, world, m; R0 (3, 3) torso to world; RJ (5, 3, 3) ball joints, stick to torso;
    hinges (4,) rad.
    """

    t0: np.ndarray
    R0: np.ndarray
    RJ: np.ndarray
    hinges: np.ndarray

    @staticmethod
    def of(pose: Pose) -> State:
        """Fresh float64 copies of a pose's parts."""
        parts = (pose.position_world, pose.R_world_torso, pose.R_joints, pose.hinges)
        return State(*(np.array(part, dtype=np.float64, order="C") for part in parts))

    def pose(self) -> Pose:
        """The pose these arrays describe (copied)."""
        return Pose(*(part.copy() for part in self))


class Figure(NamedTuple):
    """A body as arrays: lengths (10,) m of the sticks, origins (10, 3) m of those that start on the torso."""

    lengths: np.ndarray
    origins: np.ndarray

    @staticmethod
    def of(body: Body) -> Figure:
        return Figure(
            np.ascontiguousarray(body.lengths, dtype=np.float64),
            np.ascontiguousarray(body.stick_origins_torso, dtype=np.float64),
        )
