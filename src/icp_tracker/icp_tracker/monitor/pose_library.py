"""Poses to try: of the whole body (turned round, sides exchanged, stances in the hull), and of one limb."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from capture_rig.rigid import rotation_matrix
from mocap_packets.fit import PART_POINTS
from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, ANGLE_NAMES, BALL_ANGLES, HEAD, angles_of_sides

from .evidence import LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG

HEADINGS = 8  # a fit finds a trunk that is turned by half of an eighth
WITH_SIDES = [0, 1, 2, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13]  # left and right of every reference point
WITH_ARMS = [0, 1, 2, 3, 4, 5, 6, 8, 7, 9, 10, 12, 11, 13, 14]  # elbows and hands exchanged
WITH_LEGS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 9, 11, 12, 14, 13]  # knees and feet
HANG = -1.35  # rad, of an arm below the horizontal
# angles of each side (rad), the others those of the T-pose. A step has the other side's arm in front.
_STANDING = {"shoulder_x": HANG}
_FRONT_LEG = {"shoulder_x": HANG, "shoulder_z": 0.35, "hip_y": -0.45, "knee": 0.15}
_BACK_LEG = {"shoulder_x": HANG, "shoulder_z": -0.35, "elbow": -0.4, "hip_y": 0.25, "knee": 0.5}
_BENT_ARM = {"shoulder_x": HANG, "elbow": -1.5}
POSTURES: tuple[tuple[dict[str, float], dict[str, float]], ...] = (
    (_STANDING, _STANDING),
    (_FRONT_LEG, _BACK_LEG),
    (_BACK_LEG, _FRONT_LEG),
    (_BENT_ARM, _BENT_ARM),
    ({"shoulder_z": HANG}, {"shoulder_z": HANG}),
    ({}, {}),
    ({"shoulder_x": 1.2}, {"shoulder_x": 1.2}),
    ({"shoulder_x": -1.2, "hip_y": -1.6, "knee": 1.8}, {"shoulder_x": -1.2, "hip_y": -1.6, "knee": 1.8}),
)
"""Left and right side: standing, both steps, arms bent, arms forward, T-pose, hands up, squat."""


def exchanged(body: Body, pose: Pose, points: list[int]) -> Pose:
    """Return the pose with left and right ``points`` exchanged: limbs stay in place under the other side's name; with
    all of them the body faces the other way."""
    return inverse(body, forward(body, pose)[points], pose)


def turned_around(pose: Pose) -> Pose:
    """Return the pose turned by half a turn about the torso's axis, the joints' angles kept."""
    return replace(pose, R_world_torso=rotation_matrix(np.pi * pose.R_world_torso[:, 2]) @ pose.R_world_torso)


def moved_to(pose: Pose, hull_world: np.ndarray) -> Pose:
    """Return the pose above the middle of the hull's samples (m, 3)."""
    x, y = np.median(hull_world[:, :2], axis=0)
    return replace(pose, position_world=np.array([x, y, pose.position_world[2]]))


def natural_poses(
    body: Body, place_world: np.ndarray, crown_world: float, postures: Sequence[np.ndarray]
) -> list[Pose]:
    """Return postures (18,) at every heading, the trunk above a place (2,) m and the head at a height, m."""
    height = crown_world - body.half_lengths[0] - body.lengths[HEAD]
    return [
        Pose.from_angles(np.r_[place_world, height], rotation_matrix(np.array([0.0, 0.0, heading])), angles)
        for heading in np.arange(HEADINGS) * 2.0 * np.pi / HEADINGS
        for angles in postures
    ]


def stances(body: Body, hull_world: np.ndarray) -> list[Pose]:
    """Return every posture at every heading above the middle of the hull (m, 3), its head at the hull's crown."""
    crown = float(np.percentile(hull_world[:, 2], 99.5))
    return natural_poses(body, np.median(hull_world[:, :2], axis=0), crown, _POSTURES)


def angles_of_posture(left: Mapping[str, float], right: Mapping[str, float]) -> np.ndarray:
    """Return the angles (18,) of a posture, given those of each side, rad, that are not the T-pose's."""
    sides = np.tile(T_POSE_ANGLES, (2, 1))
    for angles, side in zip(sides, (left, right), strict=True):
        for name, value in side.items():
            angles[ANGLE_NAMES.index(f"left_{name}")] = value
    return angles_of_sides(*sides)


_POSTURES = tuple(angles_of_posture(left, right) for left, right in POSTURES)
NATURAL_POSTURES = _POSTURES[:5]
"""Of people who walk in."""


# --- limbs: directions of the upper limb times flexions of the hinge, within the joints' ranges

# Thresholds: measured by python bench/recovery.py.
ARM_DIRECTIONS, LEG_DIRECTIONS = 72, 60  # evenly over the sphere, before those out of range are dropped
ARM_FLEXIONS, LEG_FLEXIONS = (0.2, 1.1, 2.0), (0.2, 1.0, 1.8)  # rad
ARM_TURNS, LEG_TURNS = 6, 8  # directions into which a hinge bends, around the upper limb
BACK_MOST, ACROSS_MOST = -0.75, -0.75  # arms: of the unit direction, backward and to the other side
LEG_UP_MOST, LEG_BACK_MOST, LEG_ACROSS_MOST = 0.3, -0.6, -0.5
STRAIGHT = 0.3  # rad below which all turns are the same limb
RANGE_SLACK = 0.2  # rad beyond a joint's range that is still tried


class Limb(NamedTuple):
    """part : of evidence.PART_NAMES; ball, hinge : its joints' numbers; upper, lower : its sticks; slots (4,) of the
    pose's tangent that move it."""

    part: int
    ball: int
    hinge: int
    upper: int
    lower: int
    slots: tuple[int, int, int, int]

    @property
    def is_arm(self) -> bool:
        return self.part in (LEFT_ARM, RIGHT_ARM)

    @property
    def parts(self) -> int:
        """Number of parts in which its library is searched; an arm's has twice the poses of a leg's."""
        return 4 if self.is_arm else 2

    @property
    def side(self) -> float:
        """+1 left, -1 right."""
        return 1.0 if self.part in (LEFT_ARM, LEFT_LEG) else -1.0


LIMBS = (
    Limb(LEFT_ARM, 1, 0, 2, 6, (8, 10, 12, 14)),
    Limb(RIGHT_ARM, 2, 1, 3, 7, (9, 11, 13, 15)),
    Limb(LEFT_LEG, 3, 2, 4, 8, (16, 18, 20, 22)),
    Limb(RIGHT_LEG, 4, 3, 5, 9, (17, 19, 21, 23)),
)
LIMB_POINTS = np.array([PART_POINTS[limb.part] for limb in LIMBS])
"""(4, 2) reference points of each limb: elbow and hand, or knee and foot."""


class LimbPoses(NamedTuple):
    """R (h, 3, 3) upper limb to torso; flexion (h,) rad, signed as the pose's hinges are."""

    R: np.ndarray
    flexion: np.ndarray

    @staticmethod
    def of(pose: Pose, limb: Limb) -> LimbPoses:
        """Return the one pose that a limb has in a pose of the body."""
        return LimbPoses(pose.R_joints[None, limb.ball], pose.hinges[None, limb.hinge])

    def at(self, number: int) -> tuple[np.ndarray, float]:
        """Return one pose."""
        return self.R[number], float(self.flexion[number])

    def part(self, number: int, parts: int) -> LimbPoses:
        """Return every ``parts``-th pose: together the parts are the whole."""
        return LimbPoses(
            np.ascontiguousarray(self.R[number % parts :: parts]),
            np.ascontiguousarray(self.flexion[number % parts :: parts]),
        )


@lru_cache(maxsize=8)
def limb_poses(limb: Limb) -> LimbPoses:
    """Return the library of one limb; the same every time."""
    count, flexions, turns = (
        (ARM_DIRECTIONS, ARM_FLEXIONS, ARM_TURNS) if limb.is_arm else (LEG_DIRECTIONS, LEG_FLEXIONS, LEG_TURNS)
    )
    rotations, bends = [], []
    for direction in even_directions(count):
        if not _reachable(limb, direction):
            continue
        for flexion in flexions:
            for turn in range(turns if flexion > STRAIGHT else 1):
                R, bend = _frame(limb, direction, 2.0 * np.pi * turn / turns), -flexion if limb.is_arm else flexion
                if _in_range(limb, R, bend):
                    rotations.append(R)
                    bends.append(bend)
    return LimbPoses(np.array(rotations), np.array(bends))


def even_directions(count: int) -> np.ndarray:
    """Return (count, 3) unit vectors evenly over the sphere (golden spiral)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def _reachable(limb: Limb, direction: np.ndarray) -> bool:
    ahead, out, up = direction[0], limb.side * direction[1], direction[2]
    if limb.is_arm:
        return ahead > BACK_MOST and out > ACROSS_MOST
    return up < LEG_UP_MOST and ahead > LEG_BACK_MOST and out > LEG_ACROSS_MOST


def _frame(limb: Limb, direction: np.ndarray, turn: float) -> np.ndarray:
    """Rotation of an upper limb along ``direction`` (torso frame) whose hinge bends toward the angle ``turn``."""
    helper = np.array([1.0, 0.0, 0.0]) if abs(direction[0]) < 0.8 else np.array([0.0, 0.0, 1.0])
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first)
    bend = np.cos(turn) * first + np.sin(turn) * np.cross(direction, first)
    if limb.is_arm:  # along +y of its own frame; the elbow bends toward its x
        return np.stack([bend, direction, np.cross(bend, direction)], axis=1)
    return np.stack([-bend, np.cross(direction, bend), -direction], axis=1)  # along -z; the knee bends toward its -x


def _in_range(limb: Limb, R: np.ndarray, flexion: float) -> bool:
    """Return whether the ball joint allows the limb. The twist of a straight limb may be any."""
    rest = Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES)
    R_joints, hinges = rest.R_joints.copy(), rest.hinges.copy()
    R_joints[limb.ball], hinges[limb.hinge] = R, flexion
    slots = BALL_ANGLES[limb.ball][: 3 if abs(flexion) > STRAIGHT else 2]
    angles = Pose(np.zeros(3), np.eye(3), R_joints, hinges).angles()[slots]
    return bool(((angles >= ANGLE_LOW[slots] - RANGE_SLACK) & (angles <= ANGLE_HIGH[slots] + RANGE_SLACK)).all())
