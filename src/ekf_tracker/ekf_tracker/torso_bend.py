"""How the trunk of the filtered body is bent: a small Kalman filter on what the torso's points say of each other.

The filter's pose moves a rigid torso. A person's shoulders and hips move against it (`stick_figure.trunk_bend`), and so
do the measured points: with the rigid motion eliminated from them (Schur complement), their distances from the torso at
rest measure the bend's seven numbers. These are an Ornstein-Uhlenbeck process, which fades to rest and keeps the spread
that trunks have. The body that the pose is filtered with is bent so.
"""

from __future__ import annotations

import math

import numpy as np

from capture_rig.kernel import njit
from capture_rig.rigid import rigid_transform
from capture_rig.small_matrices import inverse_positive, solve_positive_columns
from stick_figure.body import BEND_NUMBERS, Body
from stick_figure.skeleton import TORSO_POINTS
from stick_figure.trunk_bend import RATE_SD, REST_SD, bend_columns

from .measurement import Measurement

NS = 1e-9
# Thresholds: ranges of spine and collar bone (White & Panjabi; Inman et al. 1944), of three sizes the one that was
# best on the mesh_fit_ sets; rays from the cells of a body's surface; measured by python bench/people.py --ablation
# SESSION.
FEWEST_POINTS = 4  # of neck, shoulders and hips: three leave only what a rigid torso does
FADES_S = 2.0 * (REST_SD / RATE_SD) ** 2
RIGID = 6
_POINTS = TORSO_POINTS[1:]


class TorsoBend:
    """Estimate (7,) of the bend and its covariance, rest and what people bend by at first."""

    def __init__(self, scale: float) -> None:
        """``scale`` : how far trunks bend, over what is usual; 0 for a rigid torso."""
        self._is_rigid, self._rest_variance, self._stamp_ns = scale == 0.0, (scale * REST_SD) ** 2, -1
        self.bend, self.covariance = np.zeros(BEND_NUMBERS), np.diag(self._rest_variance)

    def bent(self, body: Body, stamp_ns: int, z: Measurement) -> Body:
        """Return the body as its trunk is bent in a set of measured points, their covariance what is new in it."""
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
