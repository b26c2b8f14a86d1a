"""What the built-in person does, by name: motions with exact truth, every one of which starts in the T-pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.rotations import rotation_matrix

from ..people import ANKLE_HEIGHT, VolumetricBody
from . import everyday
from . import everyday as travelling
from . import hard_cases as crossing
from . import hard_cases as fast
from . import hard_cases as on_the_floor
from . import hard_cases as touching
from .timeline import T_POSE_S, Array, BlendedActivity, Motion, Timeline, frame_count

# --- Where the body is in the room: on a circle, or where its feet have carried it.

CIRCLE_RADIUS_M = 0.30
CIRCLE_RAD_S = 0.9
GRID_HZ = 480.0
"""Step of the time integral along the circle; finer than any frame rate, so that truth does not depend on fps."""
STEPS_GRID_HZ = 120.0
"""The same for steps."""
GIVE_S = 0.05
"""Over how long a body passes its weight from foot to foot: smooths the torso's speed, the feet slide that much."""
BEYOND_S = 0.25
"""How far the steps are played on past the end, so that the smoothing does not see it."""
KNEE_GIVE_S = 0.025
"""The same for its height: feet may sink by millimetres where one takes over from the other."""
SOFT_FLOOR_M = 0.01
"""How smoothly the standing foot changes: width of the soft minimum of the heights of what may touch the floor."""


def motion_on_circle(body: Body, seconds: float, fps: float, timeline: Timeline) -> Motion:
    """The motion with its hips on a small circle, moved on as far as the activities walk (feet slide a little)."""
    times = np.arange(frame_count(seconds, fps)) / fps
    turned = np.interp(times, *_turned_angle(times[-1], timeline))
    mixtures = [timeline.at(t) for t in times]
    poses = tuple(_on_circle(body, mixture, turn) for mixture, turn in zip(mixtures, turned, strict=True))
    return Motion(poses, np.array([mixture.angles for mixture in mixtures]), fps)


def motion_by_steps(
    person: VolumetricBody, seconds: float, fps: float, timeline: Timeline, start_xy: tuple[float, float]
) -> Motion:
    """The motion of somebody whose lowest parts stay where they touch the floor: feet carry the body about.

    start_xy: where the torso's centre begins, m; it faces +x.
    """
    times = np.arange(frame_count(seconds, fps)) / fps
    grid = np.arange(int(np.ceil((times[-1] + BEYOND_S) * STEPS_GRID_HZ)) + 2) / STEPS_GRID_HZ
    headings = _integral([timeline.at(t).turning for t in grid], STEPS_GRID_HZ)
    supports = [_Support(person, timeline.at(t), heading) for t, heading in zip(grid, headings, strict=True)]
    steps = np.array([np.zeros(2), *map(_step, supports[:-1], supports[1:])])
    path = np.array(start_xy) + np.cumsum(gaussian_filter1d(steps, GIVE_S * STEPS_GRID_HZ, axis=0), axis=0)
    heights = gaussian_filter1d([support.height for support in supports], KNEE_GIVE_S * STEPS_GRID_HZ)
    mixtures = [timeline.at(t) for t in times]
    turned = np.interp(times, grid, headings)
    places = np.column_stack([np.interp(times, grid, column) for column in (*path.T, heights)])
    poses = tuple(
        Pose.from_angles(place, _rotation(mixture, heading), mixture.angles)
        for mixture, heading, place in zip(mixtures, turned, places, strict=True)
    )
    return Motion(poses, np.array([mixture.angles for mixture in mixtures]), fps)


class _Support:
    """What a pose with its torso's centre at the origin rests on.

    height: of the torso's centre when the lowest touchpoint is on the floor, m; xy (c, 2) m of the contact_spheres;
    weights (c,) how much of the body each carries, all zero in the air.
    """

    def __init__(self, person: VolumetricBody, mixture: BlendedActivity, heading: float) -> None:
        pose = Pose.from_angles(np.zeros(3), _rotation(mixture, heading), mixture.angles)
        centres, radii = person.contact_spheres(pose)
        heights = centres[:, 2] - radii
        weights = np.exp(-(heights - heights.min()) / SOFT_FLOOR_M)
        weights /= weights.sum()
        self.height = -float(weights @ heights) + mixture.lift
        self.xy = centres[:, :2]
        self.weights = weights if mixture.lift == 0.0 else np.zeros_like(weights)


def _step(before: _Support, after: _Support) -> Array:
    """Way (2,) of the torso's centre, m, while what carries the body stays where it is."""
    return -0.5 * (before.weights + after.weights) @ (after.xy - before.xy)


def _on_circle(body: Body, mixture: BlendedActivity, turned: float) -> Pose:
    """The pose with its lower foot on the floor, at its place on the circle (start: facing +x, right of the centre)."""
    R_world_torso = _rotation(mixture, turned)
    points = forward(body, Pose.from_angles(np.zeros(3), R_world_torso, mixture.angles))
    ankles = points[13:15, 2]
    lowest = -SOFT_FLOOR_M * np.log(np.exp(-(ankles - ankles.min()) / SOFT_FLOOR_M).mean()) + ankles.min()
    hips = 0.5 * (points[5] + points[6])
    place = CIRCLE_RADIUS_M * np.array([np.sin(turned), -np.cos(turned)])
    position = np.array([*(place - hips[:2]), ANKLE_HEIGHT * body.stature - lowest])
    return Pose.from_angles(position, R_world_torso, mixture.angles)


def _rotation(mixture: BlendedActivity, heading: float) -> Array:
    """R_world_torso (3, 3)."""
    return rotation_matrix(np.array([0.0, 0.0, heading])) @ rotation_matrix(mixture.lean)


def _turned_angle(end: float, timeline: Timeline) -> tuple[Array, Array]:
    """Times and the angle walked along the circle by then, rad."""
    times = np.arange(int(np.ceil(end * GRID_HZ)) + 2) / GRID_HZ
    return times, _integral([CIRCLE_RAD_S * timeline.at(t).walking for t in times], GRID_HZ)


def _integral(speeds: list[float], rate_hz: float) -> Array:
    """Integral of speeds sampled at a rate, from 0 (trapezium rule)."""
    values = np.array(speeds)
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) / rate_hz)])


__all__ = ["HARD_CASES", "MOTIONS", "T_POSE_S", "HardCase", "Motion", "t_pose_only", "tour", "walk"]

MotionFunction = Callable[..., Motion]
"""(body, seconds, fps) and optionally the build (`VolumetricBody`) to a motion."""


def tour(body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
    """T-pose, then walking in a circle, raising the arms, a squat, turning the torso, and round again."""
    return motion_on_circle(body, seconds, fps, everyday.TOUR)


def walk(body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
    """T-pose, then walking in a circle to the end."""
    return motion_on_circle(body, seconds, fps, everyday.WALK)


def t_pose_only(body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
    """Standing still in the T-pose."""
    return motion_on_circle(body, seconds, fps, everyday.T_POSE_ONLY)


@dataclass(frozen=True)
class HardCase:
    """A motion that trackers are known to fail at; the feet of whoever does it stay where they stand.

    script: the activities of a person; start_xy: where that person's torso begins, m.
    """

    script: Callable[[VolumetricBody], Timeline]
    start_xy: tuple[float, float] = (0.0, 0.0)

    def __call__(self, body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
        person = VolumetricBody(body, build)
        return motion_by_steps(person, seconds, fps, self.script(person), self.start_xy)

    @property
    def duration_s(self) -> float:
        """Seconds from the T-pose through all activities once."""
        return T_POSE_S + sum(a.duration_s for a in self.script(VolumetricBody(Body.from_stature(1.75))).activities)


HARD_CASES: Mapping[str, HardCase] = {
    "arm_on_chest": HardCase(touching.arm_on_chest),
    "hands_clasped": HardCase(touching.hands_clasped),
    "hands_on_hips": HardCase(touching.hands_on_hips),
    "crossed_legs": HardCase(crossing.crossed_legs),
    "squat": HardCase(crossing.squat),
    "sitting": HardCase(crossing.sitting),
    "bow": HardCase(crossing.bow),
    "turn_on_spot": HardCase(travelling.turn_on_spot),
    "leave_and_return": HardCase(travelling.leave_and_return),
    "run": HardCase(travelling.run, start_xy=(0.0, -0.3)),
    "jump": HardCase(fast.jump),
    "kick": HardCase(fast.kick),
    "punch": HardCase(fast.punch),
    "lie_down": HardCase(on_the_floor.lie_down, start_xy=(0.4, 0.0)),
}

MOTIONS: Mapping[str, MotionFunction] = {"tour": tour, "walk": walk, "t_pose_only": t_pose_only, **HARD_CASES}
