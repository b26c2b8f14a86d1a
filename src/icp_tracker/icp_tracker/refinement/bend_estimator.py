"""Estimates the bend of a tracked body's trunk, set after set.

Each well explained fit moves the bend by one step (`bend_step`); the next one starts with it. The prior is a Gaussian
about rest and a random walk from set to set.
"""

from __future__ import annotations

import numpy as np

from capture_rig.stamps import NS
from stick_figure.body import BEND_NUMBERS, Body
from stick_figure.least_squares.contour_factor import RayArrays, RayMatch, bend_step
from stick_figure.least_squares.posed_model import BodyModel, PoseState
from stick_figure.pose import Pose
from stick_figure.trunk_bend import RATE_SD, REST_SD, bend_derivatives

from ..articulated_fit import LONGEST_S, PRIOR, ArticulatedSettings
from .shape import FARTHEST_SD

# Thresholds: from the noise model: 1200 rays of about 15000 / m^2 show some 200 cells of the body's surface, three of
# which are one independent datum of 1 cm (`effective_information`).
RAYS_OF_A_DATUM = 25.0  # rays of a fit that count as one independent datum


class TrunkBendEstimator:
    """The bend of one body, zero at first."""

    def __init__(self, settings: ArticulatedSettings) -> None:
        self._settings, self._bend, self._stamp_ns = settings, np.zeros(BEND_NUMBERS), -1
        self._bent: Body | None = None

    @property
    def bend(self) -> np.ndarray:
        """The bend (7,) now, rad and m."""
        return self._bend

    def of(self, body: Body) -> Body:
        """Return a body with the present bend."""
        if not self._bend.any():
            return body
        if self._bent is None or self._bent.unbent is not body:
            self._bent = body.bent(self._bend)
        return self._bent

    def update(self, stamp_ns: int, body: Body, pose: Pose, rays: RayArrays, match: RayMatch) -> None:
        """Move the bend by one Gauss-Newton step on the rays of a fitted set, matched in its pose."""
        since_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        if self._settings.contour.rigid or len(rays.information) == 0 or since_ns < 0:
            return
        passed_s = min((stamp_ns - since_ns) * NS, LONGEST_S)
        rest = RAYS_OF_A_DATUM / REST_SD**2
        walk = RAYS_OF_A_DATUM / RATE_SD**2 / max(passed_s, 1e-3)
        state, figure = PoseState(*pose.arrays), BodyModel.of(self.of(body))
        known = (bend_derivatives(body.straight), PRIOR, rest + walk, -rest * self._bend)
        step = bend_step(rays, match, state, figure, *known)
        farthest = FARTHEST_SD * REST_SD
        self._bend, self._bent = np.clip(self._bend + step, -farthest, farthest), None
