"""Motions of the built-in person, by name: each starts in the T-pose and comes with exact truth.

A timeline of activities becomes a sequence of poses in one of two ways: with the hips on a small circle, or carried
by the feet, which stay where they stand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from capture_rig.rigid import rotation_matrix
from stick_figure.body import TYPICAL_STATURE_M, Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose

from ..people import ANKLE_HEIGHT, VolumetricBody
from . import everyday, hard_cases
from .timeline import (
    ANGLES,
    FADE_S,
    LEAN,
    LIFT,
    T_POSE_S,
    TURNING,
    WALKING,
    Array,
    Motion,
    Things,
    Timeline,
    frame_count,
)

CIRCLE_RADIUS_M = 0.30
CIRCLE_RAD_S = 0.9
STEPS_GRID_HZ = 120.0
"""Step of the time integral of steps; as fine as frame rates, so that truth does not depend on fps."""
GRID_HZ = 4 * STEPS_GRID_HZ
"""The same along the circle, where an instant takes less time to compute."""
WEIGHT_SHIFT_S = 0.05
"""Smoothing of the torso's speed: time in which the weight passes from foot to foot, with some sliding of the feet."""
OVERRUN_S = 5 * WEIGHT_SHIFT_S
"""Time by which the steps continue past the end, so that the smoothing does not reach it."""
HEIGHT_SMOOTHING_S = 0.5 * WEIGHT_SHIFT_S
"""Smoothing of its height: feet may sink by millimetres where one takes over from the other."""
SOFT_FLOOR_M = 0.01
"""Width of the soft minimum of the contact spheres' heights: smoothness of the change of the standing foot."""

MotionFunction = Callable[..., Motion]
"""(body, seconds, fps) and optionally the build (`VolumetricBody`) to a motion."""


@dataclass(frozen=True)
class HardCase:
    """A motion that trackers are known to fail at; the feet stay where they stand.

    activities: of a person of given sizes; start_xy: first place of the torso, m; things: that fit a motion from its
    beginning to its end; cut_s: time cut off the end, where the last activity fades into the first.
    """

    activities: Callable[[VolumetricBody], Timeline]
    start_xy: tuple[float, float] = (0.0, 0.0)
    things: Callable[[VolumetricBody, Motion], Things] | None = None
    cut_s: float = 0.0

    def __call__(self, body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
        person = VolumetricBody(body, build)
        timeline = self.activities(person)
        motion = motion_by_steps(person, seconds, fps, timeline, self.start_xy)
        if self.things is None:
            return motion
        whole = motion  # too short a one does not determine the places of the things
        if len(motion.poses) < round(self.duration_s * fps):
            whole = motion_by_steps(person, self.duration_s, fps, timeline, self.start_xy)
        return replace(motion, things=self.things(person, whole))

    @property
    def duration_s(self) -> float:
        """Seconds from the T-pose through all activities once."""
        activities = self.activities(VolumetricBody(Body.from_stature(TYPICAL_STATURE_M))).activities
        return T_POSE_S + sum(activity.duration_s for activity in activities) - self.cut_s


def motion_on_circle(body: Body, seconds: float, fps: float, build: float = 1.0, *, timeline: Timeline) -> Motion:
    """Moves the hips along a small circle as far as the activities walk (feet slide a little)."""
    times = np.arange(frame_count(seconds, fps)) / fps
    grid = np.arange(int(np.ceil(times[-1] * GRID_HZ)) + 2) / GRID_HZ
    turned = np.interp(times, grid, _integral([CIRCLE_RAD_S * timeline.at(t)[WALKING] for t in grid], GRID_HZ))
    blends = [timeline.at(t) for t in times]
    poses = tuple(_on_circle(body, blend, turn) for blend, turn in zip(blends, turned, strict=True))
    return Motion(poses, np.array([blend[ANGLES] for blend in blends]), fps)


def motion_by_steps(
    person: VolumetricBody, seconds: float, fps: float, timeline: Timeline, start_xy: tuple[float, float]
) -> Motion:
    """Moves the body by its feet: the lowest parts stay where they touch the floor.

    start_xy: where the torso's centre begins, m; it faces +x.
    """
    times = np.arange(frame_count(seconds, fps)) / fps
    grid = np.arange(int(np.ceil((times[-1] + OVERRUN_S) * STEPS_GRID_HZ)) + 2) / STEPS_GRID_HZ
    instants = [timeline.at(t) for t in grid]
    headings = _integral([blend[TURNING] for blend in instants], STEPS_GRID_HZ)
    supports = [_Support(person, blend, heading) for blend, heading in zip(instants, headings, strict=True)]
    steps = np.array([np.zeros(2), *(before.step_to(after) for before, after in pairwise(supports))])
    path = np.array(start_xy) + np.cumsum(gaussian_filter1d(steps, WEIGHT_SHIFT_S * STEPS_GRID_HZ, axis=0), axis=0)
    heights = gaussian_filter1d([support.height for support in supports], HEIGHT_SMOOTHING_S * STEPS_GRID_HZ)
    blends = [timeline.at(t) for t in times]
    turned = np.interp(times, grid, headings)
    places = np.column_stack([np.interp(times, grid, column) for column in (*path.T, heights)])
    poses = tuple(
        Pose.from_angles(place, _rotation(blend, heading), blend[ANGLES])
        for blend, heading, place in zip(blends, turned, places, strict=True)
    )
    return Motion(poses, np.array([blend[ANGLES] for blend in blends]), fps)


class _Support:
    """Contacts of a pose with its torso's centre at the origin.

    height: of the torso's centre when the lowest contact sphere is on the floor, m; xy (c, 2) m of the contact
    spheres; weights (c,) share of the body that each carries, all zero in the air.
    """

    def __init__(self, person: VolumetricBody, blend: Array, heading: float) -> None:
        pose = Pose.from_angles(np.zeros(3), _rotation(blend, heading), blend[ANGLES])
        centres, radii = person.contact_spheres(pose)
        heights = centres[:, 2] - radii
        weights = np.exp(-(heights - heights.min()) / SOFT_FLOOR_M)
        weights /= weights.sum()
        self.height = -float(weights @ heights) + blend[LIFT]
        self.xy = centres[:, :2]
        self.weights = weights if blend[LIFT] == 0.0 else np.zeros_like(weights)

    def step_to(self, after: _Support) -> Array:
        """Displacement (2,) of the torso's centre, m, while the carrying spheres stand still."""
        return -0.5 * (self.weights + after.weights) @ (after.xy - self.xy)


def _on_circle(body: Body, blend: Array, turned: float) -> Pose:
    """Return the pose with its lower foot on the floor, on the circle (start: facing +x, right of the centre)."""
    R_world_torso = _rotation(blend, turned)
    points = forward(body, Pose.from_angles(np.zeros(3), R_world_torso, blend[ANGLES]))
    ankles = points[13:15, 2]
    lowest = -SOFT_FLOOR_M * np.log(np.exp(-(ankles - ankles.min()) / SOFT_FLOOR_M).mean()) + ankles.min()
    hips = 0.5 * (points[5] + points[6])
    place = CIRCLE_RADIUS_M * np.array([np.sin(turned), -np.cos(turned)])
    position = np.array([*(place - hips[:2]), ANKLE_HEIGHT * body.stature - lowest])
    return Pose.from_angles(position, R_world_torso, blend[ANGLES])


def _rotation(blend: Array, heading: float) -> Array:
    """R_world_torso (3, 3)."""
    return rotation_matrix(np.array([0.0, 0.0, heading])) @ rotation_matrix(blend[LEAN])


def _integral(speeds: list[float], rate_hz: float) -> Array:
    """Integral of speeds sampled at a rate, from 0 (trapezium rule)."""
    values = np.array(speeds)
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) / rate_hz)])


tour = partial(motion_on_circle, timeline=everyday.TOUR)
"""Takes the T-pose, then walks in a circle, raises the arms, squats, turns the torso, and begins again."""
walk = partial(motion_on_circle, timeline=everyday.WALK)
"""Takes the T-pose, then walks in a circle to the end."""
t_pose_only = partial(motion_on_circle, timeline=everyday.T_POSE_ONLY)
"""Stands still in the T-pose."""
HARD_CASES: Mapping[str, HardCase] = {
    "arm_on_chest": HardCase(hard_cases.arm_on_chest),
    "hands_clasped": HardCase(hard_cases.hands_clasped),
    "hands_on_hips": HardCase(hard_cases.hands_on_hips),
    "crossed_legs": HardCase(hard_cases.crossed_legs),
    "squat": HardCase(hard_cases.squat),
    "sitting": HardCase(hard_cases.sitting),
    "bow": HardCase(hard_cases.bow),
    "turn_on_spot": HardCase(everyday.turn_on_spot),
    "leave_and_return": HardCase(everyday.leave_and_return),
    "run": HardCase(everyday.run, start_xy=(0.0, -0.3)),
    "jump": HardCase(hard_cases.jump),
    "kick": HardCase(hard_cases.kick),
    "punch": HardCase(hard_cases.punch),
    "lie_down": HardCase(hard_cases.lie_down, start_xy=(0.4, 0.0)),
    "kneeling": HardCase(hard_cases.kneeling),
    "on_a_chair": HardCase(hard_cases.sitting, things=hard_cases.chair),
    "carry_a_box": HardCase(
        hard_cases.carry_a_box, start_xy=(-0.3, 0.0), things=hard_cases.box_on_a_stand, cut_s=FADE_S
    ),
}

MOTIONS: Mapping[str, MotionFunction] = {"tour": tour, "walk": walk, "t_pose_only": t_pose_only, **HARD_CASES}
