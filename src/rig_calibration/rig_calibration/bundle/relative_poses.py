"""Step 3a: the pose of one camera relative to another, by consensus of all the moments both saw a target.

Every moment offers several relative poses: two planar solutions in each camera, times the turns that hide. The right
ones agree from moment to moment, the wrong ones scatter. The candidate that most moments support wins; then the
supporting moments are averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .rigid import Array, angle_between, orthonormal, transform
from .sighting_poses import SightingPoses

ANGLE_TOLERANCE = np.radians(5.0)  # of the rotation that one board tells
DISTANCE_TOLERANCE = 0.05  # of the distance of the board
CANDIDATE_MOMENTS, VOTING_MOMENTS = 40, 80
AVERAGING_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class RelativePose:
    """``T_b_a`` (4, 4) maps coordinates in camera a to camera b; ``support``: how many moments it is worth."""

    T_b_a: Array
    support: float


@dataclass(frozen=True, eq=False)
class _Offers:
    """What all common moments offer, one row each: rotation a to b, the target's centre in a and in b, weight."""

    R: Array
    centre_a: Array
    centre_b: Array
    weight: Array
    moment: npt.NDArray[np.int64]


def relative_pose(common: Sequence[tuple[SightingPoses, SightingPoses]]) -> RelativePose:
    """The pose of camera b relative to a from what both saw at the same moments: pairs (poses in a, poses in b)."""
    offers = _offers(common)
    voting = _every(len(common), VOTING_MOMENTS)
    candidates = np.flatnonzero(np.isin(offers.moment, _every(len(common), CANDIDATE_MOMENTS)))
    R, t = offers.R[candidates], _translations(offers, candidates)
    votes = _agreement(_only(offers, voting), R, t).sum(axis=1) * (1 + 1e-6 * offers.weight[candidates])
    best = int(np.argmax(np.round(votes, 9)))
    R_b_a, t_b_a = R[best], t[best]
    for _ in range(AVERAGING_ROUNDS):
        R_b_a, t_b_a = _average(offers, R_b_a, t_b_a)
    support = float(_agreement(offers, R_b_a[None], t_b_a[None]).sum())
    return RelativePose(transform(R_b_a, t_b_a), support)


def kernel(angle: Array, distance_ratio: Array) -> Array:
    """How well two poses agree, 1 to 0, that differ by an angle (rad) and by a share of the distance."""
    return 1 / (1 + (angle / ANGLE_TOLERANCE) ** 2 + (distance_ratio / DISTANCE_TOLERANCE) ** 2) ** 2


def _offers(common: Sequence[tuple[SightingPoses, SightingPoses]]) -> _Offers:
    R, centre_a, centre_b, weight, moment = [], [], [], [], []
    for index, (a, b) in enumerate(common):
        for i in np.flatnonzero(a.turn == 0):  # only the turn of one against the other matters
            R.append(b.R @ a.R[i].T)
            centre_a.append(np.tile(a.t[i], (len(b.t), 1)))
            centre_b.append(b.t)
            weight.append(a.weight[i] * b.weight)
            moment.append(np.full(len(b.t), index))
    return _Offers(
        np.concatenate(R),
        np.concatenate(centre_a),
        np.concatenate(centre_b),
        np.concatenate(weight),
        np.concatenate(moment),
    )


def _only(offers: _Offers, moments: npt.NDArray[np.int64]) -> _Offers:
    rows = np.isin(offers.moment, moments)
    return _Offers(
        offers.R[rows], offers.centre_a[rows], offers.centre_b[rows], offers.weight[rows], offers.moment[rows]
    )


def _every(count: int, wanted: int) -> npt.NDArray[np.int64]:
    return np.unique(np.linspace(0, count - 1, min(count, wanted)).round().astype(np.int64))


def _translations(offers: _Offers, rows: npt.NDArray[np.int64]) -> Array:
    return offers.centre_b[rows] - (offers.R[rows] @ offers.centre_a[rows, :, None])[..., 0]


def _row_agreement(offers: _Offers, R: Array, t: Array) -> Array:
    """(candidates, offers) how well each offer agrees with each candidate."""
    miss = np.einsum("cij,oj->coi", R, offers.centre_a) + t[:, None] - offers.centre_b
    ratio = np.linalg.norm(miss, axis=2) / np.linalg.norm(offers.centre_b, axis=1)
    return offers.weight * kernel(angle_between(R, offers.R), ratio)


def _agreement(offers: _Offers, R: Array, t: Array) -> Array:
    """(candidates, moments) the best agreement that each moment offers."""
    starts = np.flatnonzero(np.diff(offers.moment, prepend=-1))
    return np.maximum.reduceat(_row_agreement(offers, R, t), starts, axis=1)


def _average(offers: _Offers, R: Array, t: Array) -> tuple[Array, Array]:
    agreement = _row_agreement(offers, R[None], t[None])[0]
    starts = np.flatnonzero(np.diff(offers.moment, prepend=-1))
    best = np.maximum.reduceat(agreement, starts)[np.cumsum(np.diff(offers.moment, prepend=-1) > 0) - 1]
    weight = np.where(agreement == best, agreement, 0) + 1e-300
    R_mean = orthonormal(np.einsum("o,oij->ij", weight, offers.R))
    shift = offers.centre_b - offers.centre_a @ R_mean.T
    return R_mean, weight @ shift / weight.sum()
