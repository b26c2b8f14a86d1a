"""Legs that hide each other or fold: crossed, squatting, sitting, and a bow."""

from __future__ import annotations

import numpy as np

from ..body import VolumetricBody
from .everyday import STANDING
from .keys import Key, activity_of, hold
from .limbs import ARM, Array, Side, both_sides, legs, with_left, with_right
from .timeline import Timeline

LEG = ("hip_x", "hip_y", "hip_z", "knee")


def crossed_legs(person: VolumetricBody) -> Timeline:
    """Standing with the left leg before the right and past it, then the other way round."""
    left_first, right_first = _crossed(with_left, with_right), _crossed(with_right, with_left)
    keys = [
        Key(0.0, STANDING),
        Key(0.5, _lifted(with_left)),
        Key(1.0, left_first),
        Key(2.4, left_first),
        Key(2.9, _lifted(with_left)),
        Key(3.4, STANDING),
        Key(3.9, _lifted(with_right)),
        Key(4.4, right_first),
        Key(5.8, right_first),
        Key(6.3, _lifted(with_right)),
        Key(6.8, STANDING),
    ]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 7.4)))


def squat(person: VolumetricBody) -> Timeline:
    """Twice down to a deep squat, arms forward, the second time faster."""
    down = posture(legs(1.45, 0.60, 0.55, apart=0.16), _forward_arms(1.2))
    keys = [
        Key(0.0, STANDING),
        Key(1.1, down, 0.55),
        Key(1.9, down, 0.55),
        Key(2.9, STANDING),
        Key(3.5, down, 0.55),
        Key(4.1, STANDING),
    ]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 4.7)))


def sitting(person: VolumetricBody) -> Timeline:
    """Sitting down on a chair nobody sees, hands at the knees, leaning back, and up again."""
    half = posture(legs(0.85, 0.35, 0.60, apart=0.08), _forward_arms(0.9))
    seated = posture(legs(1.42, 0.05, 0.0, apart=0.10), _forward_arms(0.75, bend=-0.55))
    leaning = posture(legs(1.42, 0.05, -0.25, apart=0.10), _forward_arms(0.35, bend=-1.1))
    keys = [
        Key(0.0, STANDING),
        Key(0.7, half, 0.60),
        Key(1.5, seated, 0.0),
        Key(2.5, seated, 0.0),
        Key(3.1, leaning, -0.25),
        Key(3.9, leaning, -0.25),
        Key(4.6, half, 0.60),
        Key(5.4, STANDING),
    ]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 6.0)))


def bow(person: VolumetricBody) -> Timeline:
    """A deep bow, arms hanging."""
    down = posture(legs(-0.16, 0.22, 1.35, apart=0.06), _forward_arms(1.35, bend=-0.15))
    keys = [Key(0.0, STANDING), Key(1.0, down, 1.35), Key(2.0, down, 1.35), Key(3.0, STANDING)]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 3.6)))


def posture(of_legs: Array, of_arms: Array) -> Array:
    """Angles (18,) with the legs of one pose and the arms of another, neck straight."""
    return with_right(with_left(of_legs, of_arms, ARM), of_arms, ARM)


def _forward_arms(raised: float, bend: float = -0.3) -> Array:
    return both_sides(shoulder_x=-np.pi / 2 + 0.2, shoulder_z=-raised, shoulder_y=0.2, elbow=bend)


def _crossed(front: Side, behind: Side) -> Array:
    before = both_sides(hip_x=-0.26, hip_y=-0.30, knee=0.14)
    after = both_sides(hip_x=-0.12, hip_y=0.08, knee=0.04)
    return behind(front(STANDING, before, LEG), after, LEG)


def _lifted(side: Side) -> Array:
    return side(STANDING, both_sides(hip_x=0.02, hip_y=-0.75, knee=0.85), LEG)
