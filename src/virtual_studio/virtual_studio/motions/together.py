"""Motions of several persons together: pass each other, shake hands, hug and part; come later, leave and come back.

Feet stay where they stand, as in the hard cases. The length of a step depends on the legs, so that walks last as long
as each person needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from capture_rig.rigid import rotation_matrix
from stick_figure.skeleton import L_CALF, L_THIGH, T_POSE_ANGLES, TORSO

from ..people import VolumetricBody
from . import everyday
from .catalogue import motion_by_steps
from .everyday import STANDING, walking
from .timeline import (
    ARM,
    FADE_S,
    STAND_S,
    T_POSE_S,
    Activity,
    Array,
    Motion,
    Timeline,
    hold,
    key_postures,
    legs,
    posture,
    reaching,
    with_left,
    with_right,
)

GREET_S = 0.7
HANDSHAKE_M, HUG_M = 0.92, 0.26
"""Between the torsos' axes."""
HAND_HEIGHT_M = 1.02
SHAKE_M, SHAKE_HZ = 0.04, 2.0
APART_X_M, APART_Y_M = 0.75, 0.25
"""Half of the distance of two people who pass each other, along their way and across it."""
MIDDLE = np.array([APART_X_M, APART_Y_M])
"""Halfway between the two, as each of them sees it from the start."""
BACK_M = 0.45
APPROACH_STEPS = 6
"""Bisections of a walk's duration: to a few centimetres."""
BESIDE_M = 0.95
PROBES_S, PROBE_HZ = (0.0, 0.4, 0.7, 1.0, 1.5, 2.0, 4.0), 10.0
"""Durations (s) of sample walks, from which the duration for a way is interpolated."""
CROWD_M = 0.75
"""How far from the middle each of four people stands: one of them can hold out the arms without touching another."""
TURN_S = 1.7
CROWD = ((CROWD_M, 0.0), np.pi), ((-CROWD_M, 0.0), 0.0), ((0.0, CROWD_M), -np.pi / 2), ((0.0, -CROWD_M), np.pi / 2)
"""Where each of them stands, m, and faces, rad: inward."""
OUTSIDE_M = 2.4
"""Distance from the volume's middle of somebody who is not in it yet."""


@dataclass(frozen=True)
class Role:
    """The part of one of the persons.

    activities : of a person of given sizes. start_xy m, heading rad : place and heading of the torso at the start.
    """

    activities: Callable[[VolumetricBody], Timeline]
    start_xy: tuple[float, float]
    heading: float = 0.0

    def motion(self, person: VolumetricBody, seconds: float, fps: float) -> Motion:
        motion = motion_by_steps(person, seconds, fps, self.activities(person), (0.0, 0.0))
        R, start = rotation_matrix(np.array([0.0, 0.0, self.heading])), np.array([*self.start_xy, 0.0])
        poses = (
            replace(pose, position_world=R @ pose.position_world + start, R_world_torso=R @ pose.R_world_torso)
            for pose in motion.poses
        )
        return replace(motion, poses=tuple(poses))


@dataclass(frozen=True)
class Ensemble:
    """Roles of several persons, and their duration (s)."""

    roles: tuple[Role, ...]
    seconds: float

    def motions(self, persons: Sequence[VolumetricBody], fps: float, seconds: float | None = None) -> list[Motion]:
        """Return one motion a person; ValueError unless there is one for every role."""
        pairs = zip(self.roles, persons, strict=True)
        return [role.motion(person, seconds or self.seconds, fps) for role, person in pairs]


def meeting(person: VolumetricBody) -> Timeline:
    """Passes the other one closely, turns round, shakes hands, hugs, and walks backward again."""
    done = [hold(STAND_S, STANDING), walk(person, 2.0 * APART_X_M)]
    place, heading = _end_of(person, done)
    ahead = MIDDLE - place
    done.append(turn((float(np.arctan2(ahead[1], ahead[0])) - heading) % (2.0 * np.pi)))
    for apart_m, greeting in ((HANDSHAKE_M, shaking_hands), (HUG_M, hugging)):
        done += [_approach(person, done, 0.5 * apart_m), greeting(person)]
    return Timeline((*done, walk(person, -BACK_M), hold(2.0, STANDING)))


def coming_later(person: VolumetricBody) -> Timeline:
    """Stands outside while others are tracked, walks in, takes the T-pose, leaves, and comes back."""
    inward, around = walk(person, OUTSIDE_M - BESIDE_M), turn(np.pi)
    shown = hold(2.2, T_POSE_ANGLES)
    return Timeline((hold(1.5, STANDING), inward, shown, around, inward, around, inward, hold(2.0, STANDING)))


def staying(person: VolumetricBody) -> Timeline:
    """Steps on the spot and turns, while somebody else comes and goes."""
    return Timeline((hold(STAND_S, STANDING), turn(2.0 * np.pi), hold(1.0, STANDING)))


def one_after_another(person: VolumetricBody, number: int) -> Timeline:
    """Holds the T-pose at this person's turn, from 0; when all four have, turns round, steps in and back again."""
    before, after = hold(0.6 + TURN_S * number, STANDING), hold(TURN_S * (3 - number), STANDING)
    steps = turn(2.0 * np.pi), walk(person, 0.2), walk(person, -0.2), hold(1.0, STANDING)
    return Timeline((before, hold(TURN_S, T_POSE_ANGLES), after, *steps), t_pose_s=0.0)


def going_first(person: VolumetricBody) -> Timeline:
    """Leaves soon, stays away for some seconds, and comes back."""
    way, around = walk(person, OUTSIDE_M - 0.5), turn(np.pi)
    return Timeline((hold(STAND_S, STANDING), way, around, hold(1.5, STANDING), way, around, hold(3.0, STANDING)))


TOGETHER: Mapping[str, Ensemble] = {
    "meeting": Ensemble((Role(meeting, (-APART_X_M, -APART_Y_M)), Role(meeting, (APART_X_M, APART_Y_M), np.pi)), 15.2),
    "coming_later": Ensemble((Role(staying, (-0.55, 0.0)), Role(coming_later, (OUTSIDE_M, 0.0), np.pi)), 16.8),
    "going_first": Ensemble((Role(going_first, (0.5, -0.3)), Role(staying, (-0.6, 0.3))), 14.0),
    "crowd": Ensemble(tuple(Role(partial(one_after_another, number=k), *place) for k, place in enumerate(CROWD)), 14.0),
}


def walk(person: VolumetricBody, way_m: float) -> Activity:
    """Walks a distance ahead, or backward if negative, from standing to standing."""
    duration_s = float(np.interp(abs(way_m), _ways(person), PROBES_S))
    if way_m >= 0.0:
        return Activity(duration_s, walking)
    return Activity(duration_s, lambda t: walking(-t))


def turn(angle: float) -> Activity:
    """Turns on the spot, stepping, to the left if positive."""
    return everyday.turn(angle, max(abs(angle) / 1.9, FADE_S))


def shaking_hands(person: VolumetricBody) -> Activity:
    """Holds out the right hand and shakes another one's."""
    s, height = person.scale, _torso_height(person)
    reach = 0.5 * HANDSHAKE_M + 0.03
    keys: list[tuple] = [(0.0, STANDING)]
    for number in range(7):
        up = SHAKE_M if number % 2 else -SHAKE_M
        arm = reaching(person.body, (reach, 0.0, HAND_HEIGHT_M + up - height), (0.1 * s, 0.35 * s, -0.3 * s))
        keys.append((GREET_S + number / (2.0 * SHAKE_HZ), with_right(STANDING, arm, ARM)))
    end_s = keys[-1][0] + GREET_S
    return key_postures(end_s, *keys, (end_s, STANDING))


def hugging(person: VolumetricBody) -> Activity:
    """Puts both arms round another one's shoulders, one above and one below, and lets go."""
    s, height = person.scale, _torso_height(person)
    high = reaching(person.body, (0.36 * s, -0.02 * s, 1.40 - height), (0.25 * s, 0.38 * s, 1.35 - height))
    low = reaching(person.body, (0.36 * s, -0.02 * s, 1.15 - height), (0.20 * s, 0.42 * s, 1.10 - height))
    arms = with_right(with_left(STANDING, low, ARM), high, ARM)
    out = posture(STANDING, reaching(person.body, (0.35 * s, 0.45 * s, 0.25 * s), (0.15 * s, 0.45 * s, 0.10 * s)))
    return key_postures(3.2, (0.0, STANDING), (0.5, out), (1.0, arms), (2.2, arms), (2.7, out), (3.2, STANDING))


def _torso_height(person: VolumetricBody) -> float:
    """Height (m) of the torso's centre of somebody who stands."""
    lengths, straight = person.body.lengths, float(np.cos(legs(0.1, 0.06)[0]))
    return person.ankle_height + straight * (lengths[L_THIGH] + lengths[L_CALF]) + 0.5 * lengths[TORSO]


def _approach(person: VolumetricBody, done: Sequence[Activity], near_m: float) -> Activity:
    """Return the walk that takes the person, after the activities so far, to a distance from the middle."""
    low_s, high_s = 0.2, 3.0
    for _ in range(APPROACH_STEPS):
        there = Activity(0.5 * (low_s + high_s), walking)
        place, heading = _end_of(person, [*done, there])
        arrived = (MIDDLE - place) @ np.array([np.cos(heading), np.sin(heading)]) < near_m
        low_s, high_s = (low_s, there.duration_s) if arrived else (there.duration_s, high_s)
    return Activity(low_s, walking)


def _end_of(person: VolumetricBody, activities: Sequence[Activity]) -> tuple[Array, float]:
    """Return place (2,) m and heading (rad) after the activities of somebody who begins at the origin, facing +x."""
    timeline = Timeline((*activities, hold(9.0, STANDING)))
    until_s = T_POSE_S + sum(activity.duration_s for activity in activities) + FADE_S
    last = motion_by_steps(person, until_s, PROBE_HZ, timeline, (0.0, 0.0)).poses[-1]
    return last.position_world[:2], float(np.arctan2(last.R_world_torso[1, 0], last.R_world_torso[0, 0]))


@lru_cache(maxsize=32)
def _ways(person: VolumetricBody) -> tuple[float, ...]:
    """How far (m) walks of PROBES_S take this person."""
    return tuple(float(_end_of(person, [hold(STAND_S, STANDING), Activity(s, walking)])[0][0]) for s in PROBES_S)
