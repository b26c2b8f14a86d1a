"""The pose in the joints of REP-155 (humans in ROS): other axes and another zero pose, converted through rotations.

In the zero pose of the `human_description` URDF all limbs hang along -z and every frame is parallel to the body's
(x forward, y left, z up). Its joints, in order from the trunk, turn about

    head      r +x, y +z, p -y
    shoulder  left: y -z, p +x, r +z;  right: y +z, p -x, r -z;  elbow -y
    hip       y -z, p left +x, right -x, r -y;  knee -y
    waist     +y; our trunk is one stick, so it stays 0
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from capture_rig.errors import InputError
from mocap_packets.fit import FIRST_PERSON
from stick_figure.body import Body
from stick_figure.pose import Pose
from stick_figure.rotations import GIMBAL_SINE, HINGE_SLACK_RAD, wrap_pi

from .urdf import LinkJoint, Range, Segment, robot_urdf, segments

HRI_JOINT_NAMES = (
    *("waist", "r_head", "y_head", "p_head"),
    *(f"{side}_{name}" for side in "lr" for name in ("y_shoulder", "p_shoulder", "r_shoulder", "elbow")),
    *(f"{side}_{name}" for side in "lr" for name in ("y_hip", "p_hip", "r_hip", "knee")),
)
BODY_ID = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
STEP_S = 1e-4  # of the finite difference of rates: 20 rad/s turn by 2 mrad, so the error is some 1e-3 of them
SHOULDER_PITCH_LOW = -0.4
"""rad; lower limit of p_shoulder in the URDF."""

_QUARTER = 0.5 * np.pi + 1e-6
LIMITS = {
    "waist": (0.0, 0.0),
    "y_head": (-_QUARTER, _QUARTER),
    "p_shoulder": (SHOULDER_PITCH_LOW, np.pi + 1e-6),
    "p_hip": (-_QUARTER, _QUARTER),
    "elbow": (-HINGE_SLACK_RAD, np.pi + HINGE_SLACK_RAD),
    "knee": (-np.pi - HINGE_SLACK_RAD, HINGE_SLACK_RAD),
}
"""rad, by the end of the joint's name: the waist does not turn, the second of three angles has half a turn. All others
turn for ever."""

_ARM_TO_HANGING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Columns: the hanging arm's x, y, z in the stick figure's arm frame, where the arm points along +y."""


def body_id_of(first_id: str, person: int) -> str:
    """Return the id of a person, given that of person 1: b0001, b0002, ...; an id without a number gets one.

    Raises InputError when ``first_id`` is not a REP-155 id: letters, digits and underscores, a letter first.
    """
    if not BODY_ID.fullmatch(first_id):
        what, remedy = f"{first_id!r} is no REP-155 id", "as in b0001."
        raise InputError(
            what, where="tf_prefix, body_id", remedy=f"Use letters, digits and underscores, a letter first, {remedy}"
        )
    name, digits = re.fullmatch(r"(.*?)(\d*)", first_id).groups()  # type: ignore[union-attr]
    if not digits:
        return first_id if person == FIRST_PERSON else f"{first_id}_{person}"
    return f"{name}{int(digits) + person - FIRST_PERSON:0{len(digits)}d}"


def hri_angles(pose: Pose, previous: np.ndarray | None = None) -> np.ndarray:
    """Return the joints of `HRI_JOINT_NAMES` (20,), rad.

    ``previous`` (20,) keeps them continuous: never a whole turn away, and where the shoulder's angles are not unique;
    with the arm hanging, y and r turn about the same axis.
    """
    neck, *limbs = pose.R_joints
    before = np.zeros(20) if previous is None else previous
    angles = np.zeros(20)
    angles[1:4] = _head(neck)
    for side, outward in enumerate((1.0, -1.0)):
        arm, leg = slice(4 + 4 * side, 7 + 4 * side), slice(12 + 4 * side, 15 + 4 * side)
        angles[arm] = _shoulder(limbs[side] @ _ARM_TO_HANGING, outward, before[arm])
        angles[leg] = _hip(limbs[2 + side], outward)
    angles[[7, 11]] = -pose.hinges[:2]  # our elbows bend about +z of the arm, which hangs as +y
    angles[[15, 19]] = -pose.hinges[2:]
    return angles if previous is None else previous + wrap_pi(angles - previous)


def hri_rates(pose: Pose, velocity: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the rates (20,) of :func:`hri_angles`, rad/s, from those (24,) of the pose's tangent.

    Near a gimbal lock (an arm that hangs or points up, a leg spread by a right angle) they grow as the angles swing.
    """
    return (hri_angles(pose.retract(STEP_S * velocity), angles) - angles) / STEP_S


def body_frame(pose: Pose, half_torso: float) -> tuple[np.ndarray, np.ndarray]:
    """Origin (3,) m, between the hips, and rotation (3, 3) of the frame body_ID in the world (x forward, z up)."""
    return pose.position_world - half_torso * pose.R_world_torso[:, 2], pose.R_world_torso


def _head(R: np.ndarray) -> tuple[float, float, float]:
    """r, y, p with R = Rx(r) Rz(y) Ry(-p)."""
    yaw = np.arctan2(-R[0, 1], np.hypot(R[0, 0], R[0, 2]))
    return np.arctan2(R[2, 1], R[1, 1]), yaw, -np.arctan2(R[0, 2], R[0, 0])


def _shoulder(R: np.ndarray, outward: float, previous: np.ndarray) -> np.ndarray:
    """y, p, r with R = Rz(-s y) Rx(s p) Rz(s r), s = ``outward`` (+1 left, -1 right)."""
    if outward < 0.0:  # mirrored in the sagittal plane (y -> -y), the right arm is a left arm
        R = R * np.outer([1.0, -1.0, 1.0], [1.0, -1.0, 1.0])
    sine = np.hypot(R[0, 2], R[1, 2])
    p = np.arctan2(sine, R[2, 2])
    if sine < GIMBAL_SINE:  # arm straight down (or up): only r -+ y is seen
        y = previous[0]
        turn = np.arctan2(R[1, 0], R[0, 0])
        return np.array([y, p, wrap_pi(turn + y if R[2, 2] > 0.0 else -turn - y)])
    first = np.array([-np.arctan2(R[0, 2], -R[1, 2]), p, np.arctan2(R[2, 0], R[2, 1])])
    second = np.array([wrap_pi(first[0] + np.pi), -p, wrap_pi(first[2] + np.pi)])
    if second[1] < SHOULDER_PITCH_LOW or _distance(first, previous) <= _distance(second, previous):
        return first
    return second


def _hip(R: np.ndarray, outward: float) -> tuple[float, float, float]:
    """y, p, r with R = Rz(-y) Rx(s p) Ry(-r), s = ``outward``."""
    pitch = np.arctan2(R[2, 1], np.hypot(R[0, 1], R[1, 1]))
    return np.arctan2(R[0, 1], R[1, 1]), outward * pitch, -np.arctan2(-R[2, 0], R[2, 2])


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(wrap_pi(a - b)).sum())


# --- The URDF of a tracked person for REP-155: names as in ROS4HRI's `human_description`, measured sizes.


def human_urdf(body: Body, body_id: str, mass_kg: float | None = None) -> str:
    """The person's URDF; every link and joint name ends in ``_<body_id>``, the root link is ``body_<body_id>``;
    ``mass_kg`` as of `body_urdf`."""

    def range_of(joint: str) -> Range | None:
        return next((limits for end, limits in LIMITS.items() if joint.endswith(end)), None)

    joints, parts = list(human_joints(body)), human_segments(body, mass_kg)
    return robot_urdf(f"human_{body_id}", joints, parts, range_of, suffix=f"_{body_id}")


def human_segments(body: Body, mass_kg: float | None = None) -> dict[str, Segment]:
    """Return the segment of each link, in its frame."""
    own, upright, moved = segments(body, mass_kg), np.eye(3), {}
    moved["torso"] = own["torso"].moved(upright, np.array([0.0, 0.0, -body.half_lengths[0]]))
    moved["p_head"] = own["head"]
    for side, name in (("left", "l"), ("right", "r")):
        for stick, link in (("upper_arm", "shoulder"), ("forearm", "elbow")):
            moved[f"{name}_{link}"] = own[f"{side}_{stick}"].moved(_ARM_TO_HANGING.T, np.zeros(3))
        moved[f"{name}_hip"], moved[f"{name}_knee"] = own[f"{side}_thigh"], own[f"{side}_calf"]
    return moved


def human_joints(body: Body) -> Iterator[LinkJoint]:
    """Yield all joints, parents before children; sizes from the stick figure (the wrist stands for its hand tip)."""
    h, w = body.half_lengths[0], body.half_shoulder_width
    yield LinkJoint("waist", "body", "waist", axis=(0, 1, 0))
    yield LinkJoint("torso", "waist", "torso", (0.0, 0.0, 2 * h))
    yield LinkJoint("r_head", "torso", "r_head", axis=(1, 0, 0))
    yield LinkJoint("y_head", "r_head", "y_head", axis=(0, 0, 1))
    yield LinkJoint("p_head", "y_head", "p_head", axis=(0, -1, 0))
    yield LinkJoint("head", "p_head", "head", (0.0, 0.0, body.lengths[1]))
    for side, (s, name) in enumerate(((1, "l"), (-1, "r"))):
        upper_arm, forearm, thigh, calf = body.lengths[[2 + side, 6 + side, 4 + side, 8 + side]]
        shoulder = (0.0, s * w, (body.shoulder_height_ratio - 1.0) * h)
        yield LinkJoint(f"{name}_y_shoulder", "torso", f"{name}_y_shoulder", shoulder, (0, 0, -s))
        yield LinkJoint(f"{name}_p_shoulder", f"{name}_y_shoulder", f"{name}_p_shoulder", axis=(s, 0, 0))
        yield LinkJoint(f"{name}_r_shoulder", f"{name}_p_shoulder", f"{name}_shoulder", axis=(0, 0, s))
        yield LinkJoint(f"{name}_elbow", f"{name}_shoulder", f"{name}_elbow", (0.0, 0.0, -upper_arm), (0, -1, 0))
        yield LinkJoint(f"{name}_wrist", f"{name}_elbow", f"{name}_wrist", (0.0, 0.0, -forearm))
        hip = (0.0, s * body.hip_width_ratio * w, 0.0)
        yield LinkJoint(f"{name}_y_hip", "body", f"{name}_y_hip", hip, (0, 0, -1))
        yield LinkJoint(f"{name}_p_hip", f"{name}_y_hip", f"{name}_p_hip", axis=(s, 0, 0))
        yield LinkJoint(f"{name}_r_hip", f"{name}_p_hip", f"{name}_hip", axis=(0, -1, 0))
        yield LinkJoint(f"{name}_knee", f"{name}_hip", f"{name}_knee", (0.0, 0.0, -thigh), (0, -1, 0))
        yield LinkJoint(f"{name}_ankle", f"{name}_knee", f"{name}_ankle", (0.0, 0.0, -calf))
