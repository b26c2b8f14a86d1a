"""The pose of the stick figure: a point on a manifold, free of gimbal lock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import kernels
from .rotations import Array, angles_of_joints, joint_rotations
from .skeleton import HINGE_ANGLES, T_POSE_ANGLES

__all__ = ["HINGE_MARGIN_RAD", "T_POSE_ANGLES", "Pose"]

# Thresholds: rates from kicks and throws in the literature, hips checked by the spinning kicks of python
# bench/people.py (35 rad/s lets some feet jump, 15 to 25 none); else judgement.
HINGE_MARGIN_RAD = 0.15
"""How far elbows and knees may pass straight before they are described the other way round."""
_SHAPES = {"position_world": (3,), "R_world_torso": (3, 3), "R_joints": (5, 3, 3), "hinges": (4,)}


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and rotation of the torso, rotations of the ball joints, angles of the hinges (24 degrees of freedom).

    position_world (3,)     torso centre p1, metres, world frame
    R_world_torso (3, 3)    torso to world
    R_joints (5, 3, 3)      neck, left and right shoulder, left and right hip: stick to torso
    hinges (4,)             left and right elbow (<= 0 when bent), left and right knee (>= 0), rad

    Tangent vectors (24,) are named by `skeleton.TANGENT_NAMES`: translation in the world, torso rotation increment in
    the world, ball joints' increments in the torso frame (the neck only about x and y), hinges as they are.
    """

    position_world: Array
    R_world_torso: Array
    R_joints: Array
    hinges: Array

    def __post_init__(self) -> None:
        for name, shape in _SHAPES.items():
            value = np.array(getattr(self, name), dtype=np.float64, order="C")
            if value.shape != shape:
                raise ValueError(f"Pose.{name} has shape {value.shape}, expected {shape}")
            object.__setattr__(self, name, value)

    @classmethod
    def from_angles(cls, position_world: Array, R_world_torso: Array, angles: Array) -> Pose:
        """Return the pose of the torso's position and rotation and the 18 angles of `skeleton.ANGLE_NAMES` (rad)."""
        angles = np.ascontiguousarray(angles, float)
        if angles.shape != (18,):
            raise ValueError(f"angles have shape {angles.shape}, expected (18,)")
        return cls(position_world, R_world_torso, joint_rotations(angles), angles[HINGE_ANGLES])

    def angles(self, previous: Array | None = None) -> Array:
        """Return the 18 angles (rad), the exact inverse of :meth:`from_angles` inside the ranges of thesis Table 5.1.

        A pose outside the ranges gives an equal description of itself that exceeds them (never a clipped one).
        `previous` (18,) settles what a gimbal singularity leaves open and which of two equal descriptions is meant.
        """
        return angles_of_joints(self.R_joints, self.hinges, previous)

    def retract(self, tangent: Array) -> Pose:
        """Return the pose reached along a tangent vector (24,)."""
        moved = Pose(self.position_world, self.R_world_torso, self.R_joints, self.hinges)
        kernels.retract(*moved.arrays, np.ascontiguousarray(tangent, float), 1.0)
        return moved

    def minus(self, other: Pose) -> Array:
        """Return the tangent (24,) that leads from `other` to this pose: other.retract(self.minus(other)) is self."""
        tangent = np.zeros(24)
        kernels.difference(*self.arrays, *other.arrays, tangent)
        return tangent

    def canonical(self, margin: float = HINGE_MARGIN_RAD) -> Pose:
        """Return the same points with every hinge that passed straight by more than `margin` rad bent the right way."""
        moved = Pose(self.position_world, self.R_world_torso, self.R_joints, self.hinges)
        kernels.canonicalise_hinges(moved.R_joints, moved.hinges, np.zeros(24), margin)
        return moved

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """t0, R0, RJ, hinges as the kernels take them (no copies: a kernel that moves them moves the pose)."""
        return self.position_world, self.R_world_torso, self.R_joints, self.hinges
