"""Motion models of the body between two frame sets: strategies with one interface.

A motion model gives the matrices of the prediction step (thesis Table 5.5, with the a-posteriori state and covariance
of the previous set on the right-hand side):

    x <- x (+) F x,     P <- F P F' + Q

over 48 slots, the pose's tangent (24) and its velocity (24). Every slot moves by itself, so the blocks of F and Q are
diagonal. About its own estimate the error of the pose is zero, so the pose moves by ``f_cross v`` and the velocity
becomes ``f_velocity v``. Turning of the error's own axes during one step is neglected: it is of second order.

The process noise is that of quiet movement. While the model holds, the squared Mahalanobis distance of a point's
innovation is chi-square with 3 degrees of freedom; beyond EXPECTED the limb strikes or was elsewhere before, and its
state is released (`track.BodyTrack.update`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from stick_figure.kernels import HINGE_SLOT

POSE, VELOCITY = slice(0, 24), slice(24, 48)
DIMENSION = 48
# Thresholds: from the chi-square distribution.
EXPECTED = 14.2
"""Squared distance of an innovation that a process noise explains: chi-square of 3 degrees, 99.7 %, for each limb has
up to six points and each set is a new chance of a false alarm."""


def per_slot(torso_position: float, torso_rotation: float, ball_joints: float, hinges: float) -> np.ndarray:
    """Return (24,) one number for every tangent slot, by the kind of its joint."""
    values = np.full(24, ball_joints)
    values[0:3] = torso_position
    values[3:6] = torso_rotation
    values[HINGE_SLOT] = hinges
    return values


class Transition(NamedTuple):
    """Diagonals (24,) of the blocks of F and Q.

    F = [[I, f_cross], [0, f_velocity]], Q = [[q_pose, q_cross], [q_cross, q_velocity]].
    Units m, rad, m/s, rad/s and their products.
    """

    f_cross: np.ndarray
    f_velocity: np.ndarray
    q_pose: np.ndarray
    q_cross: np.ndarray
    q_velocity: np.ndarray


class StateTransition(NamedTuple):
    """F over several steps, some of which may forget slots: [[pose, cross], [0, velocity]], diagonals (24,)."""

    pose: np.ndarray
    cross: np.ndarray
    velocity: np.ndarray

    def then(self, step: Transition) -> StateTransition:
        """F of another step times this."""
        return StateTransition(self.pose, self.cross + step.f_cross * self.velocity, step.f_velocity * self.velocity)

    def keeping(self, pose: np.ndarray, velocity: np.ndarray) -> StateTransition:
        """Return the prediction restricted to these slots (24,) bool of pose and velocity."""
        return StateTransition(pose * self.pose, pose * self.cross, velocity * self.velocity)

    @property
    def matrix(self) -> np.ndarray:
        """F (48, 48)."""
        return np.block([[np.diag(self.pose), np.diag(self.cross)], [np.zeros((24, 24)), np.diag(self.velocity)]])


NO_TRANSITION = StateTransition(np.ones(24), np.zeros(24), np.ones(24))
"""F over no time."""


@dataclass(frozen=True)
class DampedVelocity:
    """Constant velocity that fades: dv = -damping v dt + white acceleration, dx = v dt, solved in closed form.

    The share ``kept`` of the velocity remains after ``reference_period`` seconds, and an acceleration of standard
    deviation ``accelerations`` is drawn in each such period. Because the process runs in continuous time (integrated
    Ornstein-Uhlenbeck), the filter behaves alike at every frame rate, and one prediction over a gap equals many
    small ones.

    accelerations : (m/s^2 torso position, rad/s^2 torso rotation, ball joints, hinges)
    """

    accelerations: tuple[float, float, float, float] = (8.0, 30.0, 60.0, 80.0)
    kept: float = 0.9
    reference_period: float = 1 / 40

    @lru_cache(maxsize=8)  # noqa: B019  (frozen, and stamps at a steady rate give the same few dt again and again)
    def transition(self, dt: float) -> Transition:
        """F and Q over ``dt`` >= 0 seconds: F and Q of (dt1 + dt2) are those of dt1 followed by dt2."""
        g = self._damping()
        fade = -math.expm1(-g * dt)  # 1 - e^(-g dt)
        density = self._density()
        return _frozen(
            f_cross=np.full(24, fade / g),
            f_velocity=np.full(24, 1.0 - fade),
            q_pose=density * _position_growth(g, dt),
            q_cross=density * (fade * fade / (2.0 * g * g)),
            q_velocity=density * (fade * (2.0 - fade) / (2.0 * g)),
        )

    def velocity_variance(self) -> np.ndarray:
        """Return (24,) the variance, (m/s)^2 and (rad/s)^2, at which damping and white acceleration balance."""
        return self._density() / (2.0 * self._damping())

    def _damping(self) -> float:
        return -math.log(self.kept) / self.reference_period

    def _density(self) -> np.ndarray:
        # an acceleration a held for one period T adds a^2 T^2 to the velocity's variance: a^2 T a second
        return per_slot(*self.accelerations) ** 2 * self.reference_period


@dataclass(frozen=True)
class Identity:
    """The thesis's model (5.2): A = I, "all the motion can be represented as noise", Q = (rates * dt)^2.

    The pose's part is exactly the thesis's. To provide a velocity, the noise is taken as a velocity drawn at every set
    and held until the next one: it moves the pose by (velocity * dt) and is forgotten.

    rates : (m/s torso position, rad/s torso rotation, ball joints, hinges)
    """

    rates: tuple[float, float, float, float] = (1.0, 1.5, 3.0, 3.0)

    @lru_cache(maxsize=8)  # noqa: B019
    def transition(self, dt: float) -> Transition:
        """F = I on the pose, 0 on the velocity; Q = (rates dt)^2 on the pose."""
        variance = self.velocity_variance()
        return _frozen(
            f_cross=np.zeros(24),
            f_velocity=np.zeros(24),
            q_pose=variance * dt * dt,
            q_cross=variance * dt,
            q_velocity=variance,
        )

    def velocity_variance(self) -> np.ndarray:
        """Return the squared rates."""
        return per_slot(*self.rates) ** 2


MotionModel = DampedVelocity | Identity


def _position_growth(g: float, dt: float) -> float:
    """Integral over 0..dt of ((1 - e^(-g s)) / g)^2: the position's variance for white acceleration of density 1."""
    u = g * dt
    if u < 1e-2:  # the closed form below loses all its digits here
        return dt**3 * (1 / 3 - u / 4 + 7 * u * u / 60)
    fade = -math.expm1(-u)
    return (u - 2.0 * fade + fade * (2.0 - fade) / 2.0) / g**3


def _frozen(**diagonals: np.ndarray) -> Transition:
    for diagonal in diagonals.values():
        diagonal.flags.writeable = False
    return Transition(**diagonals)
