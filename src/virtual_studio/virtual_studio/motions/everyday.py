"""Walking, turning, running, and a tour that also raises the arms and squats."""

from __future__ import annotations

import numpy as np

from ..people import VolumetricBody
from .timeline import STAND_S, Activity, Array, Timeline, both_sides, hold, left, right, stance

STEP_HZ = 0.85
"""Full walking cycles (two steps) per second."""
AWAY_RAD = -0.28
"""Heading of the way out: between two cameras of the studio's rings."""
TURN_S, AWAY_S = 1.5, 3.0
RUN_HZ, RUN_RAD_S = 1.5, 2.6

STANDING = both_sides(
    shoulder_x=-np.pi / 2 + 0.16, shoulder_z=-0.05, shoulder_y=0.25, elbow=-0.28, hip_x=0.04, hip_y=-0.10, knee=0.16
)


def walking(t: float) -> Array:
    """Stance (24,) of a walk at time t, s."""
    angles = STANDING.copy()
    for phase, leg, arm in ((0.0, left, right), (np.pi, right, left)):
        swing = 2 * np.pi * STEP_HZ * t + phase
        angles[leg("hip_y")] = -0.22 - 0.38 * np.sin(swing)
        angles[leg("knee")] = 0.18 + 0.85 * (0.5 + 0.5 * np.cos(swing + 0.5)) ** 2
        angles[arm("shoulder_z")] = -0.05 - 0.42 * np.sin(swing)
        angles[arm("elbow")] = -0.45 - 0.25 * np.sin(swing)
    angles[0] = 0.05 * np.sin(2 * np.pi * 0.4 * t)
    angles[1] = 0.06 + 0.04 * np.sin(4 * np.pi * STEP_HZ * t)
    swing = 2 * np.pi * STEP_HZ * t
    return stance(angles, (0.03 * np.sin(swing), 0.05, -0.10 * np.sin(swing)), walking=1.0)


def _raising_arms(t: float) -> Array:
    lift = 0.5 - 0.5 * np.cos(2 * np.pi * 0.5 * t)
    bend = -0.25 - 0.5 * lift * (1 - lift)
    angles = both_sides(
        shoulder_x=-1.2 + 2.1 * lift,
        shoulder_z=-0.12,
        shoulder_y=0.2,
        elbow=bend,
        hip_x=0.05,
        hip_y=-0.12,
        knee=0.2,
        neck_y=-0.12 * lift,
    )
    _step_on_spot(angles, t, 0.45, 0.75)
    return stance(angles)


def _step_on_spot(angles: Array, t: float, hip: float, knee: float) -> None:
    """Lifts one leg after the other: bends hip and knee in angles (18,) by given angles, rad."""
    for phase, leg in ((0.0, left), (np.pi, right)):
        step = (0.5 + 0.5 * np.cos(2 * np.pi * STEP_HZ * t + phase)) ** 2
        angles[leg("hip_y")] -= hip * step
        angles[leg("knee")] += knee * step


def _squatting(t: float) -> Array:
    depth = 0.5 - 0.5 * np.cos(2 * np.pi * 0.5 * t)
    angles = both_sides(
        shoulder_x=-np.pi / 2 + 0.2,
        shoulder_z=-0.15 - 1.05 * depth,
        shoulder_y=0.2,
        elbow=-0.3,
        hip_x=0.12,
        hip_y=-0.15 - 1.35 * depth,
        hip_z=0.15 * depth,
        knee=0.2 + 1.35 * depth,
        neck_y=-0.15 * depth,
    )
    return stance(angles, (0.0, 0.05 + 0.45 * depth, 0.0))


def _turning(t: float) -> Array:
    """The torso turns over standing feet: the thighs turn back about themselves; one arm reaches, then the other."""
    side = np.sin(2 * np.pi * 0.4 * t)
    angles = both_sides(
        shoulder_x=-0.75, shoulder_z=-0.35, shoulder_y=0.35, elbow=-1.1, hip_x=0.06, hip_y=-0.15, knee=0.25
    )
    angles[[left("hip_z"), right("hip_z")]] = -0.45 * side
    angles[left("elbow")] += 0.6 * side
    angles[right("elbow")] -= 0.6 * side
    angles[left("shoulder_z")] -= 0.35 * side
    angles[right("shoulder_z")] += 0.35 * side
    angles[0] = 0.12 * side
    return stance(angles, (0.0, 0.08, 0.45 * np.sin(2 * np.pi * 0.4 * t)))


TOUR = Timeline(
    (
        Activity(2.6, walking, own_clock=False),
        Activity(2.4, _raising_arms, own_clock=False),
        Activity(2.4, _squatting, own_clock=False),
        Activity(2.4, _turning, own_clock=False),
    )
)
"""T-pose, then walking in a circle, raising the arms, a squat, turning the torso, and round again."""
WALK = Timeline((Activity(1e9, walking, own_clock=False),))
"""T-pose, then walking in a circle to the end."""
T_POSE_ONLY = Timeline((), t_pose_s=np.inf)
"""Standing still in the T-pose."""


def turn(angle: float, duration_s: float) -> Activity:
    """Turns on the spot, stepping, to the left if positive."""
    return Activity(duration_s, lambda t: stance(stepping(t), turning=angle / duration_s))


def turn_on_spot(person: VolumetricBody) -> Timeline:
    """Turns twice to the left, stepping, in five seconds."""
    return Timeline((hold(STAND_S, STANDING), turn(4 * np.pi, 5.0), hold(0.8, STANDING)))


def leave_and_return(person: VolumetricBody) -> Timeline:
    """Walks out of the volume, turns there, walks back in, and turns to where it began."""
    out, way, around = turn(AWAY_RAD, TURN_S), Activity(AWAY_S, walking), turn(np.pi, TURN_S)
    back = turn(-np.pi - AWAY_RAD, TURN_S)
    return Timeline((hold(STAND_S, STANDING), out, way, around, way, back, hold(1.2, STANDING)))


def run(person: VolumetricBody) -> Timeline:
    """Runs in a circle."""
    return Timeline((hold(STAND_S, STANDING), Activity(6.0, _running)))


def stepping(t: float) -> Array:
    """Angles (18,) of steps on the spot at time t, s."""
    angles = STANDING.copy()
    _step_on_spot(angles, t, 0.35, 0.60)
    return angles


def _running(t: float) -> Array:
    angles = both_sides(shoulder_x=-np.pi / 2 + 0.35, shoulder_y=0.1, hip_x=0.04)
    for phase, leg, arm in ((0.0, left, right), (np.pi, right, left)):
        swing = 2 * np.pi * RUN_HZ * t + phase
        angles[leg("hip_y")] = -0.26 - 0.30 * np.sin(swing) - 0.30 * (0.5 + 0.5 * np.cos(swing)) ** 2
        angles[leg("knee")] = 0.25 + 1.35 * (0.5 + 0.5 * np.cos(swing + 0.4)) ** 2
        angles[arm("shoulder_z")] = 0.05 - 0.60 * np.sin(swing)
        angles[arm("elbow")] = -1.45 - 0.20 * np.sin(swing)
    swing = 2 * np.pi * RUN_HZ * t
    return stance(angles, (-0.10 + 0.03 * np.sin(swing), 0.12, -0.14 * np.sin(swing)), turning=RUN_RAD_S)
