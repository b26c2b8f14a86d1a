"""Which camera does not stand where its calibration says, as the tangents of many frame sets tell.

A difference between two cameras may be either's fault. With many cameras, and a person who moves, all differences of a
camera that was turned by three angles fit these angles. So the angles of all cameras are found together, by least
squares that lets go of outliers (shadows, hidden or missing parts), most cameras being expected to stand well. Then it
is asked of each camera alone how much better the differences are explained if it, and no other, stands badly (model
evidence: MacKay, "Bayesian interpolation", Neural Computation 1992), and better than by a silhouette that is too large
or too small all around.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from .silhouette_tangents import AXES, Array, Tangents

USUAL_RAD, WRONG_RAD = np.radians(0.12), np.radians(1.5)  # angles of calibrations that are sound, and that are not
USUAL_PX, LARGE_PX = 2.0, 10.0  # silhouettes are larger or smaller by so much; and by so much at worst
ALIKE_S = 0.5  # what is wrong with a silhouette lasts about so long: frame sets that follow sooner tell the same
LEAST_NOISE_PX, MOST_NOISE_PX = 0.5, 4.0
LETS_GO = 3.0  # standard deviations
GENTLE_ROUNDS, ROUNDS = 3, 8  # of reweighting: at first outliers are only played down, so that the rest can be found


@dataclass(frozen=True, eq=False)
class Standing:
    """What is known of one camera: how it stands, seen from where its calibration says it stands.

    turn_rad (3,) : rotation vector in the camera's frame (x right, y down, z forward), radians, if it alone is wrong;
    a push aside shows as the turn that does the same to the pictures of the body. sd_rad : standard deviation of the
    size of the turn. gain : how much better that explains all differences than nothing does (twice the logarithm of the
    ratio of probabilities), and gain_growth : how much better a silhouette too large or too small does. fitting : share
    of the camera's differences that fit. count : how many there are.
    """

    turn_rad: Array
    sd_rad: float
    gain: float
    gain_growth: float
    fitting: float
    count: int

    @property
    def size_rad(self) -> float:
        return float(np.linalg.norm(self.turn_rad))


def find_standings(tangents: Sequence[Tangents], cameras: int, step_s: float) -> list[Standing]:
    """How each of the ``cameras`` of a rig stands, by the tangents of frame sets that are ``step_s`` apart."""
    first, second, y, one, other = (np.concatenate(parts) for parts in list(zip(*tangents, strict=True))[:5])
    J = np.hstack([one, other])
    x, weight, noise_px = _fit(first, second, J, y, cameras, min(1.0, step_s / ALIKE_S))
    A, c = _normal_equations(first, second, J, y, weight, cameras)
    scale = min(1.0, step_s / ALIKE_S) / noise_px**2
    A, c = A * scale, c * scale
    nobody, _, _ = _evidence(A, c, _prior(cameras))
    standings = []
    for camera in range(cameras):
        turned, x, covariance = _evidence(A, c, _prior(cameras, wrong=camera))
        grown, _, _ = _evidence(A, c, _prior(cameras, large=camera))
        own = slice(AXES * camera, AXES * camera + 3)
        turn, mine = x[own], (first == camera) | (second == camera)
        along = turn / max(float(np.linalg.norm(turn)), 1e-12)
        fits = np.abs(_residuals(first[mine], second[mine], J[mine], y[mine], x)) < LETS_GO * noise_px
        standings.append(
            Standing(
                turn_rad=turn,
                sd_rad=float(np.sqrt(along @ covariance[own, own] @ along)),
                gain=turned - nobody,
                gain_growth=grown - nobody,
                fitting=float(fits.mean()) if fits.size else 0.0,
                count=int(mine.sum()),
            )
        )
    return standings


def _fit(first, second, J, y, cameras, share):  # type: ignore[no-untyped-def]
    """All cameras' unknowns (4 n,), the weight of each difference, and their noise, pixels.

    A camera that stands badly is allowed to: its prior widens with what is found (Tipping, "Sparse Bayesian learning",
    JMLR 2001).
    """
    x, prior = np.zeros(AXES * cameras), _prior(cameras)
    weight, noise_px = np.ones(len(y)), LEAST_NOISE_PX
    for round_ in range(ROUNDS):
        residual = np.abs(_residuals(first, second, J, y, x))
        noise_px = float(np.clip(np.median(residual) / 0.6745, LEAST_NOISE_PX, MOST_NOISE_PX)) if len(y) else 1.0
        u = residual / (LETS_GO * noise_px)
        weight = 1 / (1 + u) ** 2 if round_ < GENTLE_ROUNDS else 1 / (1 + u * u) ** 2
        A, c = _normal_equations(first, second, J, y, weight, cameras)
        x = np.linalg.solve(A * share / noise_px**2 + np.diag(prior), c * share / noise_px**2)
        sizes = (x.reshape(cameras, AXES)[:, :3] ** 2).sum(1)
        prior.reshape(cameras, AXES)[:, :3] = (1 / (USUAL_RAD**2 + sizes))[:, None]
    return x, weight, noise_px


def _prior(cameras: int, wrong: int | None = None, large: int | None = None) -> Array:
    """(4 n,) precisions: sound calibrations and silhouettes, but for one camera's."""
    prior = np.tile([1 / USUAL_RAD**2] * 3 + [1 / USUAL_PX**2], cameras)
    if wrong is not None:
        prior[AXES * wrong : AXES * wrong + 3] = 1 / WRONG_RAD**2
    if large is not None:
        prior[AXES * large + 3] = 1 / LARGE_PX**2
    return prior


def _evidence(A: Array, c: Array, prior: Array) -> tuple[float, Array, Array]:
    """Twice the logarithm of the probability of the differences (but for what is the same for every prior), the most
    probable unknowns, and their covariance."""
    precision = A + np.diag(prior)
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    x = covariance @ c
    return float(c @ x - np.linalg.slogdet(precision)[1] + np.log(prior).sum()), x, covariance


@njit(cache=True, nogil=True)
def _normal_equations(first, second, J, y, weight, cameras):  # type: ignore[no-untyped-def]
    """The sums J^T W J (4 n, 4 n) and J^T W y (4 n,); each row of J (m, 8) belongs to two cameras."""
    A, c, place = np.zeros((AXES * cameras, AXES * cameras)), np.zeros(AXES * cameras), np.empty(2 * AXES, np.int64)
    for row in range(y.size):
        for k in range(AXES):
            place[k], place[AXES + k] = AXES * first[row] + k, AXES * second[row] + k
        for k in range(2 * AXES):
            c[place[k]] += weight[row] * J[row, k] * y[row]
            for m in range(2 * AXES):
                A[place[k], place[m]] += weight[row] * J[row, k] * J[row, m]
    return A, c


@njit(cache=True, nogil=True)
def _residuals(first, second, J, y, x):  # type: ignore[no-untyped-def]
    """(m,) differences that the unknowns x leave."""
    left: npt.NDArray[np.float64] = y.copy()
    for row in range(y.size):
        for k in range(AXES):
            left[row] -= J[row, k] * x[AXES * first[row] + k] + J[row, AXES + k] * x[AXES * second[row] + k]
    return left
