"""One body being followed: the estimate from its first measurement on, through updates, outliers and gaps."""

from __future__ import annotations

import numpy as np

from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.kinematics import angle_rates
from stick_figure.skeleton import TORSO_POINTS

from .compiled import point_covariances, points_and_jacobian
from .covariance import positive_definite, widened, with_capped_joints, with_negated_slots
from .gate import InnovationGate, Verdict
from .initial import enough_to_start, first_estimate, pose_of_points
from .measurement import Measurement
from .settings import EkfSettings, motion_model
from .slots import HINGES, POSE, VELOCITY, per_slot
from .state import EkfState, assess
from .update import Estimate, copy_of, corrected, innovation_distances, predicted

NS = 1e-9
REFOUND_TORSO_SD_M = 0.5
"""How far the torso may have gone while its points were left out."""
NOBODY_LEFT_OUT = np.zeros(15, bool)


class Track:
    """Estimate and memory of one body that is followed from a first measurement on.

    Needs `initial.enough_to_start` of that measurement. ``repairs`` counts how often rounding had to be mended in
    the covariance; it stays 0.
    """

    def __init__(self, body: Body, settings: EkfSettings, stamp_ns: int, z: Measurement) -> None:
        self.body, self.settings = body, settings
        self.repairs = 0
        self._motion = motion_model(settings)
        self._gate = InnovationGate(settings.gate_chi2, settings.readmit_after_sets)
        self._angles: np.ndarray | None = None
        self._stamp_ns, self._last_dt = stamp_ns, 0.0
        first = first_estimate(body, z, self._motion, settings.joint_sd_cap_rad, settings.iterations)
        self._estimate = self._settled(first)
        self.first_report = self._report(z.visible, NOBODY_LEFT_OUT, np.zeros(15))

    @property
    def blind_s(self) -> float:
        """Seconds from the last measurement that was used to the last prediction."""
        return (self._stamp_ns - self._measured_ns) * NS

    def predict(self, stamp_ns: int) -> None:
        """Move the estimate to a later stamp (thesis Table 5.5).

        A body that has not been measured for ``coast_s`` is no longer extrapolated: its velocity counts as unknown
        from that moment on, because a limb that swung out of sight has more likely turned back than gone on.
        """
        coast_end_ns = self._measured_ns + round(self.settings.coast_s / NS)
        if self._coasting and coast_end_ns < stamp_ns:
            self._advance(coast_end_ns)
            self._forget_velocity()
        self._advance(stamp_ns)

    def update(self, z: Measurement) -> EkfState | None:
        """Correct the estimate with points of the predicted stamp (thesis Table 5.7).

        None when the torso's points have contradicted the prediction for so long that the track has to start anew.
        """
        distances = innovation_distances(self.body, self._estimate, z)
        verdict = self._gate.judge(distances, z.visible)
        if 2 * verdict.readmitted[TORSO_POINTS].sum() >= len(TORSO_POINTS) and enough_to_start(z):
            return None
        if verdict.accepted.any():
            self._estimate = self._settled(self._corrected(z, verdict))
        return self._report(verdict.accepted, verdict.rejected, distances)

    def _corrected(self, z: Measurement, verdict: Verdict) -> Estimate:
        prior, start = self._estimate, None
        if verdict.readmitted.any():  # their limbs are elsewhere: look for them from where the points say
            prior = self._with_refound(prior, verdict.readmitted)
            start = pose_of_points(self.body, z, verdict.accepted, prior.pose)
        return corrected(self.body, prior, z, verdict.accepted, self.settings.iterations, start)

    def _settled(self, estimate: Estimate) -> Estimate:
        """A corrected estimate with its hinges bent the right way and its covariance positive definite."""
        pose, velocity, P = copy_of(estimate.pose), estimate.velocity.copy(), estimate.covariance
        turned = kernels.canonicalise_hinges(pose.R_joints, pose.hinges, velocity, self.settings.hinge_margin_rad)
        if turned:
            P = with_negated_slots(P, HINGES[[bool(turned >> k & 1) for k in range(4)]])
        P, repaired = positive_definite(P)
        self.repairs += repaired
        self._measured_ns, self._coasting = self._stamp_ns, True
        return Estimate(pose, velocity, P)

    def _advance(self, stamp_ns: int) -> None:
        dt = (stamp_ns - self._stamp_ns) * NS
        if dt <= 0.0:
            return
        ahead = predicted(self._estimate, *self._motion.transition(dt))
        P = with_capped_joints(ahead.covariance, self.settings.joint_sd_cap_rad)
        self._estimate = Estimate(ahead.pose, ahead.velocity, P)
        self._stamp_ns, self._last_dt = stamp_ns, dt

    def _forget_velocity(self) -> None:
        slots, P = np.arange(24), self._estimate.covariance.copy()
        P[VELOCITY, :] = P[:, VELOCITY] = 0.0
        P[24 + slots, 24 + slots] = self._motion.velocity_variance()
        self._estimate = Estimate(self._estimate.pose, np.zeros(24), P)
        self._coasting = False

    def _with_refound(self, prior: Estimate, readmitted: np.ndarray) -> Estimate:
        """The prior without any knowledge of the joints above the readmitted points (of the torso, for its own)."""
        _, H = points_and_jacobian(self.body, prior.pose)
        moves = np.any(H[readmitted] != 0.0, axis=(0, 1))
        moves[:6] = readmitted[TORSO_POINTS].any()
        slots = np.flatnonzero(moves)
        cap = self.settings.joint_sd_cap_rad
        pose_variance = per_slot(REFOUND_TORSO_SD_M, cap, cap, cap)[slots] ** 2
        velocity = np.where(moves, 0.0, prior.velocity)
        P = widened(prior.covariance, slots, pose_variance, self._motion.velocity_variance()[slots])
        return Estimate(prior.pose, velocity, P)

    def _report(self, accepted: np.ndarray, gated: np.ndarray, distances: np.ndarray) -> EkfState:
        x, P = self._estimate, self._estimate.covariance
        h, H = points_and_jacobian(self.body, x.pose)
        self._angles = x.pose.angles(self._angles)
        tracking, reason = assess(accepted, gated, self.blind_s, self.settings.lost_after_s)
        return EkfState(
            stamp_ns=self._stamp_ns,
            pose=x.pose,
            velocity=x.velocity,
            drift=self._drift(x.velocity),
            covariance=P,
            angles=self._angles,
            rates=angle_rates(x.pose, x.velocity, self._angles),
            points_world=h,
            point_covariance=point_covariances(H, P[POSE, POSE]),
            accepted=accepted,
            gated=gated,
            distances=distances,
            tracking=tracking,
            reason=reason,
        )

    def _drift(self, velocity: np.ndarray) -> np.ndarray:
        """Mean rate (24,) over a step as long as the last one, by the motion model."""
        if self._last_dt == 0.0:
            return np.zeros(24)
        F, _ = self._motion.transition(self._last_dt)
        return F[POSE, VELOCITY] @ velocity / self._last_dt
