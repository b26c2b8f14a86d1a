"""Legs that hide each other or fold: crossed, squatting, sitting, and a bow."""

from __future__ import annotations

import numpy as np

from ..people import VolumetricBody
from .everyday import STANDING
from .limbs import ARM, Array, Side, both_sides, legs, reaching, with_left, with_right
from .timeline import Activity, Key, Timeline, activity_of, ease, hold

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


# --- Arms that touch the body, where silhouettes merge: on the chest, clasped, on the hips.

CHEST_M, BELLY_M, HIP_M = 0.132, 0.105, 0.165
"""Where the built-in body's skin is before the torso's axis at chest and belly, and beside it at the hips, for the
reference stature and an average build."""
FOREARM_M = 0.048


def arm_on_chest(person: VolumetricBody) -> Timeline:
    """The left forearm lies across the chest for two seconds, then the right arm hangs along the trunk."""
    across = with_left(STANDING, forearm_across(person, height=0.05), ARM)
    beside = 0.05 + 0.25 * max(person.build - 1.0, 0.0)
    along = with_right(STANDING, both_sides(shoulder_x=-np.pi / 2 + beside, elbow=-0.02, shoulder_z=0.02), ARM)
    keys = [
        Key(0.0, STANDING),
        Key(0.6, across),
        Key(2.6, across),
        Key(3.2, STANDING),
        Key(3.8, along),
        Key(5.0, along),
        Key(5.6, STANDING),
    ]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 6.2)))


def hands_clasped(person: VolumetricBody) -> Timeline:
    """Both hands meet before the belly, then before the face."""
    s = person.scale
    belly = _with_arms(
        reaching(person.body, ((BELLY_M * person.build + 0.14) * s, 0.032 * s, -0.08 * s), (0.0, 0.45 * s, -0.25 * s))
    )
    face = _with_arms(reaching(person.body, (0.30 * s, 0.044 * s, 0.32 * s), (0.25 * s, 0.35 * s, -0.20 * s)))
    keys = [Key(0.0, STANDING), Key(0.7, belly), Key(2.7, belly), Key(3.4, face), Key(4.4, face), Key(5.2, STANDING)]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 5.8)))


def hands_on_hips(person: VolumetricBody) -> Timeline:
    """Arms akimbo: the hands at the hips, elbows out; loops that a hull fills."""
    s, h = person.scale, person.body.half_lengths[0]
    side = (HIP_M * person.build + 0.030) * s
    akimbo = _with_arms(reaching(person.body, (0.03 * s, side, -0.62 * h), (-0.12 * s, 0.60 * s, 0.05 * s)))
    keys = [Key(0.0, STANDING), Key(0.7, akimbo), Key(3.2, akimbo), Key(3.9, STANDING)]
    return Timeline((hold(0.9, STANDING), activity_of(keys, 4.5)))


def forearm_across(person: VolumetricBody, height: float) -> Array:
    """Angles (18,) with both forearms across the chest, the hands' tips past its middle; height over the centre, m."""
    s = person.scale
    before = (CHEST_M + FOREARM_M) * person.build * s
    return reaching(person.body, (before, -0.09 * s, height * s), (0.04 * s, 0.40 * s, -0.12 * s))


def _with_arms(arms: Array) -> Array:
    return with_right(with_left(STANDING, arms, ARM), arms, ARM)


# --- Fast moves: jumps, kicks, punches.

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


# --- Lying down and getting up.

ON_THE_BACK = -np.pi / 2


def lie_down(person: VolumetricBody) -> Timeline:
    """Squats, sits down on the floor, lies on the back for two seconds, and gets up the same way."""
    squatting = posture(legs(1.45, 0.75, 0.75, apart=0.14), _arms(1.3, out=0.25))
    seated = posture(legs(2.10, -0.75, -0.35, apart=0.10), _arms(0.2, out=0.35))
    half = posture(legs(2.00, -1.10, -1.0, apart=0.08), _arms(-0.1, out=0.5))
    flat = posture(legs(1.535, -1.535, ON_THE_BACK, apart=0.08), _arms(0.0, out=0.55))
    down = [
        (0.0, STANDING, 0.0),
        (1.1, squatting, 0.75),
        (2.1, seated, -0.35),
        (2.8, half, -1.0),
        (3.5, flat, ON_THE_BACK),
        (5.5, flat, ON_THE_BACK),
    ]
    up = [(6.4, half, -1.0), (7.2, seated, -0.35), (8.3, squatting, 0.75), (9.4, STANDING, 0.0)]
    return Timeline((hold(0.9, STANDING), activity_of([Key(*key) for key in down + up], 10.0)))


def _arms(raised: float, out: float) -> Array:
    return both_sides(shoulder_x=-np.pi / 2 + out, shoulder_z=-raised, shoulder_y=0.2, elbow=-0.25)
