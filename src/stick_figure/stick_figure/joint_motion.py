"""A pose and its velocity, joint by joint: a quaternion and a twist each, in the axes of what carries the joint.

Joint k moves stick k of `skeleton.STICK_NAMES`: the torso floats in the world; neck, shoulders and hips are carried by
the torso, elbows and knees by the upper limb. This is the form of ROS's MultiDOFJointState: it has no singularity, and
every number has the unit that its place says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from capture_rig.kernel import njit
from capture_rig.rigid import Array, fill_quaternion, fill_rotation

from .kernels import HINGE_SLOT, SLOT_OF_JOINT_AXIS
from .pose import Pose
from .skeleton import BALL_NAMES, HINGE_NAMES, TORSO_POSITION

JOINT_NAMES = ("torso", *BALL_NAMES, *HINGE_NAMES)
"""The ten joints, in the order of the sticks that they move."""
HINGE_AXIS = np.array([2, 2, 1, 1])
"""(4,) axis about which each hinge turns, of the upper limb: elbows z, knees y."""
_FIRST_HINGE = 6


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
        """The pose; what a hinge's quaternion says about other axes than its own is left out."""
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
