"""Motions that trackers are known to fail at: arms that touch the body, legs that hide each other, speed, lying down,
kneeling, a chair that hides legs, a box that is lifted and carried.

Each is a function of the person, because reaching one's own chest or hips depends on the sizes.
"""

from __future__ import annotations

import numpy as np
from scipy.constants import g

from stick_figure.kinematics import forward
from stick_figure.skeleton import L_THIGH

from ..people import Capsules, VolumetricBody
from .everyday import STANDING, stepping, walking
from .timeline import (
    ARM,
    STAND_S,
    T_POSE_S,
    Activity,
    Array,
    Motion,
    Things,
    Timeline,
    both_sides,
    ease,
    hold,
    key_postures,
    legs,
    posture,
    reaching,
    stance,
    with_left,
    with_right,
)

LEG = ("hip_x", "hip_y", "hip_z", "knee")
CHEST_M, BELLY_M, HIP_M = 0.132, 0.105, 0.165
"""Where the built-in body's skin is before the torso's axis at chest and belly, and beside it at the hips, for the
reference stature and an average build."""
FOREARM_M = 0.048
ON_THE_BACK = -np.pi / 2

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
    return through(6.2, *up, (3.8, hang), (5.0, hang), (5.6, STANDING))


def hands_clasped(person: VolumetricBody) -> Timeline:
    """Clasps both hands before the belly, then before the face."""
    s, body = person.scale, person.body
    belly = posture(
        STANDING,
        reaching(body, ((BELLY_M * person.build + 0.14) * s, 0.032 * s, -0.08 * s), (0.0, 0.45 * s, -0.25 * s)),
    )
    face = posture(STANDING, reaching(body, (0.30 * s, 0.044 * s, 0.32 * s), (0.25 * s, 0.35 * s, -0.20 * s)))
    return through(5.8, (0.0, STANDING), (0.7, belly), (2.7, belly), (3.4, face), (4.4, face), (5.2, STANDING))


def hands_on_hips(person: VolumetricBody) -> Timeline:
    """Stands arms akimbo: the hands at the hips, elbows out; loops that a hull fills."""
    s, h = person.scale, person.body.half_lengths[0]
    side = (HIP_M * person.build + 0.030) * s
    akimbo = posture(STANDING, reaching(person.body, (0.03 * s, side, -0.62 * h), (-0.12 * s, 0.60 * s, 0.05 * s)))
    return through(4.5, (0.0, STANDING), (0.7, akimbo), (3.2, akimbo), (3.9, STANDING))


def crossed_legs(person: VolumetricBody) -> Timeline:
    """Stands with the left leg before the right and past it, then the other way round."""
    keys: list[tuple[float, Array]] = []
    for at_s, front, behind in ((0.0, with_left, with_right), (3.4, with_right, with_left)):
        lifted = front(STANDING, both_sides(hip_x=0.02, hip_y=-0.75, knee=0.85), LEG)
        crossed = front(STANDING, both_sides(hip_x=-0.26, hip_y=-0.30, knee=0.14), LEG)
        crossed = behind(crossed, both_sides(hip_x=-0.12, hip_y=0.08, knee=0.04), LEG)
        keys += [(at_s, STANDING), (at_s + 0.5, lifted), (at_s + 1.0, crossed), (at_s + 2.4, crossed)]
        keys += [(at_s + 2.9, lifted)]
    return through(7.4, *keys, (6.8, STANDING))


def squat(person: VolumetricBody) -> Timeline:
    """Squats deeply twice, arms forward, the second time faster."""
    down = posture(legs(1.45, 0.60, 0.55, apart=0.16), _arms(1.2, out=0.2, bend=-0.3))
    slow = (0.0, STANDING), (1.1, down, 0.55), (1.9, down, 0.55), (2.9, STANDING)
    return through(4.7, *slow, (3.5, down, 0.55), (4.1, STANDING))


def sitting(person: VolumetricBody) -> Timeline:
    """Sits down on an invisible chair, hands at the knees, leans back, and gets up again."""
    half = posture(legs(0.85, 0.35, 0.60, apart=0.08), _arms(0.9, out=0.2, bend=-0.3))
    seated = posture(legs(1.42, 0.05, 0.0, apart=0.10), _arms(0.75, out=0.2, bend=-0.55))
    leaning = posture(legs(1.42, 0.05, -0.25, apart=0.10), _arms(0.35, out=0.2, bend=-1.1))
    down = (0.0, STANDING), (0.7, half, 0.60), (1.5, seated, 0.0), (2.5, seated, 0.0)
    return through(6.0, *down, (3.1, leaning, -0.25), (3.9, leaning, -0.25), (4.6, half, 0.60), (5.4, STANDING))


def bow(person: VolumetricBody) -> Timeline:
    """Bows deeply, arms hanging."""
    down = posture(legs(-0.16, 0.22, 1.35, apart=0.06), _arms(1.35, out=0.2, bend=-0.15))
    return through(3.6, (0.0, STANDING), (1.0, down, 1.35), (2.0, down, 1.35), (3.0, STANDING))


def lie_down(person: VolumetricBody) -> Timeline:
    """Squats, sits down on the floor, lies on the back for two seconds, and gets up the same way."""
    squatting = posture(legs(1.45, 0.75, 0.75, apart=0.14), _arms(1.3, out=0.25)), 0.75
    seated = posture(legs(2.10, -0.75, -0.35, apart=0.10), _arms(0.2, out=0.35)), -0.35
    half = posture(legs(2.00, -1.10, -1.0, apart=0.08), _arms(-0.1, out=0.5)), -1.0
    flat = posture(legs(1.535, -1.535, ON_THE_BACK, apart=0.08), _arms(0.0, out=0.55)), ON_THE_BACK
    down = (0.0, STANDING), (1.1, *squatting), (2.1, *seated), (2.8, *half), (3.5, *flat), (5.5, *flat)
    return through(10.0, *down, (6.4, *half), (7.2, *seated), (8.3, *squatting), (9.4, STANDING))


def kick(person: VolumetricBody) -> Timeline:
    """Kicks forward with the left leg, then with the right, arms out for balance."""
    ready = posture(STANDING, both_sides(shoulder_x=-0.7, shoulder_z=-0.5, shoulder_y=0.3, elbow=-0.9))
    leg = ("hip_x", "hip_y", "knee")
    keys: list[tuple] = [(0.0, ready)]
    for at_s, side in ((0.5, with_left), (2.0, with_right)):
        bent = side(ready, both_sides(hip_x=0.04, hip_y=-1.35, knee=1.7), leg), -0.12
        out = side(ready, both_sides(hip_x=0.04, hip_y=-1.45, knee=0.15), leg), -0.25
        keys += [(at_s, ready), (at_s + 0.30, *bent), (at_s + 0.50, *out), (at_s + 0.70, *bent), (at_s + 1.05, ready)]
    return through(3.8, *keys, (3.2, ready))


def punch(person: VolumetricBody) -> Timeline:
    """Boxes: guard, left and right in turn, twice."""
    s = person.scale
    guard = reaching(person.body, (0.30 * s, 0.12 * s, 0.30 * s), (0.12 * s, 0.30 * s, -0.20 * s))
    out = reaching(person.body, (0.62 * s, 0.06 * s, 0.26 * s), (0.25 * s, 0.40 * s, 0.10 * s))
    ready = posture(legs(0.28, 0.25, 0.08, apart=0.10), guard)
    keys: list[tuple] = [(0.0, ready, 0.08)]
    for number in range(4):
        side, at_s = (with_left, with_right)[number % 2], 0.6 + 0.55 * number
        keys += [(at_s, ready, 0.08), (at_s + 0.2, side(ready, out, ARM), 0.12), (at_s + 0.45, ready, 0.08)]
    return through(3.6, *keys)


def jump(person: VolumetricBody) -> Timeline:
    """Jumps twice on the spot, out of a crouch and back into it.

    One jump every JUMP_S: crouch, push at constant acceleration, fly, and the same backwards in time.
    """
    leg = person.body.lengths[4] + person.body.lengths[8]

    def length(knee: float) -> float:
        """Hip to ankle of a leg whose thigh and calf are about equally long."""
        return leg * float(np.cos(0.5 * knee))

    push_s = 2.0 * (length(TAKE_OFF_KNEE) - length(CROUCHED_KNEE)) / TAKE_OFF_M_S
    straightened = TAKE_OFF_M_S / (0.5 * leg * np.sin(0.5 * TAKE_OFF_KNEE)) * STRAIGHTEN_S

    def at(t: float) -> Array:
        nearest = min(max(round(t / JUMP_S - 0.5), 0), JUMPS - 1)
        flown_s = TAKE_OFF_M_S / g - abs(t - (nearest + 0.5) * JUMP_S)  # since take-off, or until landing
        to_crouch_s, lift = push_s + flown_s, 0.0
        if flown_s > 0.0:
            knee = TAKE_OFF_KNEE - straightened * (1.0 - np.exp(-flown_s / STRAIGHTEN_S))
            risen = TAKE_OFF_M_S * flown_s - 0.5 * g * flown_s * flown_s
            lift = max(risen - (length(knee) - length(TAKE_OFF_KNEE)), 0.0)  # less the straightening of the legs
        elif to_crouch_s > 0.0:
            hip_m = length(CROUCHED_KNEE) + 0.5 * TAKE_OFF_M_S / push_s * to_crouch_s**2
            knee = float(2.0 * np.arccos(min(hip_m / leg, 1.0)))
        else:
            knee = CROUCHED_KNEE + (0.2 - CROUCHED_KNEE) * ease(-to_crouch_s / 0.45)
        swung, forward_rad = (knee - TAKE_OFF_KNEE) / (CROUCHED_KNEE - TAKE_OFF_KNEE), 0.05 + 0.25 * knee
        arms = both_sides(shoulder_x=-np.pi / 2 + 0.2, shoulder_z=-0.5 + 0.6 * swung, shoulder_y=0.2, elbow=-0.5)
        angles = posture(legs(0.5 * knee, 0.5 * knee, forward_rad, apart=0.05), arms)
        return stance(angles, (0.0, forward_rad, 0.0), lift)

    return Timeline((hold(STAND_S, STANDING), Activity(JUMPS * JUMP_S + 0.6, at)))


def through(duration_s: float, *keys: tuple) -> Timeline:
    """Stands, then goes through `key_postures`."""
    return Timeline((hold(STAND_S, STANDING), key_postures(duration_s, *keys)))


def _arms(raised: float, out: float, bend: float = -0.25) -> Array:
    return both_sides(shoulder_x=-np.pi / 2 + out, shoulder_z=-raised, shoulder_y=0.2, elbow=bend)


# --- On the floor and with things.

TOES_UNDER = 1.95
"""How far a kneeling person's calves lie behind the knees, rad from the vertical: heels up, as toes are bent under."""

WOOD, CARDBOARD = 0.30, 0.55
"""Albedos: a dark chair, a light box."""
BAR_M = 0.022
"""Radius of the bars that panels are made of; they overlap by a quarter."""
SEAT_DEPTH_M, SEAT_WIDTH_M, BACK_HEIGHT_M = 0.40, 0.44, 0.44
BEHIND_HIPS_M = 0.17
"""Distance of the back rest behind the hips of somebody who leans on it."""
BACK_TILT_RAD = 0.28
KNEES_FREE_M = 0.08
"""How far the seat ends before the hollow of the knees."""

BOX_M = (0.30, 0.36, 0.28)
"""Depth, width and height."""
BENT_THIGHS, BENT_CALVES, BENT_RAD = 0.55, 0.30, 1.05
"""How legs and trunk are bent at the box, rad."""
PALM_M = 0.035
"""Distance from the stick of a hand to the thing that the palm touches."""
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
    down = (0.0, STANDING), (1.0, *crouched), (1.9, *upright), (2.8, *upright), (3.6, *working), (4.8, *working)
    return through(8.0, *down, (5.6, *upright), (6.5, *crouched), (7.4, STANDING))


def chair(person: VolumetricBody, motion: Motion) -> Things:
    """A closed chair, a box with a back, under somebody who sits down on it: where the thighs are when lowest."""
    points = np.array([forward(person.body, pose) for pose in motion.poses])
    hips = 0.5 * (points[:, LEFT_HIP] + points[:, RIGHT_HIP])
    frame = int(np.argmin(hips[:, 2]))
    seat = hips[frame] - [0.0, 0.0, float(person.radii_of(L_THIGH).max())]
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
    upright = posture(STANDING, held)
    grasped = (0.0, STANDING), (0.9, posture(down, wide), BENT_RAD), (GRASP_S, posture(down, low), BENT_RAD)
    lifting = key_postures(PICKED_S, *grasped, (LIFTED_S, upright), (PICKED_S, upright))
    turning = Activity(TURN_S, lambda t: stance(posture(stepping(t), held), turning=np.pi / TURN_S))
    away = Activity(CARRY_S, lambda t: posture(walking(t), held))
    return Timeline(
        (hold(STAND_S, STANDING), Activity(APPROACH_S, walking), lifting, turning, away, hold(1.6, upright))
    )


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
