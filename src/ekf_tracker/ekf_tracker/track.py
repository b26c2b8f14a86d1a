"""The track of one body: an estimate from a first measurement on, predicted and corrected set by set (thesis 5.2)."""

from __future__ import annotations

import numpy as np

from capture_rig.rigid import rigid_transform
from capture_rig.stamps import NS
from mocap_packets.fit import PART_OF_POINT
from mocap_packets.state import BodyState, Tracking
from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import TORSO_POINTS

from .bias import MeasurementBias, TrunkBendFilter
from .kernels import Estimate, UpdateOptions, correct_estimate, predict_estimate, report
from .measurement import Measurement, Sizes, linearised, squared_distances
from .motion_model import DIMENSION, EXPECTED, NO_TRANSITION, POSE, VELOCITY, MotionModel, per_slot
from .settings import EkfSettings, motion_model

# Thresholds: NEEDED_TORSO_POINTS from geometry: three may lie on a line; else judgement.
POINT_SD_FLOOR_M = 0.001
"""Least standard deviation of a measured point: a fit to a perfect cloud would claim less."""
JOINT_SD_CAP_RAD = 1.0
"""Predicted standard deviation of a joint at most: beyond it the linearisation of an unobserved twist means nothing.
So much, and as many metres for the torso, is the prior before a first measurement."""
MAX_ITERATIONS = 5
"""Relinearisations of one update at most."""
COAST_S = 0.1
"""Without measurements for longer than this a limb has more likely turned back than gone on."""
RELEASED_TORSO_SD_M = 0.5
"""How far off the torso may be, some of whose points were found elsewhere."""
NEEDED_TORSO_POINTS = 4
"""Of centre, neck, shoulders and hips; fewer may lie on a line and leave the torso's rotation open."""
ALL = np.ones(24, bool)


class BodyTrack:
    """Estimate and memory of one body that is tracked from a first measurement on.

    Needs :func:`enough_to_start` of that measurement. ``body`` may be set to other sizes of the same body.
    """

    def __init__(self, body: Body, settings: EkfSettings, stamp_ns: int, z: Measurement) -> None:
        self.settings, self._trunk = settings, TrunkBendFilter(settings.bend)
        self._motion = motion_model(settings)
        limit_weight = 1.0 / settings.limit_sd_rad**2 if settings.limit_sd_rad else 0.0
        self._update_options = UpdateOptions(MAX_ITERATIONS, limit_weight)
        self._bias = MeasurementBias(settings.measurement_bias)
        self._last_transition = self._motion.transition(0.0)
        self._angles: np.ndarray | None = None
        self._stamp_ns, self._last_dt = stamp_ns, 0.0
        noise = self._bias.noise_of(z, POINT_SD_FLOOR_M)
        self.body = self._trunk.bent(body, stamp_ns, noise)
        self._estimate = first_estimate(self.body, noise, self._motion, self._update_options)
        self._F, self._prior = NO_TRANSITION, self._estimate
        self._add_measured(z)
        self._seen = z.visible

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
        """Correct the estimate with the points of the predicted stamp (thesis Table 5.7), of which some are doubtful,
        and some were found in another place.

        The state of a limb that was found elsewhere, or has moved by more since the set before than the process noise
        explains, is released. None when that is the torso: the track has to be restarted.
        """
        noise = self._bias.noise_of(z, POINT_SD_FLOOR_M)
        self.body = self._trunk.bent(self.body, self._stamp_ns, noise)
        sizes, prior = Sizes.of(self.body), self._estimate
        distances = squared_distances(prior, sizes, noise)
        anew = moved | z.visible & self._seen & (distances > EXPECTED)
        if 2 * np.count_nonzero(anew[TORSO_POINTS]) >= len(TORSO_POINTS) and enough_to_start(z):
            return None
        start = prior.arrays
        if anew.any():
            prior = self._release_limbs(prior, anew)
            # angles turned far, a curved path: linearise at its end first
            start = pose_of_points(self.body, noise, prior.pose).arrays
        self._estimate = self._prior = prior
        if z.visible.any():
            self._estimate = correct_estimate(sizes, prior, start, noise, self._update_options)
            self._add_measured(z)
        self._seen = z.visible
        return self.state(z, doubtful, distances)

    def _add_measured(self, z: Measurement) -> None:
        self._bias.update(z.covariance, z.visible)
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
        """Return the prior with the joints above the points (15,) ``anew`` unknown (of the torso, for its own)."""
        at, moves = linearised(self.body, prior.pose), np.zeros(24, bool)
        for point in np.flatnonzero(anew):
            moves[at.slots[point, 6 : at.columns[point]]] = True
        moves[:6] = anew[TORSO_POINTS].any()
        self._F = self._F.keeping(~moves, ~moves)
        both, P = np.flatnonzero(np.tile(moves, 2)), prior.covariance.copy()
        pose_sd = per_slot(RELEASED_TORSO_SD_M, JOINT_SD_CAP_RAD, JOINT_SD_CAP_RAD, JOINT_SD_CAP_RAD)
        P[both, :] = P[:, both] = 0.0
        P[both, both] = np.concatenate([pose_sd**2, self._motion.velocity_variance()])[both]
        return prior._replace(velocity=np.where(moves, 0.0, prior.velocity), covariance=P)

    def state(self, z: Measurement, doubtful: np.ndarray, distances: np.ndarray) -> BodyState:
        """Return the state after the visible points of z, of which some (15,) bool are doubtful; their squared
        distances."""
        x, pose, dt = self._estimate, self._estimate.pose, self._last_dt
        self._angles = pose.angles(self._angles)
        lasting = self._bias.lasting, self._bias.joints, JOINT_SD_CAP_RAD**-2
        points_world, point_covariance, covariance, rates = report(x, Sizes.of(self.body), *lasting, self._angles)
        doubtful = np.isin(PART_OF_POINT, PART_OF_POINT[doubtful])  # a doubtful point makes its part of the body so
        tracking, reason = assess(z.visible, doubtful, self.unmeasured_s, self.settings.lost_after_s)
        return BodyState(
            stamp_ns=self._stamp_ns,
            pose=pose,
            velocity=x.velocity,
            predicted_velocity=self._last_transition.f_cross * x.velocity / dt if dt else np.zeros(24),
            covariance=covariance,
            bend=self.body.bend,
            angles=self._angles,
            rates=rates,
            points_world=points_world,
            point_covariance=point_covariance,
            accepted=z.visible,
            distances=distances,
            doubtful=doubtful,
            tracking=tracking,
            reason=reason,
        )


def assess(used: np.ndarray, doubtful: np.ndarray, unmeasured_s: float, lost_after_s: float) -> tuple[Tracking, str]:
    """Trust in the estimate, from the points used and doubtful (15,) and the seconds since any was used."""
    if unmeasured_s > lost_after_s:
        return Tracking.LOST, f"no usable point for {unmeasured_s:.2f} s"
    if not used.any():
        return Tracking.DOUBTFUL, f"no visible point for {unmeasured_s:.2f} s"
    if doubtful.all():
        return Tracking.DOUBTFUL, f"{used.sum()} points used, every part of the body may be elsewhere"
    return Tracking.TRACKING, f"{used.sum()} points used"


def enough_to_start(z: Measurement) -> bool:
    """Return whether the visible points fix the torso."""
    return int(np.count_nonzero(z.visible[TORSO_POINTS])) >= NEEDED_TORSO_POINTS


def first_estimate(body: Body, z: Measurement, motion: MotionModel, options: UpdateOptions) -> Estimate:
    """Start from inverse kinematics, then one update of a wide prior, so that the covariance is the points' own.

    Joints that no visible point determines keep the T-pose and the prior's standard deviation; the velocity is unknown.
    Needs :func:`enough_to_start`.
    """
    resting = Pose.from_angles(*_torso_of(body, z), T_POSE_ANGLES)
    pose = pose_of_points(body, z, resting)
    P = np.zeros((DIMENSION, DIMENSION))
    P[POSE, POSE] = JOINT_SD_CAP_RAD**2 * np.eye(24)
    P[VELOCITY, VELOCITY] = np.diag(motion.velocity_variance())
    prior = Estimate(pose.arrays, np.zeros(24), P)
    return correct_estimate(Sizes.of(body), prior, prior.arrays, z, options)


def pose_of_points(body: Body, z: Measurement, otherwise: Pose) -> Pose:
    """Inverse kinematics of the visible points; the rest stands as in the pose ``otherwise``."""
    points = np.where(z.visible[:, None], z.points_world, forward(body, otherwise))
    return inverse(body, points, otherwise)


def _torso_of(body: Body, z: Measurement) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and rotation (3, 3) of the torso: rigid fit of its visible points (Procrustes)."""
    seen = z.visible[TORSO_POINTS]
    R, t = rigid_transform(body.torso_points[seen], z.points_world[TORSO_POINTS][seen])
    return t, R
