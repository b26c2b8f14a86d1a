"""How the body is expected to move between two frame sets: strategies with one interface.

A motion model gives the matrices of the prediction step (thesis Table 5.5, with the a-posteriori state and covariance
of the previous set on the right-hand side):

    x <- x (+) F x,     P <- F P F' + Q

over 48 slots, the pose's tangent (24) and its velocity (24). About its own estimate the error of the pose is zero, so
the pose moves by ``F[POSE, VELOCITY] @ v`` and the velocity becomes ``F[VELOCITY, VELOCITY] @ v``. Turning of the
error's own axes during one step is neglected: it is of second order in the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from .slots import DIMENSION, POSE, VELOCITY, per_slot


class MotionModel(Protocol):
    """Strategy for the prediction step."""

    def transition(self, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """F (48, 48) and Q (48, 48) over ``dt`` >= 0 seconds; units m, rad, m/s, rad/s and their products."""
        ...

    def velocity_variance(self) -> np.ndarray:
        """(24,) variance of a velocity of which nothing is known yet, (m/s)^2 and (rad/s)^2."""
        ...


@dataclass(frozen=True)
class DampedVelocity:
    """Constant velocity that fades: dv = -damping v dt + white acceleration, dx = v dt, solved in closed form.

    ``kept`` of the velocity is left after ``reference_period`` seconds, and an acceleration of standard deviation
    ``accelerations`` is drawn anew in each such period. Because the process runs in continuous time (integrated
    Ornstein-Uhlenbeck), the filter behaves alike at every frame rate, and one prediction over a gap equals many
    small ones.

    accelerations : (m/s^2 torso position, rad/s^2 torso rotation, ball joints, hinges)
    """

    accelerations: tuple[float, float, float, float] = (8.0, 30.0, 60.0, 80.0)
    kept: float = 0.9
    reference_period: float = 1 / 40

    @lru_cache(maxsize=8)  # noqa: B019  (frozen, and stamps at a steady rate give the same few dt again and again)
    def transition(self, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """F and Q: F and Q of (dt1 + dt2) are those of dt1 followed by dt2."""
        g = self._damping()
        fade = -math.expm1(-g * dt)  # 1 - e^(-g dt)
        F = np.eye(DIMENSION)
        F[POSE, VELOCITY] = np.eye(24) * (fade / g)
        F[VELOCITY, VELOCITY] *= 1.0 - fade
        density = self._density()
        Q_velocity = density * (fade * (2.0 - fade) / (2.0 * g))
        Q_cross = density * (fade * fade / (2.0 * g * g))
        return _frozen(F), _blocks(density * _position_growth(g, dt), Q_cross, Q_velocity)

    def velocity_variance(self) -> np.ndarray:
        """The variance at which damping and white acceleration balance."""
        return self._density() / (2.0 * self._damping())

    def _damping(self) -> float:
        return -math.log(self.kept) / self.reference_period

    def _density(self) -> np.ndarray:
        # an acceleration a held for one period T adds a^2 T^2 to the velocity's variance: a^2 T a second
        return per_slot(*self.accelerations) ** 2 * self.reference_period


@dataclass(frozen=True)
class Identity:
    """The thesis's model (5.2): A = I, "all the motion can be represented as noise", Q = (rates * dt)^2.

    The pose's part is exactly the thesis's. So that a velocity comes out all the same, the noise is read as a velocity
    drawn anew at every set and held until the next one: it moves the pose by (velocity * dt) and is forgotten.

    rates : (m/s torso position, rad/s torso rotation, ball joints, hinges)
    """

    rates: tuple[float, float, float, float] = (1.0, 1.5, 3.0, 3.0)

    @lru_cache(maxsize=8)  # noqa: B019
    def transition(self, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """F = I on the pose, 0 on the velocity; Q = (rates dt)^2 on the pose."""
        F = np.zeros((DIMENSION, DIMENSION))
        F[POSE, POSE] = np.eye(24)
        variance = self.velocity_variance()
        return _frozen(F), _blocks(variance * dt * dt, variance * dt, variance)

    def velocity_variance(self) -> np.ndarray:
        """The squared rates."""
        return per_slot(*self.rates) ** 2


def _position_growth(g: float, dt: float) -> float:
    """Integral over 0..dt of ((1 - e^(-g s)) / g)^2: the position's variance for white acceleration of density 1."""
    u = g * dt
    if u < 1e-2:  # the closed form below loses all its digits here
        return dt**3 * (1 / 3 - u / 4 + 7 * u * u / 60)
    fade = -math.expm1(-u)
    return (u - 2.0 * fade + fade * (2.0 - fade) / 2.0) / g**3


def _blocks(pose: np.ndarray, cross: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    Q = np.zeros((DIMENSION, DIMENSION))
    slots = np.arange(24)
    Q[slots, slots] = pose
    Q[slots, 24 + slots] = Q[24 + slots, slots] = cross
    Q[24 + slots, 24 + slots] = velocity
    return _frozen(Q)


def _frozen(matrix: np.ndarray) -> np.ndarray:
    matrix.flags.writeable = False
    return matrix
