"""What the built-in person does: smooth joint angles as functions of time, the truth of a session.

A motion starts in the T-pose, blends into standing, and then runs through activities that fade into each other. All
angles stay inside the joint ranges because every activity does and fading is a weighted mean.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, T_POSE_ANGLES, mirror_angles

from .body import ANKLE_HEIGHT

Array = NDArray[np.float64]

T_POSE_S, BLEND_S, FADE_S = 1.0, 0.6, 0.6
CIRCLE_RADIUS_M = 0.30
STEP_HZ = 0.85
"""Full walking cycles (two steps) per second."""
GRID_HZ = 480.0
"""Step of the time integral along the circle; finer than any frame rate, so that truth does not depend on fps."""
SOFT_FLOOR_M = 0.01
"""How smoothly the standing foot changes: width of the soft minimum of both ankles' heights."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A sequence of poses at a fixed rate.

    poses: one per frame; angles (F, 18) rad, the angles they were made of; fps: frames a second.
    """

    poses: tuple[Pose, ...]
    angles: Array
    fps: float


@dataclass(frozen=True)
class _Activity:
    duration_s: float
    angles: Callable[[float], Array]
    walking: float = 0.0
    lean: Callable[[float], Array] = lambda t: np.zeros(3)
    """Rotation vector of the torso in its heading frame."""


def tour(body: Body, seconds: float, fps: float) -> Motion:
    """T-pose, then walking in a circle, raising the arms, a squat, turning the torso, and round again."""
    return _play(body, seconds, fps, _TOUR)


def walk(body: Body, seconds: float, fps: float) -> Motion:
    """T-pose, then walking in a circle to the end."""
    return _play(body, seconds, fps, (_Activity(1e9, _walking, walking=1.0, lean=_walking_lean),))


def t_pose_only(body: Body, seconds: float, fps: float) -> Motion:
    """Standing still in the T-pose."""
    return _play(body, seconds, fps, (), t_pose_s=np.inf)


MOTIONS: dict[str, Callable[[Body, float, float], Motion]] = {"tour": tour, "walk": walk, "t_pose_only": t_pose_only}


def _play(
    body: Body, seconds: float, fps: float, activities: tuple[_Activity, ...], t_pose_s: float = T_POSE_S
) -> Motion:
    frames = _frame_count(seconds, fps)
    times = np.arange(frames) / fps
    weights = [_weights(t, activities, t_pose_s) for t in times]
    turned = np.interp(times, *_turned_angle(times[-1], activities, t_pose_s))
    angles = np.array([_mixed_angles(t, w, activities) for t, w in zip(times, weights, strict=True)])
    leans = np.array([_mixed_lean(t, w, activities) for t, w in zip(times, weights, strict=True)])
    poses = tuple(_stand(body, a, lean, turn) for a, lean, turn in zip(angles, leans, turned, strict=True))
    return Motion(poses, angles, fps)


def _frame_count(seconds: float, fps: float) -> int:
    for name, value in (("seconds", seconds), ("fps", fps)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value!r}", remedy="Give a positive number.")
    frames = round(seconds * fps)
    if frames < 1:
        raise InputError(f"{seconds:g} s at {fps:g} fps is no frame", remedy="Give a longer time.")
    return frames


def _weights(t: float, activities: tuple[_Activity, ...], t_pose_s: float) -> Array:
    """Weights of the T-pose and of each activity at time t; they sum to one and have two continuous derivatives."""
    weights = np.zeros(1 + len(activities))
    start = _ease((t - t_pose_s) / BLEND_S) if np.isfinite(t_pose_s) else 0.0
    weights[0] = 1.0 - start
    if not activities or start == 0.0:
        return weights
    durations = np.array([activity.duration_s for activity in activities])
    phase = (t - t_pose_s) % durations.sum()
    current = int(np.searchsorted(np.cumsum(durations), phase, side="right"))
    left = np.cumsum(durations)[current] - phase
    onward = _ease(1.0 - left / FADE_S)
    weights[1 + current] += start * (1.0 - onward)
    weights[1 + (current + 1) % len(activities)] += start * onward
    return weights


def _ease(x: float) -> float:
    """0 to 1 with zero first and second derivative at both ends."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (x * (6.0 * x - 15.0) + 10.0)


def _turned_angle(end: float, activities: tuple[_Activity, ...], t_pose_s: float) -> tuple[Array, Array]:
    """Times and the angle walked along the circle by then, rad."""
    times = np.arange(int(np.ceil(end * GRID_HZ)) + 2) / GRID_HZ
    speeds = np.array([_walking_share(_weights(t, activities, t_pose_s), activities) for t in times])
    steps = 0.5 * (speeds[1:] + speeds[:-1]) * (0.9 / GRID_HZ)
    return times, np.concatenate([[0.0], np.cumsum(steps)])


def _walking_share(weights: Array, activities: tuple[_Activity, ...]) -> float:
    return float(sum(w * a.walking for w, a in zip(weights[1:], activities, strict=True)))


def _mixed_angles(t: float, weights: Array, activities: tuple[_Activity, ...]) -> Array:
    angles = weights[0] * T_POSE_ANGLES
    for weight, activity in zip(weights[1:], activities, strict=True):
        if weight > 0.0:
            angles = angles + weight * activity.angles(t)
    return angles


def _mixed_lean(t: float, weights: Array, activities: tuple[_Activity, ...]) -> Array:
    lean = np.zeros(3)
    for weight, activity in zip(weights[1:], activities, strict=True):
        if weight > 0.0:
            lean = lean + weight * activity.lean(t)
    return lean


def _stand(body: Body, angles: Array, lean: Array, turned: float) -> Pose:
    """The pose with its lower foot on the floor, at its place on the circle (start: facing +x, right of the centre)."""
    heading = Rotation.from_rotvec([0.0, 0.0, turned])
    R_world_torso = (heading * Rotation.from_rotvec(lean)).as_matrix()
    points = forward(body, Pose.from_angles(np.zeros(3), R_world_torso, angles))
    ankles = points[13:15, 2]
    lowest = -SOFT_FLOOR_M * np.log(np.exp(-(ankles - ankles.min()) / SOFT_FLOOR_M).mean()) + ankles.min()
    hips = 0.5 * (points[5] + points[6])
    place = CIRCLE_RADIUS_M * np.array([np.sin(turned), -np.cos(turned)])
    position = np.array([*(place - hips[:2]), ANKLE_HEIGHT * body.stature - lowest])
    return Pose.from_angles(position, R_world_torso, angles)


def _angles(**left: float) -> Array:
    """Angles of both sides from the left side's (and the neck's): the right side mirrors it."""
    angles = np.zeros(18)
    for name, value in left.items():
        angles[ANGLE_NAMES.index(name if name.startswith("neck") else f"left_{name}")] = value
    mirrored = mirror_angles(angles)
    right = np.array([name.startswith("right") for name in ANGLE_NAMES])
    return np.where(right, mirrored, angles)


def _left(name: str) -> int:
    return ANGLE_NAMES.index(f"left_{name}")


def _right(name: str) -> int:
    return ANGLE_NAMES.index(f"right_{name}")


_STANDING = _angles(shoulder_x=-np.pi / 2 + 0.16, shoulder_z=-0.05, shoulder_y=0.25, elbow=-0.28, hip_x=0.04,
                    hip_y=-0.10, knee=0.16)  # fmt: skip


def _walking(t: float) -> Array:
    angles = _STANDING.copy()
    for phase, leg, arm in ((0.0, _left, _right), (np.pi, _right, _left)):
        swing = 2 * np.pi * STEP_HZ * t + phase
        angles[leg("hip_y")] = -0.22 - 0.38 * np.sin(swing)
        angles[leg("knee")] = 0.18 + 0.85 * (0.5 + 0.5 * np.cos(swing + 0.5)) ** 2
        angles[arm("shoulder_z")] = -0.05 - 0.42 * np.sin(swing)
        angles[arm("elbow")] = -0.45 - 0.25 * np.sin(swing)
    angles[0] = 0.05 * np.sin(2 * np.pi * 0.4 * t)
    angles[1] = 0.06 + 0.04 * np.sin(4 * np.pi * STEP_HZ * t)
    return angles


def _walking_lean(t: float) -> Array:
    swing = 2 * np.pi * STEP_HZ * t
    return np.array([0.03 * np.sin(swing), 0.05, -0.10 * np.sin(swing)])


def _raising_arms(t: float) -> Array:
    lift = 0.5 - 0.5 * np.cos(2 * np.pi * 0.5 * t)
    bend = -0.25 - 0.5 * lift * (1 - lift)
    angles = _angles(shoulder_x=-1.2 + 2.1 * lift, shoulder_z=-0.12, shoulder_y=0.2, elbow=bend, hip_x=0.05,
                     hip_y=-0.12, knee=0.2, neck_y=-0.12 * lift)  # fmt: skip
    for phase, leg in ((0.0, _left), (np.pi, _right)):  # stepping on the spot
        step = (0.5 + 0.5 * np.cos(2 * np.pi * STEP_HZ * t + phase)) ** 2
        angles[leg("hip_y")] -= 0.45 * step
        angles[leg("knee")] += 0.75 * step
    return angles


def _squatting(t: float) -> Array:
    depth = 0.5 - 0.5 * np.cos(2 * np.pi * 0.5 * t)
    return _angles(shoulder_x=-np.pi / 2 + 0.2, shoulder_z=-0.15 - 1.05 * depth, shoulder_y=0.2, elbow=-0.3,
                   hip_x=0.12, hip_y=-0.15 - 1.35 * depth, hip_z=0.15 * depth, knee=0.2 + 1.35 * depth,
                   neck_y=-0.15 * depth)  # fmt: skip


def _squatting_lean(t: float) -> Array:
    depth = 0.5 - 0.5 * np.cos(2 * np.pi * 0.5 * t)
    return np.array([0.0, 0.05 + 0.45 * depth, 0.0])


def _turning(t: float) -> Array:
    """The torso turns over standing feet: the thighs turn back about themselves; one arm reaches, then the other."""
    side = np.sin(2 * np.pi * 0.4 * t)
    angles = _angles(shoulder_x=-0.75, shoulder_z=-0.35, shoulder_y=0.35, elbow=-1.1, hip_x=0.06, hip_y=-0.15,
                     knee=0.25)  # fmt: skip
    angles[[_left("hip_z"), _right("hip_z")]] = -0.45 * side
    angles[_left("elbow")] += 0.6 * side
    angles[_right("elbow")] -= 0.6 * side
    angles[_left("shoulder_z")] -= 0.35 * side
    angles[_right("shoulder_z")] += 0.35 * side
    angles[0] = 0.12 * side
    return angles


def _turning_lean(t: float) -> Array:
    return np.array([0.0, 0.08, 0.45 * np.sin(2 * np.pi * 0.4 * t)])


_TOUR = (
    _Activity(2.6, _walking, walking=1.0, lean=_walking_lean),
    _Activity(2.4, _raising_arms),
    _Activity(2.4, _squatting, lean=_squatting_lean),
    _Activity(2.4, _turning, lean=_turning_lean),
)
