"""Time-correlated bias of the measured points: covariances that a filter's averaging may not shrink.

A figure fitted to a hull errs in the same way for many sets: the hull is fat on the side that no camera sees, a
shoulder is no single point. With b the bias and v the noise that is new in every set,

    z_k = h(x_k) + b_k + v_k,     cov b = share R,     cov v = (1 - share) R,

R the covariance that the fit states. The filter's gain is that of v alone: it cannot average b away, and would only lag
behind the body if it tried. Its memory is a few sets (it follows limbs that accelerate), so b stands still while the
filter looks, and passes into the estimate in full. In that limit the covariance of the Schmidt-Kalman (consider) filter
is the filter's own P plus the response to b:

    covariance of a point = H P H' + B,     of the pose = P + c (L + 1/cap^2)^-1 L (L + 1/cap^2)^-1,     L = H' B^-1 H.

Its second term is what 15 points with errors B say about 24 slots, and nothing about a slot that they do
not see. They come from one fitted figure and are not independent: c = (numbers measured) / (slots determined) undoes
that they count as if they were.

What lasts is B = share R + the distance of the figure's joint from the person's (`joint_uncertainty`), of which no fit
can know.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import inverse3, inverse_positive, symmetrise
from stick_figure import kernels
from stick_figure.skeleton import POINT_STICK

from .joint_uncertainty import JOINT_SD_M
from .measurement import Measurement, add_information
from .settings import MeasurementBiasSettings

N = 24
# Thresholds: rounding from arithmetic.
NEGLIGIBLE_M2 = 1e-12
"""m^2: a micrometre squared. A bias below that is none."""


class MeasurementBias:
    """What is known of the 15 points' bias, from the sets in which each was last used.

    lasting (15, 3, 3) m^2, world frame : share R; zero for points that were never used.
    joints (15, 3) m^2, along the axes of each point's stick : of the joints; zero for points that were never used.
    """

    def __init__(self, settings: MeasurementBiasSettings) -> None:
        self._share, self._joints = settings.share, (settings.joints * JOINT_SD_M) ** 2
        self.lasting, self.joints = np.zeros((15, 3, 3)), np.zeros((15, 3))

    def update(self, R: np.ndarray, used: np.ndarray) -> None:
        """Take the covariances (15, 3, 3) m^2 that the fit states of the points (15,) bool used in this set."""
        _take_used(used, self._share, R, self._joints, self.lasting, self.joints)

    def noise_of(self, z: Measurement, least_sd_m: float) -> Measurement:
        """Return the measurement with the covariance of what is new in this set; at least that deviation an axis."""
        return Measurement(z.points_world, _noise(z.covariance, self._share, least_sd_m**2), z.visible)


@njit(cache=True)
def _take_used(used, share, R, variances, lasting, joints):
    for point in range(15):
        if used[point]:
            lasting[point] = share * R[point]
            joints[point] = variances[point]


@njit(cache=True)
def _noise(covariance, share, least_variance):
    noise = (1.0 - share) * covariance
    for point in range(15):
        for i in range(3):
            noise[point, i, i] += share * least_variance  # 1 - share of it is in the covariance already
    return noise


@njit(cache=True)
def add_measurement_bias(at, pose, lasting, joints, least_information, points, state):
    """points (15, 3, 3) and state (>= 24, >= 24) += what lasts, as the module's derivation says.

    lasting, joints : of :class:`MeasurementBias`; least_information : 1/cap^2, 1/rad^2.
    """
    L, unused, weight, numbers = np.zeros((N, N)), np.zeros(N), np.empty((3, 3)), 0
    _, R0, RJ, hinges = pose
    G, axes, B = np.empty((10, 3, 3)), np.empty((18, 3)), np.empty((3, 3))
    kernels.stick_frames(R0, RJ, hinges, G, axes)
    for point in range(15):
        frame = G[POINT_STICK[point]]
        for i in range(3):
            for j in range(3):
                B[i, j] = lasting[point, i, j]
                for k in range(3):
                    B[i, j] += frame[i, k] * joints[point, k] * frame[j, k]
        if B[0, 0] + B[1, 1] + B[2, 2] > NEGLIGIBLE_M2:
            points[point] += B
            inverse3(B, weight)
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
