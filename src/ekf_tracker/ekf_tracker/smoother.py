"""Offline smoothing of a take: the filter forwards, then Rauch, Tung & Striebel backwards on the manifold of poses.

With x_k, P_k the filter's estimate after set k, x'_{k+1}, P'_{k+1} its prediction of the next set, and F between them,

    G = P_k F' P'_{k+1}^-1,    x^s_k = x_k (+) G (x^s_{k+1} (-) x'_{k+1}),    P^s_k = P_k + G (P^s_{k+1} - P'_{k+1}) G'

(Rauch, Tung & Striebel, AIAA Journal 3, 1965; differences in the tangent of the pose, as for the filter itself). So a
set without points, or with doubtful ones, is filled from both sides, with a covariance that grows with the distance to
the nearest observed one. Where the filter lost a limb and found it elsewhere, or restarted, nothing passes back.

Smoothing does not remove the bias of the points (`bias`); it is added as the filter adds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_packets.fit import ReferencePoints
from mocap_packets.state import BodyState, NoState
from stick_figure.body import Body
from stick_figure.pose import Pose

from .filter import ArticulatedEkf
from .kernels import Estimate, report
from .measurement import Sizes
from .motion_model import POSE, VELOCITY
from .settings import EkfSettings
from .track import JOINT_SD_CAP_RAD, BodyTrack

# Thresholds: rounding from arithmetic.
SMALLEST_VARIANCE = 1e-12
"""What is below this (1 micrometre, 1 microradian) is rounding, not knowledge."""


@dataclass(frozen=True, eq=False)
class Set:
    """One frame set of a take: its stamp, the fitted points, and the body tracked then (None: none yet)."""

    stamp_ns: int
    points: ReferencePoints
    body: Body | None


@dataclass(frozen=True, eq=False)
class _Filtered:
    """A set's data for the backward pass: the state, its track, the estimate before and after the set's points, F
    (48, 48) from the set before, and the points' `MeasurementBias`."""

    state: BodyState
    track: BodyTrack
    body: Body
    before: Estimate
    after: Estimate
    F: np.ndarray
    lasting: np.ndarray
    joints: np.ndarray


def smooth(sets: Iterable[Set], settings: EkfSettings | None = None) -> list[BodyState | NoState]:
    """Return the state at every set, in order, from all sets before and after it. Stamps must rise."""
    answers, runs = _filter(sets, settings)
    for first, run in runs:
        answers[first : first + len(run)] = _states(run, _backwards(run))
    return answers


def _filter(
    sets: Iterable[Set], settings: EkfSettings | None
) -> tuple[list[BodyState | NoState], list[tuple[int, list[_Filtered]]]]:
    """Filter forwards; return the answers, and the uninterrupted runs of one track with the index of their first."""
    ekf, answers = ArticulatedEkf(None, settings), list[BodyState | NoState]()
    runs = list[tuple[int, list[_Filtered]]]()
    for number, one in enumerate(sets):
        if one.body is not None:
            ekf.set_body(one.body)
        answer = ekf.step(one.stamp_ns, *one.points)
        answers.append(answer)
        if not isinstance(answer, BodyState):
            continue
        track = ekf.track
        found = _Filtered(answer, track, track.body, *track.passage, *track.lasting)
        if runs and runs[-1][1][-1].track is track and runs[-1][0] + len(runs[-1][1]) == number:
            runs[-1][1].append(found)
        else:
            runs.append((number, [found]))
    return answers, runs


def _backwards(run: Sequence[_Filtered]) -> list[Estimate]:
    """Rauch-Tung-Striebel pass over the estimates before and after each set's points, F from the set before."""
    smoothed = [run[-1].after]
    for found, following in zip(run[-2::-1], run[:0:-1], strict=True):
        x, predicted, later = found.after, following.before, smoothed[-1]
        G = np.linalg.solve(predicted.covariance, following.F @ x.covariance).T
        away = np.concatenate([later.pose.minus(predicted.pose), later.velocity - predicted.velocity])
        step = G @ away
        P = positive_definite(x.covariance + G @ (later.covariance - predicted.covariance) @ G.T)
        pose = x.pose.retract(step[POSE])
        smoothed.append(Estimate(pose.arrays, x.velocity + step[VELOCITY], P))
    return smoothed[::-1]


def positive_definite(P: np.ndarray) -> np.ndarray:
    """P (n, n) made symmetric, with its eigenvalues raised where rounding spoilt them."""
    eigenvalues, vectors = np.linalg.eigh(P)
    mended = (vectors * np.maximum(eigenvalues, SMALLEST_VARIANCE)) @ vectors.T
    return 0.5 * (mended + mended.T)


def _states(run: Sequence[_Filtered], smoothed: Sequence[Estimate]) -> list[BodyState | NoState]:
    states, angles = list[BodyState | NoState](), None
    for found, x in zip(run, smoothed, strict=True):
        pose = Pose(*x.arrays)
        angles = pose.angles(angles)
        reported = report(x, Sizes.of(found.body), found.lasting, found.joints, JOINT_SD_CAP_RAD**-2, angles)
        points_world, point_covariance, covariance, rates = reported
        known = {"pose": pose, "velocity": x.velocity, "covariance": covariance, "angles": angles, "rates": rates}
        of_points = {"points_world": points_world, "point_covariance": point_covariance}
        states.append(replace(found.state, **known, **of_points))
    return states
