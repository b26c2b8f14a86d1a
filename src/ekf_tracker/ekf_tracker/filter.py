"""The articulated extended Kalman filter: one measurement of 15 points in, one state out (thesis 5.2, Algorithm 3)."""

from __future__ import annotations

import numpy as np

from capture_rig.errors import InputError
from stick_figure.body import Body

from .initial import enough_to_start
from .measurement import Measurement
from .settings import EkfSettings
from .state import EkfState, NoState
from .track import Track

SAME_PERSON_M = 0.06
"""Statures of one person, measured twice, differ by less."""


class ArticulatedEkf:
    """Follows one body. Deterministic: equal calls give equal bytes.

    Call :meth:`step` once for each frame set, in stamp order; or :meth:`predict` and :meth:`update` one by one.
    """

    def __init__(self, body: Body, settings: EkfSettings | None = None) -> None:
        self.body = body
        self.settings = settings or EkfSettings()
        self.reset()

    def reset(self) -> None:
        """Forget the state; the next set with a visible torso starts anew."""
        self._track: Track | None = None
        self._stamp_ns: int | None = None

    def change_body(self, body: Body) -> None:
        """Go on with the same person's sizes as they are known now; pose, velocity and their covariance stay.

        Sizes that differ by more than a T-pose errs are somebody else's: then the filter starts anew.
        """
        somebody_else = abs(body.stature - self.body.stature) > SAME_PERSON_M
        self.body = body
        if somebody_else:
            self.reset()
        elif self._track is not None:
            self._track.change_body(body)

    @property
    def repairs(self) -> int:
        """How often rounding had to be mended in the covariance of the body that is followed; stays 0."""
        return 0 if self._track is None else self._track.repairs

    def step(
        self, stamp_ns: int, points_world: np.ndarray, covariance: np.ndarray, visible: np.ndarray
    ) -> EkfState | NoState:
        """Predict to a frame set's stamp, then update with its points: the thesis's Algorithm 3 for one set.

        Arguments as for :meth:`predict` and :meth:`update`; both are checked before the filter moves.
        """
        z = Measurement.checked(points_world, covariance, visible, self.settings.point_sd_floor_m)
        return self._update(self.predict(stamp_ns), z)

    def is_past(self, stamp_ns: int) -> bool:
        """Whether a set of this stamp comes too late: not after the last one."""
        return self._stamp_ns is not None and stamp_ns <= self._stamp_ns

    def predict(self, stamp_ns: int) -> int:
        """Move the state to ``stamp_ns``, which is returned (thesis Table 5.5). InputError when :meth:`is_past`."""
        if self.is_past(stamp_ns):
            raise InputError(
                f"stamp {stamp_ns} ns is not later than the last one, {self._stamp_ns} ns",
                remedy="Send each frame set once, in stamp order, or reset the tracker.",
            )
        if self._track is not None:
            self._track.predict(stamp_ns)
        self._stamp_ns = stamp_ns
        return stamp_ns

    def update(self, points_world: np.ndarray, covariance: np.ndarray, visible: np.ndarray) -> EkfState | NoState:
        """Correct the state with measured points at the stamp of the last :meth:`predict` (thesis Table 5.7).

        points_world (15, 3) m; covariance (15, 3, 3) m^2; visible (15,) bool: the others are not looked at.
        Raises InputError for points that are not finite or covariances that are none.
        """
        if self._stamp_ns is None:
            raise ValueError("update before the first predict")
        z = Measurement.checked(points_world, covariance, visible, self.settings.point_sd_floor_m)
        return self._update(self._stamp_ns, z)

    def _update(self, stamp_ns: int, z: Measurement) -> EkfState | NoState:
        if self._track is None:
            if not enough_to_start(z):
                return NoState(stamp_ns, f"waiting for the torso: {z.visible.sum()} of 15 points visible")
            return self._start(stamp_ns, z)
        lost = self._track.blind_s > self.settings.lost_after_s
        if lost and enough_to_start(z):
            return self._start(stamp_ns, z)
        return self._track.update(z) or self._start(stamp_ns, z)

    def _start(self, stamp_ns: int, z: Measurement) -> EkfState:
        """Take the state from this measurement alone."""
        self._track = Track(self.body, self.settings, stamp_ns, z)
        return self._track.first_report
