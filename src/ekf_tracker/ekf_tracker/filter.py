"""The articulated extended Kalman filter: one measurement of 15 points in, one state out (thesis 5.2, Algorithm 3)."""

from __future__ import annotations

import numpy as np

from capture_rig.errors import InputError
from mocap_packets.state import BodyState, NoState
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

from .measurement import Measurement
from .settings import EkfSettings
from .track import POINT_SD_FLOOR_M, READMIT_AFTER_SETS, Track, enough_to_start

NO_BODY = "waiting for the body"
# Thresholds: judgement, no measurement.
SAME_PERSON_M = 0.06
"""Statures of one person, measured twice, differ by less."""
STATURE_M = 1.75
FRAME_NS = 10_000_000
NONE = np.zeros(15, bool)


class ArticulatedEkf:
    """Follows one body. Deterministic: equal calls give equal bytes.

    Call :meth:`step` once for each frame set, in stamp order; or :meth:`predict` and :meth:`update` one by one.
    """

    def __init__(self, body: Body | None = None, settings: EkfSettings | None = None) -> None:
        """Without a body, sets are answered with NoState until :meth:`follow` brings one."""
        self.body = body
        self.settings = settings or EkfSettings()
        self.reset()

    def reset(self) -> None:
        """Forget the state; the next set with a visible torso starts anew."""
        self._track: Track | None = None
        self._stamp_ns: int | None = None

    def follow(self, body: Body) -> None:
        """Follow this body from the next set on.

        Other sizes of the same person, known better now, leave pose, velocity and their covariance as they are. Sizes
        that differ by more than a T-pose errs are another person's: then the filter starts anew.
        """
        before, self.body = self.body, body
        if before is None or before is body:
            return
        if abs(body.stature - before.stature) > SAME_PERSON_M:
            self.reset()
        elif self._track is not None:
            self._track.change_body(body)

    @property
    def track(self) -> Track:
        """The body's track; ValueError while there is no state."""
        if self._track is None:
            raise ValueError("no track yet")
        return self._track

    @property
    def repairs(self) -> int:
        """How often rounding had to be mended in the covariance of the body that is followed; stays 0."""
        return 0 if self._track is None else self._track.repairs

    def step(
        self,
        stamp_ns: int,
        points_world: np.ndarray,
        covariance: np.ndarray,
        visible: np.ndarray,
        doubtful: np.ndarray = NONE,
        moved: np.ndarray = NONE,
    ) -> BodyState | NoState:
        """Predict to a frame set's stamp, then update with its points: the thesis's Algorithm 3 for one set.

        Arguments as for :meth:`predict` and :meth:`update`; both are checked before the filter moves. doubtful (15,)
        bool : points that may be elsewhere, as whoever measured them says; their covariance has to say it too. moved
        (15,) bool : points that were found in another place: what the filter knew of their limbs was wrong.
        """
        if self.body is None:
            return NoState(stamp_ns, NO_BODY)
        z = Measurement.checked(points_world, covariance, visible, POINT_SD_FLOOR_M)
        return self._update(self.predict(stamp_ns), z, doubtful, moved)

    def is_past(self, stamp_ns: int) -> bool:
        """Return whether a set of this stamp comes too late: not after the last one."""
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

    def update(self, points_world: np.ndarray, covariance: np.ndarray, visible: np.ndarray) -> BodyState | NoState:
        """Correct the state with measured points at the stamp of the last :meth:`predict` (thesis Table 5.7).

        points_world (15, 3) m; covariance (15, 3, 3) m^2; visible (15,) bool: the others are not looked at.
        Raises InputError for points that are not finite or covariances that are none.
        """
        if self._stamp_ns is None:
            raise ValueError("update before the first predict")
        z = Measurement.checked(points_world, covariance, visible, POINT_SD_FLOOR_M)
        return self._update(self._stamp_ns, z, NONE, NONE)

    def _update(self, stamp_ns: int, z: Measurement, doubtful: np.ndarray, moved: np.ndarray) -> BodyState | NoState:
        if self._track is None:
            if not enough_to_start(z):
                return NoState(stamp_ns, f"waiting for the torso: {z.visible.sum()} of 15 points visible")
            return self._start(stamp_ns, z, doubtful)
        lost = self._track.unmeasured_s > self.settings.lost_after_s
        if lost and enough_to_start(z):
            return self._start(stamp_ns, z, doubtful)
        return self._track.update(z, doubtful, moved) or self._start(stamp_ns, z, doubtful)

    def _start(self, stamp_ns: int, z: Measurement, doubtful: np.ndarray) -> BodyState:
        """Take the state from this measurement alone."""
        assert self.body is not None
        self._track = Track(self.body, self.settings, stamp_ns, z)
        return self._track.state(z, z.visible, NONE, doubtful, np.zeros(15))


def warm_up() -> None:
    """Run a filter of its own over some sets, so that compiling does not hold up the first real one."""
    body = Body.from_stature(STATURE_M)
    points = forward(body, Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES))
    covariance = np.tile(np.eye(3) * 1e-4, (15, 1, 1))
    ekf = ArticulatedEkf(body)
    moves_m = (0.0, 0.0, 0.1, *(1.0,) * (READMIT_AFTER_SETS + 1))  # rest, a manoeuvre, a foot out of reach
    for number, move_m in enumerate(moves_m):
        points[-1, 0] += move_m
        ekf.step(FRAME_NS * (1 + number), points, covariance, np.ones(15, bool)).prediction.as_sent()
