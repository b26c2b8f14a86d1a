"""Where arms and legs can be: directions of the upper limb times flexions of the hinge, within the joints' ranges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, BALL_ANGLES

from .evidence import LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG

ARM_DIRECTIONS, LEG_DIRECTIONS = 72, 60  # evenly over the sphere, before those out of range are dropped
ARM_FLEXIONS, LEG_FLEXIONS = (0.2, 1.1, 2.0), (0.2, 1.0, 1.8)  # rad
ARM_TURNS, LEG_TURNS = 6, 8  # directions into which a hinge bends, around the upper limb
BACK_MOST, ACROSS_MOST = -0.75, -0.75  # arms: of the unit direction, backward and to the other side
LEG_UP_MOST, LEG_BACK_MOST, LEG_ACROSS_MOST = 0.3, -0.6, -0.5
STRAIGHT = 0.3  # rad below which all turns are the same limb
RANGE_SLACK = 0.2  # rad beyond a joint's range that is still tried


@dataclass(frozen=True, eq=False)
class Limb:
    """part : of evidence.PART_NAMES; ball, hinge : its joints' numbers; upper, lower : its sticks; slots (4,) of the
    pose's tangent that move it."""

    part: int
    ball: int
    hinge: int
    upper: int
    lower: int
    slots: tuple[int, ...]

    @property
    def is_arm(self) -> bool:
        return self.part in (LEFT_ARM, RIGHT_ARM)

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


@dataclass(frozen=True, eq=False)
class LimbPoses:
    """R (h, 3, 3) upper limb to torso; flexion (h,) rad, signed as the pose's hinges are."""

    R: np.ndarray
    flexion: np.ndarray

    def __len__(self) -> int:
        return len(self.flexion)

    def part(self, number: int, parts: int) -> LimbPoses:
        """Every ``parts``-th pose: together the parts are the whole."""
        return LimbPoses(
            np.ascontiguousarray(self.R[number % parts :: parts]),
            np.ascontiguousarray(self.flexion[number % parts :: parts]),
        )


@lru_cache(maxsize=8)
def limb_poses(limb: Limb) -> LimbPoses:
    """The library of one limb; the same every time."""
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
    """(count, 3) unit vectors evenly over the sphere (golden spiral)."""
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
    """Whether the ball joint allows it. The twist of a straight limb may be any."""
    rest = Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES)
    R_joints, hinges = rest.R_joints.copy(), rest.hinges.copy()
    R_joints[limb.ball], hinges[limb.hinge] = R, flexion
    slots = BALL_ANGLES[limb.ball][: 3 if abs(flexion) > STRAIGHT else 2]
    angles = Pose(np.zeros(3), np.eye(3), R_joints, hinges).angles()[slots]
    return bool(((angles >= ANGLE_LOW[slots] - RANGE_SLACK) & (angles <= ANGLE_HIGH[slots] + RANGE_SLACK)).all())
