"""The track of one body: an estimate from a first measurement on, predicted and corrected set by set (thesis 5.2)."""

from __future__ import annotations

import numpy as np

from capture_rig.rigid import rigid_transform
from capture_rig.stamps import NS
from mocap_packets.state import BodyState
from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import TORSO_POINTS

from .bias import MeasurementBias, TorsoBend
from .kernels import Estimate, UpdateOptions, correct_estimate, predict_estimate, report
from .measurement import Measurement, Sizes, linearised, squared_distances
from .motion_model import (
    EXPECTED,
    LEVELS,
    LIMBS,
    MOST_M_S,
    NO_TRANSITION,
    MotionModel,
    Transition,
    raised_covariance,
    worst_of_limbs,
)
from .settings import EkfSettings, limit_weight, motion_model
from .state import DIMENSION, POSE, VELOCITY, assess, doubtful_points, per_slot, positive_definite, reset_slots

# Thresholds: NEEDED_TORSO_POINTS from geometry: three may lie on a line; else judgement.
POINT_SD_FLOOR_M = 0.001
"""Least standard deviation of a measured point: a fit to a perfect cloud would claim less."""
JOINT_SD_CAP_RAD = 1.0
"""Predicted standard deviation of a joint at most: beyond it the linearisation of an unobserved twist means nothing.
So much, and as many metres for the torso, is the prior before a first measurement."""
MAX_ITERATIONS = 5
"""Relinearisations of one update at most."""
GATE_CHI2 = 30.0
"""Squared distance of an innovation from which on a point is left out: chi-square of 3 degrees, one in a million."""
COAST_S = 0.1
"""Without measurements for longer than this a limb has more likely turned back than gone on."""
ELSEWHERE_M = 0.1
"""A point that is left out farther away than this makes its limb doubtful; nearer, both say about the same."""
REJECTED_POINT_PRIOR = 0.5
"""Belief in a point that is left out: it is there, or where the filter has it."""
RESIZE_SD_M, RESIZE_SD_RAD = 0.01, 0.04
"""What other sizes of the body change in the pose that suits the same points: a centimetre, also at a limb's end."""
RELEASED_TORSO_SD_M = 0.5
"""How far the torso may have gone while its points were left out."""
NEEDED_TORSO_POINTS = 4
"""Of centre, neck, shoulders and hips; fewer may lie on a line and leave the torso's rotation open."""
ALL = np.ones(24, bool)


class Track:
    """Estimate and memory of one body that is followed from a first measurement on.

    Needs :func:`enough_to_start` of that measurement. ``repairs`` counts how often rounding had to be mended in
    the covariance; it stays 0.
    """

    def __init__(self, body: Body, settings: EkfSettings, stamp_ns: int, z: Measurement) -> None:
        self.settings, self._trunk = settings, TorsoBend(settings.bend)
        self.repairs = 0
        self._motion = motion_model(settings)
        self._left_out = np.zeros(15, bool)  # when each point was last visible
        self._update_options = UpdateOptions(MAX_ITERATIONS, limit_weight(settings))
        self._bias = MeasurementBias(settings.measurement_bias)
        self._last_transition: Transition | None = None
        self._angles: np.ndarray | None = None
        self._stamp_ns, self._last_dt = stamp_ns, 0.0
        noise = self._bias.noise_of(z, POINT_SD_FLOOR_M)
        self.body = self._trunk.bent(body, stamp_ns, noise)
        self._estimate = first_estimate(self.body, noise, self._motion, self._update_options)
        self._F, self._prior = NO_TRANSITION, self._estimate
        self._add_measured(z, z.visible)

    @property
    def passage(self) -> tuple[Estimate, Estimate, np.ndarray]:
        """The estimate before and after the last set's points, and F (48, 48) to the first from the set before."""
        return self._prior, self._estimate, self._F.matrix

    @property
    def lasting(self) -> tuple[np.ndarray, np.ndarray]:
        """What lasts of the points' errors, as `MeasurementBias` has it (copied)."""
        return self._bias.lasting.copy(), self._bias.joints.copy()

    @property
    def unmeasured_s(self) -> float:
        """Seconds from the last measurement that was used to the last prediction."""
        return (self._stamp_ns - self._measured_ns) * NS

    def change_body(self, body: Body) -> None:
        """Go on with other sizes of the same body; the pose is less sure by what they move."""
        self.body = body
        x, slots = self._estimate, np.arange(24)
        P = x.covariance.copy()
        P[slots, slots] += per_slot(RESIZE_SD_M, RESIZE_SD_RAD, RESIZE_SD_RAD, RESIZE_SD_RAD) ** 2
        self._estimate = x._replace(covariance=P)

    def predict(self, stamp_ns: int) -> None:
        """Move the estimate to a later stamp (thesis Table 5.5).

        A body that has not been measured for COAST_S is no longer extrapolated: its velocity counts as unknown
        from that moment on, because a limb that swung out of sight has more likely turned back than gone on.
        """
        self._F = NO_TRANSITION
        coast_end_ns = self._measured_ns + round(COAST_S / NS)
        if self._coasting and coast_end_ns < stamp_ns:
            self._advance(coast_end_ns)
            self._forget_velocity()
        self._advance(stamp_ns)

    def update(self, z: Measurement, doubtful: np.ndarray, moved: np.ndarray) -> BodyState | None:
        """Correct the estimate with points of the predicted stamp (thesis Table 5.7), of which some are doubtful, and
        some were found in another place.

        None when the track has to start anew: the torso was found elsewhere, or its points have contradicted the
        prediction for too long.
        """
        noise = self._bias.noise_of(z, POINT_SD_FLOOR_M)
        self.body = self._trunk.bent(self.body, self._stamp_ns, noise)
        distances, manoeuvre = self._explain_manoeuvres(noise)
        self._prior = self._estimate
        outlying = z.visible & ~moved & (distances > GATE_CHI2)
        readmitted = outlying & self._left_out  # still there in the next set: it is the prediction that is wrong
        left_out, anew = outlying & ~readmitted, readmitted | (moved & z.visible)
        self._left_out = np.where(z.visible, left_out, self._left_out)
        if 2 * np.count_nonzero(anew[TORSO_POINTS]) >= len(TORSO_POINTS) and enough_to_start(z):
            return None
        accepted = z.visible & ~left_out
        if accepted.any():
            self._estimate = self._correct(noise, accepted, anew, manoeuvre)
            self._add_measured(z, accepted)
        return self.state(z, accepted, left_out, doubtful, distances)

    def _explain_manoeuvres(self, z: Measurement) -> tuple[np.ndarray, bool]:
        """Raise the process noise of limbs that accelerate.

        Returns the points' squared distances (15,) after that, and whether any limb's was raised.
        Each limb gets the least that explains its points. One that is out of reach of all keeps the quiet noise: its
        points are errors, or it was lost.
        """
        quiet, factors = self._estimate, np.ones(LIMBS)
        distances = squared_distances(quiet, Sizes.of(self.body), z)
        unexplained = worst_of_limbs(distances) > EXPECTED
        if self._last_transition is None or not unexplained.any():
            return distances, False
        for level in LEVELS:
            factors[unexplained] = level
            self._estimate, distances = self._raised(quiet, factors, z)
            unexplained &= worst_of_limbs(distances) > EXPECTED
            if not unexplained.any():
                return distances, True
        away = np.linalg.norm(z.points_world - forward(self.body, quiet.pose), axis=1)
        distances = np.where(away < MOST_M_S * self._last_dt, 0.0, distances)
        out_of_reach = worst_of_limbs(distances) > GATE_CHI2
        if out_of_reach.any():
            factors[out_of_reach] = 1.0
            self._estimate, _ = self._raised(quiet, factors, z)
        return distances, bool(factors.max() > 1.0)

    def _raised(self, quiet: Estimate, factors: np.ndarray, z: Measurement) -> tuple[Estimate, np.ndarray]:
        assert self._last_transition is not None
        P = raised_covariance(quiet.covariance, self._last_transition, factors)
        raised = quiet._replace(covariance=P)
        return raised, squared_distances(raised, Sizes.of(self.body), z)

    def _correct(self, z: Measurement, accepted: np.ndarray, anew: np.ndarray, manoeuvre: bool) -> Estimate:
        """Return the estimate with the accepted points (15,); the limbs of those ``anew`` are elsewhere."""
        prior = self._estimate
        released = bool(anew.any())
        if released:
            prior = self._prior = self._release_limbs(prior, anew)
        start = prior.arrays
        if manoeuvre or released:  # angles that turned far: the way there is not straight, so start at its end
            start = pose_of_points(self.body, z, accepted, prior.pose).arrays
        rest, sizes = (start, z, accepted, self._update_options), Sizes.of(self.body)
        try:
            return correct_estimate(sizes, prior, *rest)
        except ValueError:
            self.repairs += 1
            return correct_estimate(sizes, prior._replace(covariance=positive_definite(prior.covariance)), *rest)

    def _add_measured(self, z: Measurement, used: np.ndarray) -> None:
        self._bias.update(z.covariance, used)
        self._measured_ns, self._coasting = self._stamp_ns, True

    def _advance(self, stamp_ns: int) -> None:
        dt = (stamp_ns - self._stamp_ns) * NS
        if dt <= 0.0:
            return
        self._last_transition = self._motion.transition(dt)
        self._estimate = predict_estimate(self._estimate, self._last_transition, JOINT_SD_CAP_RAD)
        self._F = self._F.then(self._last_transition)
        self._stamp_ns, self._last_dt = stamp_ns, dt

    def _forget_velocity(self) -> None:
        slots, P = np.arange(24), self._estimate.covariance.copy()
        P[VELOCITY, :] = P[:, VELOCITY] = 0.0
        P[24 + slots, 24 + slots] = self._motion.velocity_variance()
        self._estimate = self._estimate._replace(velocity=np.zeros(24), covariance=P)
        self._coasting = False
        self._F = self._F.keeping(ALL, ~ALL)

    def _release_limbs(self, prior: Estimate, anew: np.ndarray) -> Estimate:
        """The prior without any knowledge of the joints above the points (15,) ``anew`` (of the torso, for its own)."""
        at, moves = linearised(self.body, prior.pose), np.zeros(24, bool)
        for point in np.flatnonzero(anew):
            moves[at.slots[point, 6 : at.columns[point]]] = True
        moves[:6] = anew[TORSO_POINTS].any()
        slots = np.flatnonzero(moves)
        cap = JOINT_SD_CAP_RAD
        pose_variance = per_slot(RELEASED_TORSO_SD_M, cap, cap, cap)[slots] ** 2
        velocity = np.where(moves, 0.0, prior.velocity)
        self._F = self._F.keeping(~moves, ~moves)
        P = reset_slots(prior.covariance, slots, pose_variance, self._motion.velocity_variance()[slots])
        return prior._replace(velocity=velocity, covariance=P)

    def state(
        self, z: Measurement, accepted: np.ndarray, gated: np.ndarray, doubtful: np.ndarray, distances: np.ndarray
    ) -> BodyState:
        """Return the state after points (15,) bool were used, left out, and doubtful; and their squared distances.

        A point that was left out far away is as likely there as here: its covariance spans the way.
        """
        x, pose = self._estimate, self._estimate.pose
        self._angles = pose.angles(self._angles)
        lasting = self._bias.lasting, self._bias.joints, JOINT_SD_CAP_RAD**-2
        points_world, point_covariance, covariance, rates = report(x, Sizes.of(self.body), *lasting, self._angles)
        far = inflate_covariance_along(z.points_world - points_world, gated, point_covariance)
        doubtful = doubtful_points(doubtful, far)
        tracking, reason = assess(accepted, gated, doubtful, self.unmeasured_s, self.settings.lost_after_s)
        return BodyState(
            stamp_ns=self._stamp_ns,
            pose=pose,
            velocity=x.velocity,
            predicted_velocity=self._predicted_velocity(x.velocity),
            covariance=covariance,
            bend=self.body.bend,
            angles=self._angles,
            rates=rates,
            points_world=points_world,
            point_covariance=point_covariance,
            accepted=accepted,
            gated=gated,
            distances=distances,
            doubtful=doubtful,
            tracking=tracking,
            reason=reason,
        )

    def _predicted_velocity(self, velocity: np.ndarray) -> np.ndarray:
        """Mean rate (24,) over a step as long as the last one, by the motion model."""
        if self._last_dt == 0.0:
            return np.zeros(24)
        return self._motion.transition(self._last_dt).f_cross * velocity / self._last_dt


def inflate_covariance_along(way: np.ndarray, left_out: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Widen the covariances (15, 3, 3), in place, of points that were left out farther away than ELSEWHERE_M.

    Each then spans the way (15, 3) m to where the point was measured, in which there is some belief. Returns (15,) bool
    which.
    """
    far: np.ndarray = left_out & (np.linalg.norm(way, axis=1) > ELSEWHERE_M)
    covariance[far] += REJECTED_POINT_PRIOR * way[far, :, None] * way[far, None, :]
    return far


def enough_to_start(z: Measurement) -> bool:
    """Return whether the visible points fix the torso."""
    return int(np.count_nonzero(z.visible[TORSO_POINTS])) >= NEEDED_TORSO_POINTS


def first_estimate(body: Body, z: Measurement, motion: MotionModel, options: UpdateOptions) -> Estimate:
    """Pose by inverse kinematics, then one update of a wide prior about it, so that the covariance is the points' own.

    Joints that no visible point bears on keep the T-pose and the prior's standard deviation; the velocity is unknown.
    Needs :func:`enough_to_start`.
    """
    resting = Pose.from_angles(*_torso_of(body, z), T_POSE_ANGLES)
    pose = pose_of_points(body, z, z.visible, resting)
    P = np.zeros((DIMENSION, DIMENSION))
    P[POSE, POSE] = JOINT_SD_CAP_RAD**2 * np.eye(24)
    P[VELOCITY, VELOCITY] = np.diag(motion.velocity_variance())
    prior = Estimate(pose.arrays, np.zeros(24), P)
    return correct_estimate(Sizes.of(body), prior, prior.arrays, z, z.visible, options)


def pose_of_points(body: Body, z: Measurement, chosen: np.ndarray, otherwise: Pose) -> Pose:
    """Inverse kinematics of the chosen points (15,) bool; the rest stands as in the pose ``otherwise``."""
    points = np.where(chosen[:, None], z.points_world, forward(body, otherwise))
    return inverse(body, points, otherwise)


def _torso_of(body: Body, z: Measurement) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and rotation (3, 3) of the torso: rigid fit of its visible points (Procrustes)."""
    seen = z.visible[TORSO_POINTS]
    R, t = rigid_transform(body.torso_points[seen], z.points_world[TORSO_POINTS][seen])
    return t, R
