"""A synthetic person for the EKF's tests: a smooth motion, noisy points, and the filter run on them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ekf_tracker.settings import EkfSettings
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

EPOCH_NS = 1_700_000_000_000_000_000
NOISE_M = 0.02
ALL = np.ones(15, bool)
NONE = np.zeros(15, bool)

IDEAL = EkfSettings.of_ideal_figure()
"""For points on the figure itself whose errors are new in every set, as the simulated ones' are."""

BENT_ANGLES = T_POSE_ANGLES.copy()
BENT_ANGLES[8:10], BENT_ANGLES[14:16] = -0.9, 0.8
AMPLITUDES = np.array([0.2, 0.2, 0.4, 0.4, 0.5, 0.5, 0.3, 0.3, 0.6, 0.6, 0.5, 0.4, 0.5, 0.5, 0.6, 0.6, 0.2, 0.2])


@dataclass(frozen=True)
class Person:
    """Smooth motion: every angle a sine of 0.3 to 0.8 Hz about bent limbs, the torso walks, turns and sways."""

    body: Body
    seed: int = 0
    speed: float = 1.0

    def pose(self, t):
        rng = np.random.default_rng(self.seed)
        frequency, phase = self.speed * rng.uniform(0.3, 0.8, 18), rng.uniform(0, 2 * np.pi, 18)
        angles = BENT_ANGLES + AMPLITUDES * np.sin(2 * np.pi * frequency * t + phase)
        turn = [0.1 * np.sin(t), 0.1 * np.cos(t), 0.8 * np.sin(0.9 * self.speed * t)]
        position = [0.6 * np.sin(0.8 * self.speed * t), 0.4 * np.cos(0.5 * self.speed * t), 1.1 + 0.03 * np.sin(6 * t)]
        return Pose.from_angles(np.array(position), Rotation.from_rotvec(turn).as_matrix(), angles)

    def points(self, t):
        return forward(self.body, self.pose(t))


def isotropic(sd):
    """(15, 3, 3) m^2 of points with this standard deviation in every direction."""
    return np.tile(np.eye(3) * sd**2, (15, 1, 1))


def stamp(k, fps=60.0):
    return EPOCH_NS + round(k * 1e9 / fps)


def run(ekf, person, frames, rng=None, visible=None, fps=60.0, noise=NOISE_M, spoil=None, start=0):
    """Feed frames ``start`` to ``start + frames`` of the person: the states and the true points (frames, 15, 3).

    visible(k) -> (15,) bool; spoil(k, points) changes the measured points in place.
    """
    rng = rng or np.random.default_rng(7)
    states, truth = [], []
    for k in range(start, start + frames):
        true = person.points(k / fps)
        measured = true + noise * rng.standard_normal((15, 3))
        if spoil is not None:
            spoil(k, measured)
        states.append(ekf.step(stamp(k, fps), measured, isotropic(noise), ALL if visible is None else visible(k)))
        truth.append(true)
    return states, np.array(truth)


def errors_mm(states, truth):
    """(frames, 15) distances of the filtered points from the true ones, mm."""
    return 1e3 * np.linalg.norm(np.array([s.points_world for s in states]) - truth, axis=2)


def ellipsoid_distances(errors, covariances):
    """Squared Mahalanobis lengths (..., n) of errors (..., n, 3) under covariances (..., n, 3, 3)."""
    return np.einsum("...i,...i->...", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


def dense_matrices(transition):
    """F and Q (48, 48) of a transition."""
    f_cross, f_velocity, q_pose, q_cross, q_velocity = (np.diag(diagonal) for diagonal in transition)
    F = np.block([[np.eye(24), f_cross], [np.zeros((24, 24)), f_velocity]])
    return F, np.block([[q_pose, q_cross], [q_cross, q_velocity]])
