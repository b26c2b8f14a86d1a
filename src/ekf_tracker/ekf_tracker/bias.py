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

What lasts is B = share R + the distance of the figure's joint from the person's, of which no fit can know.

A figure whose surface lies exactly on a person's still does not know where in the flesh that person's joint is, nor
what another source means by its name: a marker set, a neural network and a radiograph place a hip centimetres apart.
The deviations are round numbers from what is known of landmarks that are located from the outside:

- hip: centres regressed from the pelvis are 20 to 30 mm off (Bell, Pedersen & Brand 1990; Leardini et al., J. Biomech.
  32, 1999), those of pose networks 30 to 50 mm (Needham et al., Sci. Rep. 11, 2021), mostly forward and up.
- neck: anything from the seventh vertebra to the notch of the breastbone, 10 cm in front of it: evenly spread, 29 mm.
  The torso's centre is half way between neck and hips and has half of both.
- shoulder, knee, ankle: palpated landmarks differ by 10 to 20 mm between examiners, bony ones at the ankle least (Della
  Croce et al., Gait & Posture 21, 2005), and a joint's centre is the mean of two or more; networks put the knee as far
  off as the hip.
- head: the crown under hair, and a head that no other stick holds upright.
- hand: a fist is up to 85 mm shorter than the stretched hand that ends the stick: evenly spread, 25 mm along it. It
  turns about the wrist, which the forearm's stick does not have.
- elbow: as the shoulder, and a fist pushes the forearm's stick back.

They were rounded while looking at their coverage on the studio's and the three rendered sessions, the
real one with four cameras and the first of the mesh people: none of these is a proof of them. For rendered people,
whose joints are those of the surfaces that the figure's was learnt from, they are too large; for the real one not.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import inverse3, inverse_positive, symmetrise
from stick_figure import kernels
from stick_figure.skeleton import POINT_STICK

from .measurement import Measurement, add_information
from .settings import MeasurementBiasSettings

N = 24
# Thresholds: rounding from arithmetic.
NEGLIGIBLE_M2 = 1e-12
"""m^2: a micrometre squared. A bias below that is none."""

# m; in the frame of the point's stick: torso, head, thigh, calf forward, left, up; arms with y along the arm
_TORSO, _HEAD, _NECK = (0.018, 0.008, 0.009), (0.014, 0.010, 0.014), (0.029, 0.009, 0.012)
_SHOULDER, _HIP, _ELBOW = (0.013, 0.009, 0.013), (0.022, 0.009, 0.014), (0.020, 0.016, 0.012)
_KNEE, _HAND, _FOOT = (0.013, 0.006, 0.013), (0.014, 0.025, 0.018), (0.014, 0.007, 0.011)

# Thresholds: from regressions of hip centres and the precision of palpated landmarks (Bell et al. 1990; Leardini et
# al. 1999; Della Croce et al. 2005); judgement.
JOINT_SD_M = np.array(
    [
        *(_TORSO, _HEAD, _NECK),
        *(_SHOULDER, _SHOULDER, _HIP, _HIP),
        *(_ELBOW, _ELBOW, _KNEE, _KNEE, _HAND, _HAND, _FOOT, _FOOT),
    ]
)
"""(15, 3) standard deviations, m, in the order of `stick_figure.skeleton.POINT_NAMES`."""


class MeasurementBias:
    """What is known of the 15 points' bias, from the sets in which each was last used.

    lasting (15, 3, 3) m^2, world frame : share R; zero for points that were never used.
    joints (15, 3) m^2, along the axes of each point's stick : of the joints; zero for points that were never used.
    """

    def __init__(self, settings: MeasurementBiasSettings) -> None:
        self._share, self._joints = settings.share, (settings.joints * JOINT_SD_M) ** 2
        self.lasting, self.joints = np.zeros((15, 3, 3)), np.zeros((15, 3))

    def update(self, R: np.ndarray, used: np.ndarray) -> None:
        """Use the covariances (15, 3, 3) m^2 that the fit states of the points (15,) bool used in this set."""
        self.lasting[used], self.joints[used] = self._share * R[used], self._joints[used]

    def noise_of(self, z: Measurement, least_sd_m: float) -> Measurement:
        """Return the measurement with the covariance of what is new in this set; at least that deviation an axis."""
        least = self._share * least_sd_m**2 * np.eye(3)  # 1 - share of it is in the covariance already
        return Measurement(z.points_world, (1.0 - self._share) * z.covariance + least, z.visible)


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
