"""How the trunk of the filtered body is bent: a small Kalman filter on what the torso's points say of each other.

The filter's pose moves a rigid torso. A person's shoulders and hips move against it (`stick_figure.trunk_bend`), and so
do the measured points: with the rigid motion eliminated from them (Schur complement), their distances from the torso at
rest measure the bend's seven numbers. These are an Ornstein-Uhlenbeck process, which fades to rest and keeps the spread
that trunks have. The body that the pose is filtered with is bent so.
"""

from __future__ import annotations

import numpy as np

from capture_rig.rigid import rigid_transform
from stick_figure.body import BEND_NUMBERS, Body
from stick_figure.skeleton import TORSO_POINTS
from stick_figure.trunk_bend import RATE_SD, REST_SD, bend_columns

from .measurement import Measurement

NS = 1e-9
FEWEST_POINTS = 4  # of neck, shoulders and hips: three leave only what a rigid torso does
FADES_S = 2.0 * (REST_SD / RATE_SD) ** 2
RIGID = 6
_POINTS = TORSO_POINTS[1:]
_DIAGONAL = np.diag_indices(BEND_NUMBERS)


class TorsoBend:
    """Estimate (7,) of the bend and its covariance, rest and what people bend by at first."""

    def __init__(self, scale: float) -> None:
        """``scale`` : how far trunks bend, over what is usual; 0 for a rigid torso."""
        self._scale, self._stamp_ns = scale, -1
        self.bend, self.covariance = np.zeros(BEND_NUMBERS), np.diag((scale * REST_SD) ** 2)

    def bent(self, body: Body, stamp_ns: int, z: Measurement) -> Body:
        """Return the body as its trunk is bent in a set of measured points, their covariance what is new in it."""
        if self._scale == 0.0:
            return body
        self._fade(stamp_ns)
        seen = z.visible[_POINTS]
        if seen.sum() >= FEWEST_POINTS:
            self._look(body.straight, z.points_world[_POINTS][seen], z.covariance[_POINTS][seen], seen)
        return body.bent(self.bend)

    def _fade(self, stamp_ns: int) -> None:
        passed_s = 0.0 if self._stamp_ns < 0 else (stamp_ns - self._stamp_ns) * NS
        self._stamp_ns = stamp_ns
        kept = np.exp(-passed_s / FADES_S)
        self.bend = kept * self.bend
        self.covariance = self.covariance * np.outer(kept, kept)
        self.covariance[_DIAGONAL] += (1.0 - kept**2) * (self._scale * REST_SD) ** 2

    def _look(self, rest: Body, points_world: np.ndarray, covariance: np.ndarray, seen: np.ndarray) -> None:
        """Take the points (n, 3) m of those ``seen`` (5,) with their covariance (n, 3, 3) m^2."""
        own = rest.torso_points[1:][seen]
        R, t = rigid_transform(own, points_world)
        sd = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3.0)[:, None]
        columns = bend_columns(rest)[seen] / sd[..., None]
        A, off = columns.reshape(-1, RIGID + BEND_NUMBERS), (((points_world - t) @ R - own) / sd).ravel()
        M, g = A.T @ A, A.T @ off
        eliminated = np.linalg.solve(M[:RIGID, :RIGID], np.hstack([M[:RIGID, RIGID:], g[:RIGID, None]]))
        information = M[RIGID:, RIGID:] - M[RIGID:, :RIGID] @ eliminated[:, :-1]
        pull = g[RIGID:] - M[RIGID:, :RIGID] @ eliminated[:, -1]
        before = np.linalg.inv(self.covariance)
        self.covariance = np.linalg.inv(before + information)
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
        self.bend = self.covariance @ (before @ self.bend + pull)
