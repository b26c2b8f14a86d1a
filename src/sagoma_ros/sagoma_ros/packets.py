"""Joint states, their covariance, and the EKF's prediction, to and from messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from capture_rig.errors import InputError
from stick_figure.pose import Pose
from stick_figure.rotations import rotation_matrix, rotation_vector
from stick_figure.skeleton import JOINTS, TANGENT_NAMES, TORSO_POSITION, TORSO_ROTATION

from .messages import to_ns, to_stamp


def joint_state_message(
    names: Sequence[str], angles: np.ndarray, rates: np.ndarray, stamp_ns: int, frame_id: str = ""
) -> JointState:
    """Angles (n,) rad and rates (n,) rad/s by name."""
    message = JointState(name=list(names), position=angles.tolist(), velocity=rates.tolist())
    message.header.stamp, message.header.frame_id = to_stamp(stamp_ns), frame_id
    return message


@dataclass(frozen=True)
class Prediction:
    """The EKF's state after the frame set of ``stamp_ns``; pose is None while the filter has no state.

    velocity : (24,) rate of the pose's tangent, m/s and rad/s: the pose dt later is ``pose.retract(velocity * dt)``.
    """

    stamp_ns: int
    pose: Pose | None
    velocity: np.ndarray


def prediction_message(pose: Pose | None, velocity: np.ndarray, stamp_ns: int, frame_id: str = "map") -> JointState:
    """A prediction as a JointState over the 24 tangent names.

    position = torso position (m), rotation vector of R_world_torso (rad), 18 angles (rad); velocity = tangent rates.
    """
    if pose is None:
        return joint_state_message([], np.empty(0), np.empty(0), stamp_ns, frame_id)
    position = np.concatenate([pose.position_world, rotation_vector(pose.R_world_torso), pose.angles()])
    return joint_state_message(TANGENT_NAMES, position, np.asarray(velocity), stamp_ns, frame_id)


def read_prediction(message: JointState, where: str) -> Prediction:
    """The inverse of :func:`prediction_message`; InputError when names or lengths are not ours."""
    stamp_ns = to_ns(message.header.stamp)
    if not message.name:
        return Prediction(stamp_ns, None, np.zeros(len(TANGENT_NAMES)))
    sizes = {len(message.name), len(message.position), len(message.velocity)}
    if tuple(message.name) != TANGENT_NAMES or len(sizes) != 1:
        raise InputError(
            "names or lengths are not those of a prediction",
            where=where,
            remedy=f"Give position and velocity of {', '.join(TANGENT_NAMES)}.",
        )
    position, velocity = np.array(message.position), np.array(message.velocity)
    if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
        raise InputError("the prediction holds numbers that are not finite", where=where, remedy="Check its publisher.")
    R_world_torso = rotation_matrix(position[TORSO_ROTATION])
    pose = Pose.from_angles(position[TORSO_POSITION], R_world_torso, position[JOINTS])
    return Prediction(stamp_ns, pose, velocity)


def covariance_message(names: Sequence[str], covariance: np.ndarray) -> Float64MultiArray:
    """Covariance (n, n); both dimensions are labelled with the n names, comma-separated."""
    n = len(names)
    message = Float64MultiArray(data=np.asarray(covariance, float).reshape(-1).tolist())
    message.layout.dim = [
        MultiArrayDimension(label=",".join(names), size=n, stride=n * n),
        MultiArrayDimension(label=",".join(names), size=n, stride=n),
    ]
    return message
