"""Fast moves: jumps, kicks, punches."""

from __future__ import annotations

import numpy as np

from ..body import VolumetricBody
from .crossing import posture
from .everyday import STANDING
from .keys import Key, activity_of, hold
from .limbs import ARM, Array, Side, both_sides, legs, reaching, with_left, with_right
from .timeline import Activity, Timeline, ease

G_M_S2 = 9.81
TAKE_OFF_M_S = 1.7
"""Upward speed at take-off: 15 cm high, as high as knees alone throw a body without ankles."""
TAKE_OFF_KNEE, CROUCHED_KNEE = 0.70, 1.65
STRAIGHTEN_S = 0.04
"""How fast the knees stop straightening after take-off."""
JUMPS = 2
JUMP_S = 1.8


def jump(person: VolumetricBody) -> Timeline:
    """Two jumps on the spot, out of a crouch and back into it."""
    course = _Jump(person)
    jumps = Activity(JUMPS * JUMP_S + 0.6, course.angles, lean=course.lean, lift=course.lift)
    return Timeline((hold(0.9, STANDING), jumps))


class _Jump:
    """One jump every JUMP_S: crouch, push at constant acceleration, fly, and the same backwards in time."""

    def __init__(self, person: VolumetricBody) -> None:
        self._leg = person.body.lengths[4] + person.body.lengths[8]
        way = self._length(TAKE_OFF_KNEE) - self._length(CROUCHED_KNEE)
        self._push_s = 2.0 * way / TAKE_OFF_M_S
        self._half_flight_s = TAKE_OFF_M_S / G_M_S2
        rate = TAKE_OFF_M_S / (0.5 * self._leg * np.sin(0.5 * TAKE_OFF_KNEE))
        self._straightened = rate * STRAIGHTEN_S

    def angles(self, t: float) -> Array:
        knee = self._knee(self._from_middle(t))
        swung = (knee - TAKE_OFF_KNEE) / (CROUCHED_KNEE - TAKE_OFF_KNEE)
        arms = both_sides(shoulder_x=-np.pi / 2 + 0.2, shoulder_z=-0.5 + 0.6 * swung, shoulder_y=0.2, elbow=-0.5)
        return posture(legs(0.5 * knee, 0.5 * knee, self._forward(knee), apart=0.05), arms)

    def lean(self, t: float) -> Array:
        return np.array([0.0, self._forward(self._knee(self._from_middle(t))), 0.0])

    def lift(self, t: float) -> float:
        """Height of the torso over its take-off, less what the legs have straightened."""
        s = self._half_flight_s - self._from_middle(t)
        if s <= 0.0:
            return 0.0
        risen = TAKE_OFF_M_S * s - 0.5 * G_M_S2 * s * s
        return max(risen - (self._length(self._knee(self._from_middle(t))) - self._length(TAKE_OFF_KNEE)), 0.0)

    def _from_middle(self, t: float) -> float:
        """Seconds to or from the top of the nearest jump."""
        nearest = min(max(round(t / JUMP_S - 0.5), 0), JUMPS - 1)
        return abs(t - (nearest + 0.5) * JUMP_S)

    def _knee(self, s: float) -> float:
        """Angle of the knees s seconds from the top, rad."""
        flown = self._half_flight_s - s
        if flown > 0.0:
            return TAKE_OFF_KNEE - self._straightened * (1.0 - np.exp(-flown / STRAIGHTEN_S))
        to_crouch = self._push_s + flown
        if to_crouch > 0.0:
            length = self._length(CROUCHED_KNEE) + 0.5 * TAKE_OFF_M_S / self._push_s * to_crouch**2
            return float(2.0 * np.arccos(min(length / self._leg, 1.0)))
        return CROUCHED_KNEE + (0.2 - CROUCHED_KNEE) * ease(-to_crouch / 0.45)

    def _length(self, knee: float) -> float:
        """Hip to ankle of a leg whose thigh and calf are about equally long."""
        return self._leg * float(np.cos(0.5 * knee))

    @staticmethod
    def _forward(knee: float) -> float:
        return 0.05 + 0.25 * knee


def kick(person: VolumetricBody) -> Timeline:
    """A front kick with the left leg, then with the right, arms out for balance."""
    arms = both_sides(shoulder_x=-0.7, shoulder_z=-0.5, shoulder_y=0.3, elbow=-0.9)
    ready = posture(STANDING, arms)
    keys = [Key(0.0, ready), *_kicks(ready, with_left, 0.5), *_kicks(ready, with_right, 2.0), Key(3.2, ready)]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 3.8)))


def _kicks(ready: Array, side: Side, at_s: float) -> list[Key]:
    leg = ("hip_x", "hip_y", "knee")
    bent = side(ready, both_sides(hip_x=0.04, hip_y=-1.35, knee=1.7), leg)
    out = side(ready, both_sides(hip_x=0.04, hip_y=-1.45, knee=0.15), leg)
    return [
        Key(at_s, ready),
        Key(at_s + 0.30, bent, -0.12),
        Key(at_s + 0.50, out, -0.25),
        Key(at_s + 0.70, bent, -0.12),
        Key(at_s + 1.05, ready),
    ]


def punch(person: VolumetricBody) -> Timeline:
    """Boxing: guard, left and right in turn, twice."""
    s = person.scale
    guard = reaching(person.body, (0.30 * s, 0.12 * s, 0.30 * s), (0.12 * s, 0.30 * s, -0.20 * s))
    out = reaching(person.body, (0.62 * s, 0.06 * s, 0.26 * s), (0.25 * s, 0.40 * s, 0.10 * s))
    stance = posture(legs(0.28, 0.25, 0.08, apart=0.10), guard)
    keys = [Key(0.0, stance, 0.08)]
    for number in range(4):
        side, at_s = (with_left, with_right)[number % 2], 0.6 + 0.55 * number
        keys += [Key(at_s, stance, 0.08), Key(at_s + 0.2, side(stance, out, ARM), 0.12), Key(at_s + 0.45, stance, 0.08)]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 3.6)))
