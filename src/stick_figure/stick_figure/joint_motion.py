"""A pose and its velocity, joint by joint: a quaternion and a twist each, in the axes of what carries the joint.

Joint k moves stick k of `skeleton.STICK_NAMES`: the torso floats in the world; neck, shoulders and hips are carried by
the torso, elbows and knees by the upper limb. This is the form of ROS's MultiDOFJointState: it has no singularity, and
every number has the unit that its place says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .kernels import HINGE_SLOT, SLOT_OF_JOINT_AXIS
from .pose import Pose
from .rotations import Array, rotation_matrix, rotation_vector
from .skeleton import BALL_NAMES, HINGE_NAMES, TORSO_POSITION, TORSO_ROTATION

JOINT_NAMES = ("torso", *BALL_NAMES, *HINGE_NAMES)
"""The ten joints, in the order of the sticks that they move."""
HINGE_AXIS = np.array([2, 2, 1, 1])
"""(4,) axis about which each hinge turns, of the upper limb: elbows z, knees y."""
_HINGE_ROWS = slice(6, 10)
_TURNS = SLOT_OF_JOINT_AXIS >= 0
_BALL_SLOTS = SLOT_OF_JOINT_AXIS[_TURNS]


def quaternion_of(R: Array) -> Array:
    """Return the unit quaternion (4,), x y z w with w >= 0, of a rotation matrix (3, 3)."""
    return quaternions_of(R[None])[0]


def quaternions_of(R: Array) -> Array:
    """Return those (n, 4) of rotation matrices (n, 3, 3)."""
    vectors = [rotation_vector(one) for one in R]
    angles = np.array([math.sqrt(vector @ vector) for vector in vectors])
    quaternions = np.empty((len(R), 4))
    quaternions[:, :3] = np.array(vectors) * (0.5 * np.sinc(angles / (2.0 * np.pi)))[:, None]  # sin(angle / 2) / angle
    quaternions[:, 3] = [math.cos(angle / 2.0) for angle in angles.tolist()]
    return quaternions


def matrix_of(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (4,), x y z w, of any length but 0."""
    x, y, z, w = quaternion.tolist()
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return np.eye(3)
    return rotation_matrix(np.array([x, y, z]) * (2.0 * math.atan2(sine, w) / sine))


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
        quaternions, angular = np.zeros((10, 4)), np.zeros((10, 3))
        quaternions[:6] = quaternions_of(np.concatenate([pose.R_world_torso[None], pose.R_joints]))
        halves = [angle / 2.0 for angle in pose.hinges.tolist()]
        quaternions[_HINGE_ROWS][range(4), HINGE_AXIS] = [math.sin(half) for half in halves]
        quaternions[_HINGE_ROWS, 3] = [math.cos(half) for half in halves]
        angular[0] = velocity[TORSO_ROTATION]
        angular[1:6][_TURNS] = velocity[_BALL_SLOTS]
        angular[_HINGE_ROWS][range(4), HINGE_AXIS] = velocity[HINGE_SLOT]
        return cls(pose.position_world, quaternions, np.asarray(velocity[TORSO_POSITION], float), angular)

    @property
    def pose(self) -> Pose:
        """The pose; what a hinge's quaternion says about other axes than its own is left out."""
        R = np.array([matrix_of(quaternion) for quaternion in self.quaternions[:6]])
        hinges = self.quaternions[_HINGE_ROWS]
        angles = 2.0 * np.arctan2(hinges[range(4), HINGE_AXIS], hinges[:, 3])
        return Pose(self.position_world, R[0], R[1:], angles)

    @property
    def velocity(self) -> Array:
        """The rates (24,) of the pose's tangent."""
        velocity = np.empty(24)
        velocity[TORSO_POSITION], velocity[TORSO_ROTATION] = self.linear_world, self.angular[0]
        velocity[_BALL_SLOTS] = self.angular[1:6][_TURNS]
        velocity[HINGE_SLOT] = self.angular[_HINGE_ROWS][range(4), HINGE_AXIS]
        return velocity
