"""Time-correlated bias of the measured points: covariances that a filter's averaging may not shrink.

A figure fitted to a hull errs in the same way for many sets: the hull is fat on the side that no camera sees, a
shoulder is no single point. Measured on tracked sessions, what is wrong with a fitted point in one set is wrong with it
to about 0.7 a quarter of a second later. With b the bias and v the noise that is new in every set,

    z_k = h(x_k) + b_k + v_k .

A filter that takes b + v as noise averages b away on paper. Its memory, though, is only a few sets (it must follow
limbs that accelerate with 60 rad/s^2), so b stands still while the filter looks, and passes into the estimate in full.
In that limit the covariance of the Schmidt-Kalman (consider) filter is the filter's own P plus the response to b:

    covariance of a point = H P H' + B,     of the pose = P + c (L + 1/cap^2)^-1 L (L + 1/cap^2)^-1,     L = H' B^-1 H.

Its second term is what 15 points with errors B say about 24 slots, and nothing about a slot that they do
not see. They come from one fitted figure and are not independent: c = (numbers measured) / (slots determined) undoes
that they count as if they were. The gain is left alone, so the estimate follows as fast as before.

What lasts is B = share R + sd^2 I: the fit's own covariance of the point (what it does not see now, it does not see in
the next set either), and the distance of the figure's joint from the body's, which no fit knows of.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from capture_rig.small_matrices import inverse3, inverse_positive, symmetrise

from .measurement import add_information
from .settings import MeasurementBiasSettings

N = 24
NEGLIGIBLE_M2 = 1e-12
"""m^2: a micrometre squared. A bias below that is none."""


class MeasurementBias:
    """The covariance of the 15 points' bias, from the sets in which each was last used.

    covariance : (15, 3, 3) m^2; zero for points that were never used.
    """

    def __init__(self, settings: MeasurementBiasSettings) -> None:
        self._share, self._variance = settings.share, settings.sd_m() ** 2
        self.covariance = np.zeros((15, 3, 3))

    def update(self, R: np.ndarray, used: np.ndarray) -> None:
        """Take the covariances (15, 3, 3) m^2 of the points (15,) bool that were used in this set."""
        _update(R, used, self._share, self._variance, self.covariance)


@njit(cache=True)
def _update(R, used, share, variance, bias):
    for point in range(15):
        if used[point]:
            for i in range(3):
                for j in range(3):
                    bias[point, i, j] = share * R[point, i, j]
                bias[point, i, i] += variance[point]


@njit(cache=True)
def add_measurement_bias(at, bias, least_information, points, state):
    """points (15, 3, 3) and state (>= 24, >= 24) += what lasts, as the module's derivation says.

    bias (15, 3, 3) : B of each point; least_information : 1/cap^2, 1/rad^2.
    """
    L, unused, weight, numbers = np.zeros((N, N)), np.zeros(N), np.empty((3, 3)), 0
    for point in range(15):
        if bias[point, 0, 0] + bias[point, 1, 1] + bias[point, 2, 2] > NEGLIGIBLE_M2:
            points[point] += bias[point]
            inverse3(bias[point], weight)
            add_information(at, point, weight, unused, L, unused)
            numbers += 3
    if numbers == 0:
        return
    determined = float(N)
    for i in range(N):
        L[i, i] += least_information
    V = inverse_positive(L)
    for i in range(N):
        determined -= least_information * V[i, i]  # trace of (L + 1/cap^2)^-1 L
    response = V - least_information * np.dot(V, V)  # (L + 1/cap^2)^-1 L (L + 1/cap^2)^-1
    symmetrise(response)
    response *= numbers / determined
    for i in range(N):
        for j in range(N):
            state[i, j] += response[i, j]
