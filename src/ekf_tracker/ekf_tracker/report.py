"""What the filter publishes of a state, computed from it (compiled)."""

from __future__ import annotations

import numpy as np
from numba import njit

from stick_figure.euler import ball_rates
from stick_figure.kernels import HINGE_SLOT, SLOT_OF_JOINT_AXIS
from stick_figure.skeleton import HINGE_ANGLES

from .lasting_errors import add_lasting_errors
from .linearised import empty_linearised, linearise, point_covariance


@njit(cache=True)
def report(pose, velocity, P, lengths, origins, lasting, least_information, angles):
    """Points (15, 3), their covariances (15, 3, 3), the state's covariance (48, 48), rates (18,) of the angles (18,).

    Both covariances include the errors that last: ``lasting`` and ``least_information`` of `lasting_errors`.
    """
    at, points, state = empty_linearised(), np.empty((15, 3, 3)), P.copy()
    linearise(pose, lengths, origins, at)
    for point in range(15):
        point_covariance(at, point, P, points[point])
    add_lasting_errors(at, lasting, least_information, points, state)
    _, _, _, hinges = pose
    return at.h, points, state, rates_of_angles(hinges, velocity, angles)


@njit(cache=True)
def rates_of_angles(hinges, velocity, angles):
    """(18,) rad/s of the angles (18,), for a tangent velocity (24,) and the pose's own hinges (4,).

    Equals `stick_figure.kinematics.angle_rates`, at a filter's pace.
    Angles may describe a hinge the other way round than the pose; its rate then has the other sign.
    """
    rates, omega = np.zeros(18), np.empty(3)
    for ball in range(5):
        for k in range(3):
            slot = SLOT_OF_JOINT_AXIS[ball, k]
            omega[k] = velocity[slot] if slot >= 0 else 0.0
        ball_rates(ball, angles, omega, rates)
    for h in range(4):
        reported = angles[HINGE_ANGLES[h]]
        turned = abs(reported + hinges[h]) < abs(reported - hinges[h])
        rates[HINGE_ANGLES[h]] = -velocity[HINGE_SLOT[h]] if turned else velocity[HINGE_SLOT[h]]
    return rates
