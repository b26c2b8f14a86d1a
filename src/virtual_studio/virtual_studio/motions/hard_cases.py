"""Motions that trackers are known to fail at: arms that touch the body, legs that hide each other, speed, lying down.

Each is a function of the person, because reaching one's own chest or hips depends on the sizes.
"""

from __future__ import annotations

import numpy as np

from ..people import VolumetricBody
from .everyday import STANDING
from .timeline import (
    ARM,
    STAND_S,
    Activity,
    Array,
    Key,
    Timeline,
    both_sides,
    ease,
    hold,
    key_postures,
    legs,
    reaching,
    with_left,
    with_right,
)

LEG = ("hip_x", "hip_y", "hip_z", "knee")
CHEST_M, BELLY_M, HIP_M = 0.132, 0.105, 0.165
"""Where the built-in body's skin is before the torso's axis at chest and belly, and beside it at the hips, for the
reference stature and an average build."""
FOREARM_M = 0.048
ON_THE_BACK = -np.pi / 2

G_M_S2 = 9.81
TAKE_OFF_M_S = 1.7
"""Upward speed at take-off: 15 cm high, as high as knees alone throw a body without ankles."""
TAKE_OFF_KNEE, CROUCHED_KNEE = 0.70, 1.65
STRAIGHTEN_S = 0.04
"""How fast the knees stop straightening after take-off."""
JUMPS = 2
JUMP_S = 1.8


def arm_on_chest(person: VolumetricBody) -> Timeline:
    """Lays the left forearm across the chest for two seconds, then lets the right arm hang along the trunk."""
    s = person.scale
    before = (CHEST_M + FOREARM_M) * person.build * s
    across = reaching(person.body, (before, -0.09 * s, 0.05 * s), (0.04 * s, 0.40 * s, -0.12 * s))
    held = with_left(STANDING, across, ARM)
    beside = 0.05 + 0.25 * max(person.build - 1.0, 0.0)
    hang = with_right(STANDING, both_sides(shoulder_x=-np.pi / 2 + beside, elbow=-0.02, shoulder_z=0.02), ARM)
    up = (0.0, STANDING), (0.6, held), (2.6, held), (3.2, STANDING)
    return _through(6.2, *up, (3.8, hang), (5.0, hang), (5.6, STANDING))


def hands_clasped(person: VolumetricBody) -> Timeline:
    """Clasps both hands before the belly, then before the face."""
    s, body = person.scale, person.body
    belly = _with_arms(
        reaching(body, ((BELLY_M * person.build + 0.14) * s, 0.032 * s, -0.08 * s), (0.0, 0.45 * s, -0.25 * s))
    )
    face = _with_arms(reaching(body, (0.30 * s, 0.044 * s, 0.32 * s), (0.25 * s, 0.35 * s, -0.20 * s)))
    return _through(5.8, (0.0, STANDING), (0.7, belly), (2.7, belly), (3.4, face), (4.4, face), (5.2, STANDING))


def hands_on_hips(person: VolumetricBody) -> Timeline:
    """Stands arms akimbo: the hands at the hips, elbows out; loops that a hull fills."""
    s, h = person.scale, person.body.half_lengths[0]
    side = (HIP_M * person.build + 0.030) * s
    akimbo = _with_arms(reaching(person.body, (0.03 * s, side, -0.62 * h), (-0.12 * s, 0.60 * s, 0.05 * s)))
    return _through(4.5, (0.0, STANDING), (0.7, akimbo), (3.2, akimbo), (3.9, STANDING))


def crossed_legs(person: VolumetricBody) -> Timeline:
    """Stands with the left leg before the right and past it, then the other way round."""
    keys: list[tuple[float, Array]] = []
    for at_s, front, behind in ((0.0, with_left, with_right), (3.4, with_right, with_left)):
        lifted = front(STANDING, both_sides(hip_x=0.02, hip_y=-0.75, knee=0.85), LEG)
        crossed = front(STANDING, both_sides(hip_x=-0.26, hip_y=-0.30, knee=0.14), LEG)
        crossed = behind(crossed, both_sides(hip_x=-0.12, hip_y=0.08, knee=0.04), LEG)
        keys += [(at_s, STANDING), (at_s + 0.5, lifted), (at_s + 1.0, crossed), (at_s + 2.4, crossed)]
        keys += [(at_s + 2.9, lifted)]
    return _through(7.4, *keys, (6.8, STANDING))


def squat(person: VolumetricBody) -> Timeline:
    """Squats deeply twice, arms forward, the second time faster."""
    down = posture(legs(1.45, 0.60, 0.55, apart=0.16), _arms(1.2, out=0.2, bend=-0.3))
    slow = (0.0, STANDING), (1.1, down, 0.55), (1.9, down, 0.55), (2.9, STANDING)
    return _through(4.7, *slow, (3.5, down, 0.55), (4.1, STANDING))


def sitting(person: VolumetricBody) -> Timeline:
    """Sits down on an invisible chair, hands at the knees, leans back, and gets up again."""
    half = posture(legs(0.85, 0.35, 0.60, apart=0.08), _arms(0.9, out=0.2, bend=-0.3))
    seated = posture(legs(1.42, 0.05, 0.0, apart=0.10), _arms(0.75, out=0.2, bend=-0.55))
    leaning = posture(legs(1.42, 0.05, -0.25, apart=0.10), _arms(0.35, out=0.2, bend=-1.1))
    down = (0.0, STANDING), (0.7, half, 0.60), (1.5, seated, 0.0), (2.5, seated, 0.0)
    return _through(6.0, *down, (3.1, leaning, -0.25), (3.9, leaning, -0.25), (4.6, half, 0.60), (5.4, STANDING))


def bow(person: VolumetricBody) -> Timeline:
    """Bows deeply, arms hanging."""
    down = posture(legs(-0.16, 0.22, 1.35, apart=0.06), _arms(1.35, out=0.2, bend=-0.15))
    return _through(3.6, (0.0, STANDING), (1.0, down, 1.35), (2.0, down, 1.35), (3.0, STANDING))


def lie_down(person: VolumetricBody) -> Timeline:
    """Squats, sits down on the floor, lies on the back for two seconds, and gets up the same way."""
    squatting = posture(legs(1.45, 0.75, 0.75, apart=0.14), _arms(1.3, out=0.25)), 0.75
    seated = posture(legs(2.10, -0.75, -0.35, apart=0.10), _arms(0.2, out=0.35)), -0.35
    half = posture(legs(2.00, -1.10, -1.0, apart=0.08), _arms(-0.1, out=0.5)), -1.0
    flat = posture(legs(1.535, -1.535, ON_THE_BACK, apart=0.08), _arms(0.0, out=0.55)), ON_THE_BACK
    down = (0.0, STANDING), (1.1, *squatting), (2.1, *seated), (2.8, *half), (3.5, *flat), (5.5, *flat)
    return _through(10.0, *down, (6.4, *half), (7.2, *seated), (8.3, *squatting), (9.4, STANDING))


def kick(person: VolumetricBody) -> Timeline:
    """Kicks forward with the left leg, then with the right, arms out for balance."""
    ready = posture(STANDING, both_sides(shoulder_x=-0.7, shoulder_z=-0.5, shoulder_y=0.3, elbow=-0.9))
    leg = ("hip_x", "hip_y", "knee")
    keys: list[tuple] = [(0.0, ready)]
    for at_s, side in ((0.5, with_left), (2.0, with_right)):
        bent = side(ready, both_sides(hip_x=0.04, hip_y=-1.35, knee=1.7), leg), -0.12
        out = side(ready, both_sides(hip_x=0.04, hip_y=-1.45, knee=0.15), leg), -0.25
        keys += [(at_s, ready), (at_s + 0.30, *bent), (at_s + 0.50, *out), (at_s + 0.70, *bent), (at_s + 1.05, ready)]
    return _through(3.8, *keys, (3.2, ready))


def punch(person: VolumetricBody) -> Timeline:
    """Boxes: guard, left and right in turn, twice."""
    s = person.scale
    guard = reaching(person.body, (0.30 * s, 0.12 * s, 0.30 * s), (0.12 * s, 0.30 * s, -0.20 * s))
    out = reaching(person.body, (0.62 * s, 0.06 * s, 0.26 * s), (0.25 * s, 0.40 * s, 0.10 * s))
    stance = posture(legs(0.28, 0.25, 0.08, apart=0.10), guard)
    keys: list[tuple] = [(0.0, stance, 0.08)]
    for number in range(4):
        side, at_s = (with_left, with_right)[number % 2], 0.6 + 0.55 * number
        keys += [(at_s, stance, 0.08), (at_s + 0.2, side(stance, out, ARM), 0.12), (at_s + 0.45, stance, 0.08)]
    return _through(3.6, *keys)


def jump(person: VolumetricBody) -> Timeline:
    """Jumps twice on the spot, out of a crouch and back into it."""
    jumping = _Jump(person)
    jumps = Activity(JUMPS * JUMP_S + 0.6, jumping.angles, lean=jumping.lean, lift=jumping.lift)
    return Timeline((hold(STAND_S, STANDING), jumps))


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


def posture(of_legs: Array, of_arms: Array) -> Array:
    """Combines the legs of one pose with the arms of another: angles (18,), neck straight."""
    return with_right(with_left(of_legs, of_arms, ARM), of_arms, ARM)


def _through(duration_s: float, *keys: tuple) -> Timeline:
    """Stands, then goes through key postures: tuples of time, s, angles (18,) and, if not 0, the torso's lean, rad."""
    return Timeline((hold(STAND_S, STANDING), key_postures([Key(*key) for key in keys], duration_s)))


def _arms(raised: float, out: float, bend: float = -0.25) -> Array:
    return both_sides(shoulder_x=-np.pi / 2 + out, shoulder_z=-raised, shoulder_y=0.2, elbow=bend)


def _with_arms(arms: Array) -> Array:
    return with_right(with_left(STANDING, arms, ARM), arms, ARM)
