"""How well any method can do on the synthetic experiment: Cramer-Rao bounds, as mean errors of the 15 points.

Fisher information of one frame about the pose's 24 tangent components:

- labelled: every point is known to belong to one place on one stick: sum J'J / sigma^2;
- unlabelled: a point may belong to any place, as in truth. The points are draws from a mixture of Gaussians around all
  places; the information is the score's second moment (the score: each place's pull, weighted with the probability
  that the point is its). It is smaller: which place a point came from is not in the data.

With time: the information of all frames so far passes through the filter's motion model (posterior Cramer-Rao bound,
Tichavsky, Muravchik & Nehorai, IEEE Trans. Signal Processing 46(5), 1998: P <- (F P F' + Q)^-1 + I). That is a bound
over motions as rough as the model allows; on a motion that is smoother than most, a filter can do better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_tracker.measurement import linearised
from ekf_tracker.motion_model import DampedVelocity
from stick_figure.body import Body
from stick_figure.pose import Pose

from .clips import FPS, Clip, SpreadPoints

SETTLED = 10
"""Frames at the start of a clip that do not count: the first pose is the true one."""
BOUND_EVERY = 8
"""The bound takes new information at every so many frames: it changes slowly (a bound 1 % too low)."""
POSE = slice(0, 24)
MOTION = DampedVelocity()
"""The filter's model as it comes: how lively a motion the bound allows."""
DRAWS = 6
KNOWN_START_SD = 1e-2
"""m and rad: every track starts at the true first pose."""
UNSEEN_SD = 1.0
"""rad: what is known of a joint that no point bears on, as in the trackers."""
LENGTH_DRAWS = np.random.default_rng(0).normal(size=(2000, 3))


@dataclass(frozen=True)
class Bounds:
    """Mean error of the 15 points, mm, over a clip: of one frame by itself, and with the motion model."""

    labelled_frame_mm: float
    frame_mm: float
    labelled_mm: float
    mm: float


def bounds(clip: Clip, every: int, settled: int) -> Bounds:
    """The bounds of a clip after its first ``settled`` frames; information at every ``every``-th frame."""
    spread, rng = SpreadPoints.on(clip.body), np.random.default_rng(7)
    frames = range(0, len(clip.poses), every)
    labelled = [labelled_information(spread, clip.poses[f], clip.sigma_m) for f in frames]
    unlabelled = [unlabelled_information(spread, clip.poses[f], clip.sigma_m, rng) for f in frames]
    return Bounds(
        single_frame_mm(clip, labelled, every),
        single_frame_mm(clip, unlabelled, every),
        filtered_mm(clip, labelled, every, settled),
        filtered_mm(clip, unlabelled, every, settled),
    )


def labelled_information(spread: SpreadPoints, pose: Pose, sigma: float) -> np.ndarray:
    """(24, 24) of points whose places are known."""
    J = spread.jacobian(pose).reshape(-1, 24)
    return J.T @ J / sigma**2


def unlabelled_information(spread: SpreadPoints, pose: Pose, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """(24, 24) of as many points without labels: the mean over `DRAWS` draws of the noise."""
    J, centres = spread.jacobian(pose), spread.placed(pose)
    clouds = centres + sigma * rng.normal(size=(DRAWS, *centres.shape))
    scores = np.concatenate([_scores(J, centres, points, sigma) for points in clouds])
    return scores.T @ scores / DRAWS


def _scores(J: np.ndarray, centres: np.ndarray, points: np.ndarray, sigma: float) -> np.ndarray:
    """(n, 24) derivative of each point's log likelihood."""
    exponent = -((points[:, None] - centres) ** 2).sum(2) / (2.0 * sigma**2)
    share = np.exp(exponent - exponent.max(1, keepdims=True))
    share /= share.sum(1, keepdims=True)
    pull = share @ J.reshape(len(J), -1)  # sum of J over the places, weighted
    score = np.einsum("nik,ni->nk", pull.reshape(len(J), 3, 24), points) - share @ np.einsum("nik,ni->nk", J, centres)
    return score / sigma**2


def single_frame_mm(clip: Clip, information: list[np.ndarray], every: int) -> float:
    """Mean over the frames, each by itself."""
    prior = np.eye(24) / UNSEEN_SD**2
    covariances = [np.linalg.inv(near + prior) for near in information]
    errors = [mean_error_mm(clip.body, clip.poses[k * every], C) for k, C in enumerate(covariances)]
    return float(np.mean(errors))


def filtered_mm(clip: Clip, information: list[np.ndarray], every: int, settled: int) -> float:
    """Mean over the frames, with all frames before and the motion model."""
    F, Q = transition(1.0 / FPS)
    P = np.diag(np.concatenate([np.full(24, KNOWN_START_SD**2), MOTION.velocity_variance()]))
    errors = []
    for frame, pose in enumerate(clip.poses):
        near = information[frame // every]
        P = F @ P @ F.T + Q
        gain = P[:, POSE] @ np.linalg.solve(np.eye(24) + near @ P[POSE, POSE], near)
        P = P - gain @ P[POSE, :]
        P = 0.5 * (P + P.T)
        if frame >= settled and frame % every == 0:
            errors.append(mean_error_mm(clip.body, pose, P[POSE, POSE]))
    return float(np.mean(errors))


def transition(dt: float) -> tuple[np.ndarray, np.ndarray]:
    """F and Q (48, 48) of the motion model."""
    t = MOTION.transition(dt)
    F = np.block([[np.eye(24), np.diag(t.f_cross)], [np.zeros((24, 24)), np.diag(t.f_velocity)]])
    Q = np.block([[np.diag(t.q_pose), np.diag(t.q_cross)], [np.diag(t.q_cross), np.diag(t.q_velocity)]])
    return F, Q


def mean_error_mm(body: Body, pose: Pose, covariance: np.ndarray) -> float:
    """Mean length of the 15 points' errors, mm, for a Gaussian error of the pose with this covariance (24, 24)."""
    at, J = linearised(body, pose), np.zeros((15, 3, 24))
    for point, n in enumerate(at.columns):
        J[point][:, at.slots[point, :n]] = at.J[point, :, :n]
    variances = np.linalg.eigvalsh(np.einsum("pik,kl,pjl->pij", J, covariance, J))
    lengths = np.sqrt(np.maximum(variances, 0.0) @ (LENGTH_DRAWS**2).T)
    return 1e3 * float(lengths.mean())
