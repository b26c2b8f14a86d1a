"""Soft knowledge about bodies as extra residuals of the articulated solve: the neck's rest, and joint limits.

They keep a joint out of places where the data say nothing (a head that folds into the torso, a knee that points
backward); they are left out of the covariance, which speaks of the data alone.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stick_figure import kernels
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, BALL_ANGLES

NECK_SLOTS = (6, 7)
FLATTEST = 0.2  # cosine of the elevation angle below which a limb's twist angle is too ill defined to be limited
LARGEST_FLEXION = 2.6  # rad, where forearm meets upper arm and calf meets thigh
_TWIST_LOW = np.array([ANGLE_LOW[BALL_ANGLES[m, 2]] for m in range(1, 5)])
_TWIST_HIGH = np.array([ANGLE_HIGH[BALL_ANGLES[m, 2]] for m in range(1, 5)])


@njit(cache=True)
def add_neck_rest(R_neck, rest_pitch, information, H, g):
    """Pull the head's direction to its rest, ``rest_pitch`` rad forward of the torso's axis, with weight 1/rad^2."""
    if information == 0.0:
        return
    rest0, rest2 = np.sin(rest_pitch), np.cos(rest_pitch)
    d0, d1, d2 = R_neck[0, 2], R_neck[1, 2], R_neck[2, 2]
    c0, c1, c2 = d1 * rest2, d2 * rest0 - d0 * rest2, -d1 * rest0  # direction x rest
    sine = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
    if sine == 0.0:
        return
    angle = np.arctan2(sine, d0 * rest0 + d2 * rest2)
    add_scalar(NECK_SLOTS[0], angle * c0 / sine, information, H, g)
    add_scalar(NECK_SLOTS[1], angle * c1 / sine, information, H, g)


@njit(cache=True)
def add_scalar(slot, residual, information, H, g):
    """One residual that acts on one tangent slot."""
    H[slot, slot] += information
    g[slot] += information * residual


@njit(cache=True)
def add_joint_limits(RJ, hinges, information, H, g):
    """Cost, 1/rad^2, on the part of each limb's twist and each hinge's flexion that lies beyond its range."""
    if information == 0.0:
        return
    for h in range(4):
        sign = -1.0 if h < 2 else 1.0  # elbows flex negatively
        excess = sign * hinges[h] - LARGEST_FLEXION
        if excess > 0.0:
            add_scalar(kernels.HINGE_SLOT[h], -sign * excess, information, H, g)
    row = np.zeros(3)
    for m in range(1, 5):
        twist, defined = limb_twist(m, RJ[m], row)
        if not defined:
            continue
        excess = max(twist - _TWIST_HIGH[m - 1], 0.0) + min(twist - _TWIST_LOW[m - 1], 0.0)
        if excess == 0.0:
            continue
        for p in range(3):
            slot = kernels.SLOT_OF_JOINT_AXIS[m, p]
            g[slot] -= information * row[p] * excess
            for q in range(3):
                column = kernels.SLOT_OF_JOINT_AXIS[m, q]
                if slot <= column:
                    H[slot, column] += information * row[p] * row[q]


@njit(cache=True)
def limb_twist(m, R, row):
    """Rotation of ball joint m's limb about itself (rad), and its gradient ``row`` (3,) in the torso's axes.

    Shoulders are Rx Rz Ry, hips Rx Ry Rz; the twist is the last angle. Returns (angle, whether it is well defined):
    it is not when the limb lies nearly along the torso's x axis.
    """
    if m < 3:  # shoulder: R e_y = (-sb, ca cb, sa cb)
        c = np.hypot(R[1, 1], R[2, 1])
        twist = np.arctan2(R[0, 2], R[0, 0])
        y, z = R[1, 1], R[2, 1]
    else:  # hip: R e_z = (sb, -sa cb, ca cb)
        c = np.hypot(R[1, 2], R[2, 2])
        twist = np.arctan2(-R[0, 1], R[0, 0])
        if R[2, 2] < 0.0:  # the thigh points up: the other cover (a + pi, pi - b) is the joint's, its twist is pi away
            twist = np.arctan2(R[0, 1], -R[0, 0])
        y, z = R[1, 2], R[2, 2]
    if c < FLATTEST:
        return 0.0, False
    # the vector with unit component along the twist axis and none along the other two joint axes
    row[0], row[1], row[2] = 0.0, y / (c * c), z / (c * c)
    return twist, True
