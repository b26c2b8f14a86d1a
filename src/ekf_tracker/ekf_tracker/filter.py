"""The articulated extended Kalman filter: one measurement of 15 points in, one state out (thesis 5.2, Algorithm 3).

`PeopleFilter` has one for each person.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from capture_rig.errors import InputError
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.people import FittedPeople, body_numbers
from mocap_packets.state import BodyState, NoState
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

from .measurement import Measurement
from .settings import EkfSettings
from .track import POINT_SD_FLOOR_M, BodyTrack, enough_to_start

NO_BODY = "waiting for the body"
# Thresholds: judgement, no measurement.
SAME_PERSON_M = 0.06
"""Statures of one person, measured twice, differ by less."""
FRAME_NS = 10_000_000
NONE = np.zeros(15, bool)


class ArticulatedEkf:
    """Tracks one body. Deterministic: equal calls give equal bytes.

    Call :meth:`step` once for each frame set, in stamp order.
    """

    def __init__(self, body: Body | None = None, settings: EkfSettings | None = None) -> None:
        """Without a body, sets are answered with NoState until :meth:`set_body` brings one."""
        self.body = body
        self.settings = settings or EkfSettings()
        self.reset()

    def reset(self) -> None:
        """Forget the state; the next set with a visible torso starts a new track."""
        self._track: BodyTrack | None = None
        self._stamp_ns: int | None = None

    def set_body(self, body: Body) -> None:
        """Track this body from the next set on.

        Refined sizes of the same person keep pose, velocity and their covariance. Sizes that differ by more than the
        error of a T-pose are another person's: then the filter restarts.
        """
        before = self.body
        if body is before or (before is not None and body_numbers(body) == body_numbers(before)):
            return
        self.body = body
        if before is None:
            return
        if abs(body.stature - before.stature) > SAME_PERSON_M:
            self.reset()
        elif self._track is not None:
            self._track.body = body

    @property
    def track(self) -> BodyTrack:
        """The body's track; ValueError while there is no state."""
        if self._track is None:
            raise ValueError("no track yet")
        return self._track

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

        points_world (15, 3) m; covariance (15, 3, 3) m^2; visible (15,) bool: the others' numbers do not matter.
        doubtful (15,) bool : points that may be elsewhere, by the tracker, with a covariance to match. moved (15,)
        bool : points that were found in another place: the filter's state of their limbs was wrong. Raises InputError,
        before the filter moves, for a stamp that is not later than the last one, points that are not finite, and
        invalid covariances.
        """
        z = Measurement.checked(points_world, covariance, visible, POINT_SD_FLOOR_M)
        return self.step_measured(stamp_ns, z, doubtful, moved)

    def step_measured(
        self, stamp_ns: int, z: Measurement, doubtful: np.ndarray = NONE, moved: np.ndarray = NONE
    ) -> BodyState | NoState:
        """Predict and update with a checked measurement."""
        if self.body is None:
            return NoState(stamp_ns, NO_BODY)
        if self._stamp_ns is not None and stamp_ns <= self._stamp_ns:
            raise InputError(
                f"stamp {stamp_ns} ns is not later than the last one, {self._stamp_ns} ns",
                remedy="Send each frame set once, in stamp order, or reset the tracker.",
            )
        if self._track is not None:
            self._track.predict(stamp_ns)
        self._stamp_ns = stamp_ns
        if self._track is None and not enough_to_start(z):
            return NoState(stamp_ns, f"waiting for the torso: {z.visible.sum()} of 15 points visible")
        if self._track is not None:
            lost = self._track.unmeasured_s > self.settings.lost_after_s and enough_to_start(z)
            if not lost and (state := self._track.update(z, doubtful, moved)) is not None:
                return state
        self._track = BodyTrack(self.body, self.settings, stamp_ns, z)  # from this measurement alone
        return self._track.state(z, doubtful, np.zeros(15))


class PeopleFilter:
    """One filter for every person that is measured. Deterministic: equal calls give equal bytes.

    The first person's filter always exists. Others are made with a person's first measurement and dropped with the
    first set without one.
    """

    def __init__(self, settings: EkfSettings | None = None) -> None:
        self._settings = settings or EkfSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everybody's state, and bodies, which come with the measurements again."""
        self._filters = {FIRST_PERSON: ArticulatedEkf(None, self._settings)}

    def of(self, person: int) -> ArticulatedEkf:
        """Return the filter of a person that is tracked; KeyError for anybody else."""
        return self._filters[person]

    @property
    def bodies(self) -> Mapping[int, Body]:
        """The filters' bodies, by person."""
        return {person: ekf.body for person, ekf in self._filters.items() if ekf.body is not None}

    def step(self, people: FittedPeople) -> dict[int, BodyState | NoState]:
        """Predict everybody to a frame set and update with their points; drop persons that are not measured.

        Raises InputError, before any filter moves, for points that are not finite or invalid covariances.
        """
        measured = {
            person: (Measurement.checked(points, covariance, visible, POINT_SD_FLOOR_M), doubtful, moved)
            for person, (points, covariance, visible, doubtful, moved) in sorted(people.points.of.items())
        }
        for person in [person for person in self._filters if person not in measured and person != FIRST_PERSON]:
            del self._filters[person]
        answers: dict[int, BodyState | NoState] = {}
        for person, (z, doubtful, moved) in measured.items():
            ekf = self._filters.setdefault(person, ArticulatedEkf(None, self._settings))
            if (body := people.bodies.get(person)) is not None:
                ekf.set_body(body)
            answers[person] = ekf.step_measured(people.stamp_ns, z, doubtful, moved)
        return answers


def warm_up() -> None:
    """Run a filter over some made-up sets, so that compiling does not delay the first real one."""
    body = Body.from_stature(1.75)
    points = forward(body, Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES))
    covariance = np.tile(np.eye(3) * 1e-4, (15, 1, 1))
    ekf = ArticulatedEkf(body)
    moves_m = (0.0, 0.0, 0.1, 1.0, 1.0)  # rest, a fast limb, a foot out of reach
    for number, move_m in enumerate(moves_m):
        points[-1, 0] += move_m
        prediction = ekf.step(FRAME_NS * (1 + number), points, covariance, np.ones(15, bool)).prediction
        assert prediction.pose is not None and len(prediction.velocity) == 24
