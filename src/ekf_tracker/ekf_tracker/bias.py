"""Two states beside the filter's rigid figure: the trunk's bend, and the time-correlated bias of measured points.

**Bend.** A person's shoulders and hips move against the torso (`stick_figure.trunk_bend`), and so do the measured
points: with the torso's motion eliminated from them (Schur complement), their distances from it at rest measure the
bend's seven numbers. These are an Ornstein-Uhlenbeck process, which fades to rest with the standard deviation of
trunks.

**Bias.** The errors of a figure fitted to a hull last for many sets: the hull is fat on the side that no camera sees, a
shoulder is no single point. With b the bias and v the noise that is new in every set,

    z_k = h(x_k) + b_k + v_k,     cov b = share R,     cov v = (1 - share) R,

R the covariance of the fit. The filter's gain is that of v alone: it cannot average b away, and would only lag behind
the body if it tried. Its memory is a few sets (limbs accelerate), in which b is constant, so b passes into the estimate
in full. In that limit the covariance of the Schmidt-Kalman (consider) filter is the filter's own P plus the response to
b:

    covariance of a point = H P H' + B,     of the pose = P + c (L + 1/cap^2)^-1 L (L + 1/cap^2)^-1,     L = H' B^-1 H.

Its second term is the covariance of 24 slots from 15 points with errors B, zero for a slot that no point determines.
The points come from one fitted figure and are not independent: c = (numbers measured) / (slots determined) corrects for
that.

The bias has B = share R + the distance of the figure's joint from the person's, which no fit can measure: a marker set,
a neural network and a radiograph place a hip centimetres apart. Round numbers from the literature on landmarks located
from the outside:

- hip: centres regressed from the pelvis are 20 to 30 mm off (Bell, Pedersen & Brand 1990; Leardini et al., J. Biomech.
  32, 1999), those of pose networks 30 to 50 mm (Needham et al., Sci. Rep. 11, 2021), mostly forward and up.
- neck: anything from the seventh vertebra to the notch of the breastbone, 10 cm in front of it: evenly spread, 29 mm.
  The torso's centre is half way between neck and hips and has half of both.
- shoulder, elbow, knee, ankle: palpated landmarks differ by 10 to 20 mm between examiners, bony ones at the ankle least
  (Della Croce et al., Gait & Posture 21, 2005); networks put the knee as far off as the hip.
- head: the crown under hair. Hand: a fist is up to 85 mm shorter than the stretched hand: evenly spread, 25 mm along.

They were rounded by their coverage on the studio's and the three rendered sessions, the real one with four cameras and
the first of the mesh people. They are too large for rendered people, from whose surfaces the figure's was learnt, but
not for the real one.
"""

from __future__ import annotations

import math

import numpy as np

from capture_rig.kernel import njit
from capture_rig.rigid import rigid_transform
from capture_rig.small_matrices import inverse3, inverse_positive, solve_positive_columns, symmetrise
from capture_rig.stamps import NS
from stick_figure import kernels
from stick_figure.body import BEND_NUMBERS, Body
from stick_figure.skeleton import POINT_STICK, TORSO_POINTS
from stick_figure.trunk_bend import RATE_SD, REST_SD, bend_columns

from .measurement import Measurement, add_information
from .settings import MeasurementBiasSettings

N = 24

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
# Thresholds: ranges of spine and collar bone (White & Panjabi; Inman et al. 1944), of three sizes the one that was
# best on the mesh_fit_ sets; rays from the cells of a body's surface; measured by python bench/people.py --ablation.
FEWEST_POINTS = 4  # of neck, shoulders and hips: three determine a rigid torso alone
FADES_S = 2.0 * (REST_SD / RATE_SD) ** 2
RIGID = 6
_POINTS = TORSO_POINTS[1:]


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
        """Return the measurement with the covariance of its new noise, with the floor's deviation an axis at least."""
        least = self._share * least_sd_m**2 * np.eye(3)  # 1 - share of it is in the covariance already
        return Measurement(z.points_world, (1.0 - self._share) * z.covariance + least, z.visible)


@njit(cache=True)
def add_measurement_bias(at, pose, lasting, joints, least_information, points, state):
    """points (15, 3, 3) and state (>= 24, >= 24) += covariance of the bias, by the module's derivation.

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
        if B[0, 0] + B[1, 1] + B[2, 2] > 0.0:
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


class TrunkBendFilter:
    """Estimate (7,) of the bend and its covariance, at first rest and people's spread."""

    def __init__(self, scale: float) -> None:
        """``scale`` : standard deviations over the usual ones; 0 for a rigid torso."""
        self._is_rigid, self._rest_variance, self._stamp_ns = scale == 0.0, (scale * REST_SD) ** 2, -1
        self.bend, self.covariance = np.zeros(BEND_NUMBERS), np.diag(self._rest_variance)

    def bent(self, body: Body, stamp_ns: int, z: Measurement) -> Body:
        """Update the bend with a set of measured points, covariance of their new noise; return the bent body."""
        if self._is_rigid:
            return body
        passed_s = 0.0 if self._stamp_ns < 0 else (stamp_ns - self._stamp_ns) * NS
        self._stamp_ns, rest = stamp_ns, body.straight
        self.bend, self.covariance = fade(self.bend, self.covariance, passed_s, self._rest_variance)
        if np.count_nonzero(z.visible[_POINTS]) >= FEWEST_POINTS:
            self.bend, self.covariance = correct(
                self.bend, self.covariance, rest.torso_points[1:], bend_columns(rest), z
            )
        return body.bent(self.bend)


@njit(cache=True, nogil=True)
def fade(bend, covariance, passed_s, rest_variance):
    """Bend and covariance after seconds in which nothing was measured: an Ornstein-Uhlenbeck process (7,)."""
    kept = np.exp(-passed_s / FADES_S)
    faded = covariance * np.outer(kept, kept)
    for k in range(BEND_NUMBERS):
        faded[k, k] += (1.0 - kept[k] ** 2) * rest_variance[k]
    return kept * bend, faded


@njit(cache=True, nogil=True)
def correct(bend, covariance, rest, columns, z):
    """Bend and covariance corrected with the visible ones of neck, shoulders and hips (a Kalman update).

    rest (5, 3) m : these points of the body at rest, torso frame; columns (5, 3, 13) : `bend_columns` of it.
    """
    seen = np.flatnonzero(z.visible[_POINTS])
    points_world, own = z.points_world[_POINTS[seen]], rest[seen]
    R, t = rigid_transform(own, points_world)
    off = np.dot(points_world - t, R) - own
    rows = np.empty((len(seen), 3, RIGID + BEND_NUMBERS + 1))  # derivatives, then residuals, each over its deviation
    for k, point in enumerate(seen):
        C = z.covariance[_POINTS[point]]
        sd = math.sqrt((C[0, 0] + C[1, 1] + C[2, 2]) / 3.0)
        rows[k, :, :-1] = columns[point] / sd
        rows[k, :, -1] = off[k] / sd
    A = rows.reshape(3 * len(seen), -1)
    M = np.dot(A.T, A)
    across, factor = M[:RIGID, RIGID:].copy(), np.empty((RIGID, RIGID))
    eliminated = across.copy()
    solve_positive_columns(M[:RIGID, :RIGID], factor, eliminated)
    M_bend = M[RIGID:, RIGID:] - np.dot(across.T, eliminated)  # Schur complement: any rigid motion suits as well
    information, pull = M_bend[:-1, :-1], M_bend[:-1, -1]
    before = inverse_positive(covariance)
    after = inverse_positive(before + information)
    return np.dot(after, np.dot(before, bend) + pull), after
