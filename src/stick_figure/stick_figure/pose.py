"""The pose of the stick figure: a point on a manifold, free of gimbal lock; and how it moves, joint by joint.

Joint k of a :class:`JointMotion` moves stick k of `skeleton.STICK_NAMES`: the torso floats in the world; neck,
shoulders and hips are carried by the torso, elbows and knees by the upper limb. This is the form of ROS's
MultiDOFJointState: it has no singularity, and every number has the unit of its place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from capture_rig.kernel import njit
from capture_rig.rigid import fill_quaternion, fill_rotation

from . import kernels
from .kernels import HINGE_SLOT, SLOT_OF_JOINT_AXIS
from .rotations import Array, angles_of_joints, joint_rotations
from .skeleton import BALL_NAMES, HINGE_ANGLES, HINGE_NAMES, T_POSE_ANGLES, TORSO_POSITION

__all__ = ["HINGE_AXIS", "HINGE_MARGIN_RAD", "JOINT_NAMES", "T_POSE_ANGLES", "JointMotion", "Pose"]

# Thresholds: rates from kicks and throws in the literature, hips checked by the spinning kicks of python
# bench/people.py (35 rad/s lets some feet jump, 15 to 25 none); else judgement.
HINGE_MARGIN_RAD = 0.15
"""How far elbows and knees may pass straight before they are described the other way round."""
JOINT_NAMES = ("torso", *BALL_NAMES, *HINGE_NAMES)
"""The ten joints, in the order of the sticks that they move."""
HINGE_AXIS = np.array([2, 2, 1, 1])
"""(4,) axis about which each hinge turns, of the upper limb: elbows z, knees y."""
_FIRST_HINGE = 6
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

        A pose outside the ranges has angles that exceed them (never clipped ones). `previous` (18,) selects between two
        equal descriptions, and gives the angles that a gimbal singularity leaves undetermined.
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


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Where the torso is, how every joint of `JOINT_NAMES` is turned, and how fast.

    position_world, linear_world (3,)    torso centre, m, and its velocity, m/s
    quaternions (10, 4)                  x y z w: of each stick's frame in that of its carrier
    angular (10, 3)                      rad/s, in the carrier's axes
    """

    position_world: Array
    quaternions: Array
    linear_world: Array
    angular: Array

    @classmethod
    def of(cls, pose: Pose, velocity: Array) -> JointMotion:
        """Return the motion of a pose and its tangent's rates (24,)."""
        rates = np.ascontiguousarray(velocity, float)
        quaternions, angular = turns_of_joints(pose.R_world_torso, pose.R_joints, pose.hinges, rates)
        return cls(pose.position_world, quaternions, rates[TORSO_POSITION], angular)

    @property
    def pose(self) -> Pose:
        """The pose; rotations of a hinge about other axes than its own are left out."""
        R, hinges = rotations_of_joints(np.ascontiguousarray(self.quaternions, float))
        return Pose(self.position_world, R[0], R[1:], hinges)

    @property
    def velocity(self) -> Array:
        """The rates (24,) of the pose's tangent."""
        return tangent_rates(*(np.ascontiguousarray(rates, float) for rates in (self.linear_world, self.angular)))


# --- kernels ---------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def turns_of_joints(R0, RJ, hinges, velocity):
    """Quaternions (10, 4) and angular velocities (10, 3) of a pose (R0, RJ, hinges) and its tangent's rates (24,)."""
    quaternions, angular = np.zeros((10, 4)), np.zeros((10, 3))
    fill_quaternion(R0, quaternions[0])
    angular[0] = velocity[3:6]
    for ball in range(5):
        fill_quaternion(RJ[ball], quaternions[1 + ball])
        for axis in range(3):
            slot = SLOT_OF_JOINT_AXIS[ball, axis]
            angular[1 + ball, axis] = velocity[slot] if slot >= 0 else 0.0
    for h in range(4):
        joint, axis, half = _FIRST_HINGE + h, HINGE_AXIS[h], 0.5 * hinges[h]
        quaternions[joint, axis], quaternions[joint, 3] = math.sin(half), math.cos(half)
        angular[joint, axis] = velocity[HINGE_SLOT[h]]
    return quaternions, angular


@njit(cache=True, nogil=True)
def rotations_of_joints(quaternions):
    """Rotations (6, 3, 3) of torso and ball joints and angles (4,) of the hinges, from the quaternions (10, 4)."""
    R, hinges = np.empty((6, 3, 3)), np.empty(4)
    for joint in range(6):
        fill_rotation(quaternions[joint], R[joint])
    for h in range(4):
        turn = quaternions[_FIRST_HINGE + h]
        hinges[h] = 2.0 * math.atan2(turn[HINGE_AXIS[h]], turn[3])
    return R, hinges


@njit(cache=True, nogil=True)
def tangent_rates(linear_world, angular):
    """Rates (24,) of the tangent, from the torso's velocity (3,) and the joints' angular velocities (10, 3)."""
    velocity = np.empty(24)
    velocity[:3], velocity[3:6] = linear_world, angular[0]
    for ball in range(5):
        for axis in range(3):
            slot = SLOT_OF_JOINT_AXIS[ball, axis]
            if slot >= 0:
                velocity[slot] = angular[1 + ball, axis]
    for h in range(4):
        velocity[HINGE_SLOT[h]] = angular[_FIRST_HINGE + h, HINGE_AXIS[h]]
    return velocity
