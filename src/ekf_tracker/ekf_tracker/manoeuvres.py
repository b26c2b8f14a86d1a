"""Process noise that rises where a limb accelerates: manoeuvre detection by the innovation.

A limb at rest is followed best with little process noise; one that strikes needs a hundred times as much for a few
sets. Which it is, its own measured points tell: while the filter's model holds, the squared Mahalanobis distance of a
point's innovation is chi-square with 3 degrees of freedom. Where it is larger, the process noise of that limb over the
last prediction is raised until it is not (adjustable process noise: Bar-Shalom, Li & Kirubarajan, Estimation with
Applications to Tracking and Navigation, 11.2.2), up to what muscles do. What lies beyond even that is no motion, and is
left to the gate.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit

from .motion_model import Transition

# Thresholds: EXPECTED from the chi-square distribution; the others from speeds and accelerations of punches and
# kicks.
EXPECTED = 14.2
"""Squared distance of an innovation that a process noise explains: chi-square of 3 degrees, 99.7 %, for each limb has
up to six points and each set is a new chance of a false alarm."""
LEVELS = (4.0, 16.0, 64.0)
"""Times the variance of the quiet process noise. The last is eight times its accelerations, 480 to 640 rad/s^2 of the
joints: elbows of punches and knees of kicks reach 20 to 30 rad/s within 0.1 s."""
MOST_M_S = 20.0
"""By how much a point's speed may leave the predicted one: twice what fists of boxers reach. What that explains is
motion, whatever a covariance says that is linear in angles which have turned far."""
TRUNK, HEAD, ARMS, LEGS = 0, 1, (2, 3), (4, 5)
LIMBS = 6
LIMB_OF_POINT = np.array([TRUNK, HEAD, *(TRUNK,) * 5, *ARMS, *LEGS, *ARMS, *LEGS])
LIMB_OF_SLOT = np.array([*(TRUNK,) * 6, HEAD, HEAD, *ARMS * 4, *LEGS * 4])


def raised_covariance(P: np.ndarray, transition: Transition, factors: np.ndarray) -> np.ndarray:
    """Return P (48, 48) as if the process noise of the last transition had been ``factors`` (6,) times as large."""
    more, slots = factors[LIMB_OF_SLOT] - 1.0, np.arange(24)
    P = P.copy()
    P[slots, slots] += more * transition.q_pose
    P[slots, 24 + slots] += more * transition.q_cross
    P[24 + slots, slots] += more * transition.q_cross
    P[24 + slots, 24 + slots] += more * transition.q_velocity
    return P


@njit(cache=True)
def worst_of_limbs(distances):
    """Return (6,) the largest of each limb's squared distances (15,)."""
    worst = np.zeros(LIMBS)
    for point in range(len(LIMB_OF_POINT)):
        limb = LIMB_OF_POINT[point]
        worst[limb] = max(worst[limb], distances[point])
    return worst
