"""Euler angles of the ball joints: composition, its exact inverse, rates.

Thesis Tables 5.1 and 5.4, corrected. A ball joint is R = R_x(a) R_j(b) R_k(c). The same rotation is also (a + pi,
pi - b, c + pi), and a hinge h bent the wrong way equals -h with the upper limb turned by pi about itself. Of these
equal descriptions the one inside the joint ranges is the answer; where several or none are inside, the one nearest the
previous angles.
"""

from __future__ import annotations

import math

import numpy as np

from capture_rig.kernel import njit
from capture_rig.lens import NEGLIGIBLE

from . import kernels
from .skeleton import ANGLE_HIGH, ANGLE_LOW, BALL_ANGLES, BALL_EULER_AXES, HINGE_ANGLES, T_POSE_ANGLES

Array = np.ndarray


# Thresholds: rounding from arithmetic; hinges: two standard deviations of a straight arm's bend; the others
# judgement.
GIMBAL_SINE = 1e-8
"""cos(b) below which the first and third axis are parallel in double precision: only their sum is defined."""
SINGULAR_SINE = 0.05
"""Smallest singular value of the angles' axes that rates are divided by: they stay below 1/0.05 per rad/s of turn."""
TURN = 2.0 * math.pi

_LIMB_SLOTS = np.column_stack([BALL_ANGLES[1:], HINGE_ANGLES])
"""(4, 4) slots of a, b, c and the hinge of left arm, right arm, left leg, right leg."""


@njit(cache=True)
def joint_rotations(angles):
    """Rotations (5, 3, 3), stick to torso, of the five ball joints from the 18 angles (thesis Table 5.2's products).

    The neck's has the form that `kernels.neck_from_direction` keeps.
    """
    R_joints = np.empty((5, 3, 3))
    for ball in range(5):
        ball_rotation(ball, angles, R_joints[ball])
    neck = R_joints[0]
    kernels.neck_from_direction(neck[0, 2], neck[1, 2], neck[2, 2], neck)
    return R_joints


def angles_of_joints(R_joints: Array, hinges: Array, previous: Array | None = None) -> Array:
    """Return the 18 angles (rad) of ball rotations (5, 3, 3) and hinges (4,).

    Inside the ranges whenever the pose is; otherwise an equal description that exceeds them. With `previous` (18,) the
    description goes on from there instead: never a whole turn away, and beyond the ranges by a slack. At a gimbal
    singularity the undefined angle keeps its value of `previous`, or of the T-pose when there is none.
    """
    angles = np.empty(18)
    reference = T_POSE_ANGLES if previous is None else np.ascontiguousarray(previous, float)
    _all_angles(R_joints, hinges, reference, previous is not None, angles)
    return angles


def wrap_pi(angle: Array) -> Array:
    """Angles wrapped to [-pi, pi)."""
    return (np.asarray(angle) + np.pi) % TURN - np.pi


BALL_SLACK_RAD = 0.5
"""Total excess over its ranges, rad, at which a ball joint changes to its other description, a jump by pi."""
HINGE_SLACK_RAD = 0.35
"""The same of elbows and knees. The hand of a straight arm is known to some 3 cm and its elbow too, so that a forearm
of 25 cm seems bent by 0.17 rad (1 sd): within two of those the upper arm keeps its twist instead of turning by pi."""
OUT_OF_RANGE = 100.0
"""What a radian beyond a joint's range costs, in radians of a jump away from the angles before."""


@njit(cache=True)
def ball_rotation(ball, angles, R):
    """R (3, 3) <- rotation stick to torso of ball joint 0..4 from the 18 angles."""
    for i in range(3):
        for j in range(3):
            R[i, j] = 1.0 if i == j else 0.0
    for k in range(3):
        if BALL_ANGLES[ball, k] >= 0:
            _turn_about_own(R, BALL_EULER_AXES[ball, k], angles[BALL_ANGLES[ball, k]])


@njit(cache=True)
def wrap_into_range(value, slot):
    """Return the value modulo a full turn in (or nearest to) the slot's range; rounding is snapped to the limit."""
    middle = 0.5 * (ANGLE_LOW[slot] + ANGLE_HIGH[slot])
    value -= TURN * math.floor((value - middle) / TURN + 0.5)
    if ANGLE_LOW[slot] - NEGLIGIBLE <= value <= ANGLE_HIGH[slot] + NEGLIGIBLE:
        value = min(max(value, ANGLE_LOW[slot]), ANGLE_HIGH[slot])
    return value


@njit(cache=True)
def excess_over_range(values, slots):
    """Return the sum over the slots of the values' excesses over their ranges, rad."""
    total = 0.0
    for value, slot in zip(values, slots):  # noqa: B905 (numba has no strict)
        total += max(ANGLE_LOW[slot] - value, value - ANGLE_HIGH[slot], 0.0)
    return total


@njit(cache=True)
def _turn_about_own(R, axis, angle):
    """R <- R R_axis(angle), in place."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    for q in range(3):
        first, second = R[q, i], R[q, j]
        R[q, i] = c * first + s * second
        R[q, j] = c * second - s * first


@njit(cache=True)
def _all_angles(R_joints, hinges, reference, continuous, angles):
    x, y, z = R_joints[0, 0, 2], R_joints[0, 1, 2], R_joints[0, 2, 2]
    level = math.hypot(y, z)
    angles[0] = wrap_into_range(math.atan2(-y, z), 0) if level > GIMBAL_SINE else reference[0]
    if continuous:
        angles[0] = _unwrapped(angles[0], reference[0])
    angles[1] = math.atan2(x, level)
    best = np.empty(4)
    for limb in range(4):
        _limb_angles(limb, R_joints[1 + limb], hinges[limb], reference, continuous, best)
        for k in range(4):
            angles[_LIMB_SLOTS[limb, k]] = best[k]


@njit(cache=True)
def _limb_angles(limb, R, hinge, reference, continuous, best):
    """best (4,) <- a, b, c and hinge of one limb, chosen among the four equal descriptions."""
    slots = _LIMB_SLOTS[limb]
    values, turned = np.empty(4), R.copy()
    flipped_axis = 2 if limb < 2 else 1  # Ry(pi) flips x and z of an arm, Rz(pi) x and y of a leg
    for q in range(3):
        turned[q, 0], turned[q, flipped_axis] = -R[q, 0], -R[q, flipped_axis]
    best_cost = math.inf
    for bent in range(2):
        for cover in range(2):
            _decompose(1 + limb, R if bent == 0 else turned, cover == 1, reference, values)
            values[3] = hinge if bent == 0 else -hinge
            for k in range(4):
                values[k] = wrap_into_range(values[k], slots[k])
            ball, bend = excess_over_range(values[:3], slots[:3]), excess_over_range(values[3:], slots[3:])
            if continuous:
                cost = OUT_OF_RANGE * (max(ball - BALL_SLACK_RAD, 0.0) + max(bend - HINGE_SLACK_RAD, 0.0))
                cost += _turning_distance(values, slots, reference)
            else:
                cost = OUT_OF_RANGE * (ball + bend)
            if cost < best_cost:
                best_cost = cost
                best[:] = values
    if continuous:
        for k in range(4):
            best[k] = _unwrapped(best[k], reference[slots[k]])


@njit(cache=True)
def _unwrapped(value, before):
    """Return the same angle within half a turn of the one before."""
    return value - TURN * math.floor((value - before) / TURN + 0.5)


@njit(cache=True)
def _decompose(ball, R, second_cover, reference, values):
    """values[:3] <- a, b, c with R = R_x(a) R_j(b) R_k(c)."""
    j, k = BALL_EULER_AXES[ball, 1], BALL_EULER_AXES[ball, 2]
    sign = 1.0 if j == 1 else -1.0
    cosine = math.hypot(R[j, k], R[k, k])
    b = math.atan2(sign * R[0, k], cosine)
    if cosine < GIMBAL_SINE:
        _decompose_at_gimbal(ball, R, b, reference, values)
        return
    a = math.atan2(-sign * R[j, k], R[k, k])
    if second_cover:
        a, b = a + math.pi, math.pi - b
    values[0], values[1], values[2] = a, b, _third_angle(R, a, b, j, sign)


@njit(cache=True)
def _decompose_at_gimbal(ball, R, b, reference, values):
    """Keeps the first angle's reference value, unless the third would leave its range: then the limit is kept."""
    j, k = BALL_EULER_AXES[ball, 1], BALL_EULER_AXES[ball, 2]
    sign = 1.0 if j == 1 else -1.0
    slot = BALL_ANGLES[ball, 2]
    a = reference[BALL_ANGLES[ball, 0]]
    c = wrap_into_range(_third_angle(R, a, b, j, sign), slot)
    inside = min(max(c, ANGLE_LOW[slot]), ANGLE_HIGH[slot])
    if inside != c:
        c = inside
        rest = R.copy()
        _turn_about_own(rest, k, -c)
        a = math.atan2(sign * rest[k, j], rest[j, j])
    values[0], values[1], values[2] = a, b, c


@njit(cache=True)
def _third_angle(R, a, b, j, sign):
    """c from the first column of (R_x(a) R_j(b))^T R."""
    y = math.cos(a) * R[1, 0] + math.sin(a) * R[2, 0]
    z = math.cos(a) * R[2, 0] - math.sin(a) * R[1, 0]
    along, other = (y, z) if j == 1 else (z, y)
    cosine = math.cos(b) * R[0, 0] - sign * math.sin(b) * other
    return math.atan2(sign * along, cosine)


@njit(cache=True)
def _turning_distance(values, slots, reference):
    total = 0.0
    for k in range(4):
        d = values[k] - reference[slots[k]]
        total += abs(d - TURN * math.floor(d / TURN + 0.5))
    return total


@njit(cache=True)
def euler_axes(ball, angles, axes):
    """axes (3, 3) <- one a row, torso frame: the axes a ball joint's angles turn about (the neck's third is zero)."""
    R = np.eye(3)
    axes[:] = 0.0
    for k in range(3):
        if BALL_ANGLES[ball, k] >= 0:
            axes[k] = R[:, BALL_EULER_AXES[ball, k]]
            _turn_about_own(R, BALL_EULER_AXES[ball, k], angles[BALL_ANGLES[ball, k]])


@njit(cache=True)
def ball_rates(ball, angles, omega, rates):
    """rates (18,) <- the ball joint's Euler rates for its angular velocity omega (3,), torso frame, rad/s.

    The middle axis is perpendicular to the other two, whose singular values are sqrt(1 +- |sin b|): the smaller one
    is kept above SINGULAR_SINE (a damped inverse), so rates stay finite through gimbal lock.
    """
    axes = np.empty((3, 3))
    euler_axes(ball, angles, axes)
    slots = BALL_ANGLES[ball]
    floor = SINGULAR_SINE * SINGULAR_SINE
    middle = omega[0] * axes[1, 0] + omega[1] * axes[1, 1] + omega[2] * axes[1, 2]
    rates[slots[1]] = middle
    if ball == 0:  # only the head's direction counts: omega x head = -cos(b) a' a2 + b' (a2 x head)
        c1, s1 = math.cos(angles[0]), math.sin(angles[0])
        c2, s2 = math.cos(angles[1]), math.sin(angles[1])
        hx, hy, hz = s2, -s1 * c2, c1 * c2
        across = (omega[2] * hx - omega[0] * hz) * c1 + (omega[0] * hy - omega[1] * hx) * s1
        rates[slots[0]] = -across * c2 / max(c2 * c2, floor)
        return
    first = omega[0] * axes[0, 0] + omega[1] * axes[0, 1] + omega[2] * axes[0, 2]
    third = omega[0] * axes[2, 0] + omega[1] * axes[2, 1] + omega[2] * axes[2, 2]
    sine = axes[0, 0] * axes[2, 0] + axes[0, 1] * axes[2, 1] + axes[0, 2] * axes[2, 2]
    side = 1.0 if sine >= 0.0 else -1.0
    together = 0.5 * (first + side * third) / (1.0 + abs(sine))
    apart = 0.5 * (first - side * third) / max(1.0 - abs(sine), floor)
    rates[slots[0]] = together + apart
    rates[slots[2]] = side * (together - apart)
