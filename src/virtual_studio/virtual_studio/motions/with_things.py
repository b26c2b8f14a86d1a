"""Motions on the floor and with things: kneeling, sitting on a chair that hides legs, lifting a box and carrying it."""

from __future__ import annotations

import numpy as np

from stick_figure.kinematics import forward
from stick_figure.skeleton import L_THIGH

from ..people import Capsules, VolumetricBody
from .everyday import STANDING, stepping, walking, walking_lean
from .hard_cases import posture
from .timeline import (
    ARM,
    STAND_S,
    T_POSE_S,
    Activity,
    Array,
    Key,
    Motion,
    Things,
    Timeline,
    hold,
    key_postures,
    legs,
    reaching,
    with_left,
    with_right,
)

TOES_UNDER = 1.95
"""How far a kneeling person's calves lie behind the knees, rad from the vertical: heels up, as toes are bent under."""

WOOD, CARDBOARD = 0.30, 0.55
"""Albedos: a dark chair, a light box."""
BAR_M = 0.022
"""Radius of the bars that panels are made of; they overlap by a quarter."""
SEAT_DEPTH_M, SEAT_WIDTH_M, BACK_HEIGHT_M = 0.40, 0.44, 0.44
BEHIND_HIPS_M = 0.17
"""How far the back rest is behind the hips of somebody who leans on it."""
BACK_TILT_RAD = 0.28
KNEES_FREE_M = 0.08
"""How far the seat ends before the hollow of the knees."""

BOX_M = (0.30, 0.36, 0.28)
"""Depth, width and height."""
BENT_THIGHS, BENT_CALVES, BENT_RAD = 0.55, 0.30, 1.05
"""How legs and trunk are bent at the box, rad."""
PALM_M = 0.035
"""From the stick of a hand to what the palm touches."""
TIPS_AHEAD_M = 0.06
"""How far finger tips reach past the middle of the box."""
GRASP_S, LIFTED_S, PICKED_S = 1.3, 2.4, 3.0
"""Into picking up: hands at the box, box before the belly, and ready to go."""
APPROACH_S, TURN_S, CARRY_S = 1.1, 1.9, 1.2

LEFT_HAND, RIGHT_HAND, LEFT_HIP, RIGHT_HIP, LEFT_KNEE, RIGHT_KNEE = 11, 12, 5, 6, 9, 10


def kneeling(person: VolumetricBody) -> Timeline:
    """Gets down on both knees, toes under, sits on the heels, works on the floor before it, and gets up again."""
    s = person.scale
    arms = reaching(person.body, (0.36 * s, 0.20 * s, -0.15 * s), (0.15 * s, 0.35 * s, -0.20 * s))
    low = reaching(person.body, (0.55 * s, 0.16 * s, -0.28 * s), (0.30 * s, 0.38 * s, -0.15 * s))
    crouched = posture(legs(1.05, 0.85, 0.55, apart=0.12), arms), 0.55
    upright = posture(legs(0.10, TOES_UNDER, 0.05, apart=0.10), arms), 0.05
    working = posture(legs(0.45, TOES_UNDER, 0.75, apart=0.12), low), 0.75
    keys: list[tuple] = [
        (0.0, STANDING),
        (1.0, *crouched),
        (1.9, *upright),
        (2.8, *upright),
        (3.6, *working),
        (4.8, *working),
    ]
    keys += [(5.6, *upright), (6.5, *crouched), (7.4, STANDING)]
    return Timeline((hold(STAND_S, STANDING), key_postures([Key(*key) for key in keys], 8.0)))


def chair(person: VolumetricBody, motion: Motion) -> Things:
    """A closed chair, a box with a back, under somebody who sits down on it: where the thighs are when lowest."""
    points = np.array([forward(person.body, pose) for pose in motion.poses])
    hips = 0.5 * (points[:, LEFT_HIP] + points[:, RIGHT_HIP])
    frame = int(np.argmin(hips[:, 2]))
    seat = hips[frame] - [0.0, 0.0, _thigh_radius(person)]
    knees = 0.5 * (points[frame, LEFT_KNEE] + points[frame, RIGHT_KNEE])
    back, front = seat[0] - BEHIND_HIPS_M, min(knees[0] - KNEES_FREE_M, seat[0] - BEHIND_HIPS_M + SEAT_DEPTH_M)
    top, half = seat[2] - BAR_M, 0.5 * SEAT_WIDTH_M
    left, right = seat[1] + half, seat[1] - half
    panels = [
        _panel((back, left, top), (back, right, top), (front - back, 0.0, 0.0)),
        _panel((back, left, BAR_M), (back, right, BAR_M), (0.0, 0.0, top - BAR_M)),
        _panel((back, left, BAR_M), (front, left, BAR_M), (0.0, 0.0, top - BAR_M)),
        _panel((back, right, BAR_M), (front, right, BAR_M), (0.0, 0.0, top - BAR_M)),
    ]
    lean = np.tan(BACK_TILT_RAD) * BACK_HEIGHT_M
    panels.append(_panel((back, left, top), (back, right, top), (-lean, 0.0, BACK_HEIGHT_M)))
    return Things(_joined(panels, WOOD))


def carry_a_box(person: VolumetricBody) -> Timeline:
    """Walks to a box on a low stand, lifts it, turns round with it, and carries it away."""
    s, across = person.scale, 0.5 * BOX_M[1] + PALM_M
    low = reaching(person.body, (0.58 * s, across, -0.02 * s), (0.25 * s, 0.36 * s, 0.05 * s))
    held = reaching(person.body, (0.38 * s, across, -0.08 * s), (0.05 * s, 0.32 * s, -0.22 * s))
    wide = reaching(person.body, (0.55 * s, across + 0.10, -0.02 * s), (0.25 * s, 0.40 * s, 0.05 * s))
    down = legs(BENT_THIGHS, BENT_CALVES, BENT_RAD, apart=0.10)
    keys = [
        Key(0.0, STANDING),
        Key(0.9, posture(down, wide), BENT_RAD),
        Key(GRASP_S, posture(down, low), BENT_RAD),
        Key(LIFTED_S, _holding(STANDING, held)),
        Key(PICKED_S, _holding(STANDING, held)),
    ]

    def with_box(of: Array) -> Array:
        return _holding(of, held)

    turning = Activity(TURN_S, lambda t: with_box(stepping(t)), turning=np.pi / TURN_S)
    away = Activity(CARRY_S, lambda t: with_box(walking(t)), lean=walking_lean)
    lifting = key_postures(keys, PICKED_S)
    there = Activity(APPROACH_S, walking, lean=walking_lean)
    return Timeline((hold(STAND_S, STANDING), there, lifting, turning, away, hold(1.6, with_box(STANDING))))


def box_on_a_stand(person: VolumetricBody, motion: Motion) -> Things:
    """The box of `carry_a_box`, and the stand that it is on until the hands have it."""
    taken = round((T_POSE_S + STAND_S + APPROACH_S + GRASP_S) * motion.fps)
    places = [_between_the_hands(person, motion, frame) for frame in range(len(motion.poses))]
    places[:taken] = [places[taken]] * taken
    boxes = [_box(middle, heading) for middle, heading in places[taken:]]
    middle, heading = places[taken]
    under = middle[2] - 0.5 * BOX_M[2]
    stand = _box(np.array([*middle[:2], 0.5 * under]), heading, (0.26, 0.32, under), WOOD)
    return Things(stand, tuple([boxes[0]] * taken + boxes), taken)


def _thigh_radius(person: VolumetricBody) -> float:
    """Radius (m) of the upper end of a thigh."""
    return float(person.radii_of(L_THIGH).max())


def _holding(angles: Array, arms: Array) -> Array:
    return with_right(with_left(angles, arms, ARM), arms, ARM)


def _between_the_hands(person: VolumetricBody, motion: Motion, frame: int) -> tuple[Array, float]:
    """Middle (3,) m and heading (rad) of a box in both hands."""
    pose = motion.poses[frame]
    points = forward(person.body, pose)
    heading = float(np.arctan2(pose.R_world_torso[1, 0], pose.R_world_torso[0, 0]))
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    return 0.5 * (points[LEFT_HAND] + points[RIGHT_HAND]) - TIPS_AHEAD_M * ahead, heading


def _box(
    middle: Array, heading: float, size: tuple[float, float, float] = BOX_M, albedo: float = CARDBOARD
) -> Capsules:
    """A closed box, level, in the middle of the place given."""
    c, s = np.cos(heading), np.sin(heading)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    x, y, z = np.maximum(0.5 * np.array(size) - BAR_M, 0.0)
    up = (0.0, 0.0, 2.0 * z)
    panels = [
        _panel((-x, -y, -z), (-x, y, -z), up),
        _panel((x, -y, -z), (x, y, -z), up),
        _panel((-x, -y, -z), (x, -y, -z), up),
        _panel((-x, y, -z), (x, y, -z), up),
        _panel((-x, -y, z), (-x, y, z), (2.0 * x, 0.0, 0.0)),
        _panel((-x, -y, -z), (-x, y, -z), (2.0 * x, 0.0, 0.0)),
    ]
    flat = _joined(panels, albedo)
    return flat._replace(starts=middle + flat.starts @ R.T, ends=middle + flat.ends @ R.T)


def _panel(start: tuple[float, ...], end: tuple[float, ...], across: tuple[float, ...]) -> tuple[Array, Array]:
    """Bars side by side, from the one between start and end to that one moved by ``across``."""
    count = max(int(np.ceil(np.linalg.norm(across) / (1.5 * BAR_M))), 1)
    shifts = np.linspace(0.0, 1.0, count + 1)[:, None] * np.array(across)
    return np.array(start) + shifts, np.array(end) + shifts


def _joined(panels: list[tuple[Array, Array]], albedo: float) -> Capsules:
    starts, ends = (np.concatenate(parts) for parts in zip(*panels, strict=True))
    return Capsules(starts, ends, np.full((len(starts), 2), BAR_M), np.full(len(starts), albedo))
