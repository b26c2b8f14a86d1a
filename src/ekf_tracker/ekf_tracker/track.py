"""One body being followed: the estimate from its first measurement on, through updates, outliers and gaps."""

from __future__ import annotations

import numpy as np

from stick_figure.body import Body
from stick_figure.skeleton import TORSO_POINTS

from .covariance import positive_definite, widened
from .gate import InnovationGate, Verdict
from .initial import enough_to_start, first_estimate, pose_of_points
from .lasting_errors import LastingErrors
from .linearised import linearised
from .measurement import Measurement
from .report import report
from .settings import EkfSettings, limit_weight, motion_model
from .slots import VELOCITY, per_slot
from .state import EkfState, assess
from .update import Estimate, Iteration, corrected, innovation_distances, predicted

NS = 1e-9
REFOUND_TORSO_SD_M = 0.5
"""How far the torso may have gone while its points were left out."""
RESIZED_M, RESIZED_RAD = 0.01, 0.04
"""What other sizes of the body change in the pose that suits the same points: a centimetre, also at a limb's end."""
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
        self._iteration = Iteration(settings.iterations, limit_weight(settings), settings.hinge_margin_rad)
        self._lasting = LastingErrors(settings.lasting_errors)
        self._angles: np.ndarray | None = None
        self._stamp_ns, self._last_dt = stamp_ns, 0.0
        self._estimate = first_estimate(body, z, self._motion, settings.joint_sd_cap_rad, self._iteration)
        self._measured(z, z.visible)
        self.first_report = self._report(z.visible, NOBODY_LEFT_OUT, np.zeros(15))

    @property
    def blind_s(self) -> float:
        """Seconds from the last measurement that was used to the last prediction."""
        return (self._stamp_ns - self._measured_ns) * NS

    def change_body(self, body: Body) -> None:
        """Go on with other sizes of the same body; the pose is less sure by what they move."""
        self.body = body
        x, slots = self._estimate, np.arange(24)
        P = x.covariance.copy()
        P[slots, slots] += per_slot(RESIZED_M, RESIZED_RAD, RESIZED_RAD, RESIZED_RAD) ** 2
        self._estimate = Estimate(x.arrays, x.velocity, P)

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
        if verdict.returned and 2 * verdict.readmitted[TORSO_POINTS].sum() >= len(TORSO_POINTS) and enough_to_start(z):
            return None
        if verdict.used:
            self._estimate = self._corrected(z, verdict)
            self._measured(z, verdict.accepted)
        return self._report(verdict.accepted, verdict.rejected, distances)

    def _corrected(self, z: Measurement, verdict: Verdict) -> Estimate:
        prior, start = self._estimate, None
        if verdict.returned:  # their limbs are elsewhere: look for them from where the points say
            prior = self._with_refound(prior, verdict.readmitted)
            start = pose_of_points(self.body, z, verdict.accepted, prior.pose)
        try:
            return corrected(self.body, prior, z, verdict.accepted, self._iteration, start)
        except ValueError:
            self.repairs += 1
            mended = Estimate(prior.arrays, prior.velocity, positive_definite(prior.covariance))
            return corrected(self.body, mended, z, verdict.accepted, self._iteration, start)

    def _measured(self, z: Measurement, used: np.ndarray) -> None:
        self._lasting.remember(z.covariance, used)
        self._measured_ns, self._coasting = self._stamp_ns, True

    def _advance(self, stamp_ns: int) -> None:
        dt = (stamp_ns - self._stamp_ns) * NS
        if dt <= 0.0:
            return
        self._estimate = predicted(self._estimate, self._motion.transition(dt), self.settings.joint_sd_cap_rad)
        self._stamp_ns, self._last_dt = stamp_ns, dt

    def _forget_velocity(self) -> None:
        slots, P = np.arange(24), self._estimate.covariance.copy()
        P[VELOCITY, :] = P[:, VELOCITY] = 0.0
        P[24 + slots, 24 + slots] = self._motion.velocity_variance()
        self._estimate = Estimate(self._estimate.arrays, np.zeros(24), P)
        self._coasting = False

    def _with_refound(self, prior: Estimate, readmitted: np.ndarray) -> Estimate:
        """The prior without any knowledge of the joints above the readmitted points (of the torso, for its own)."""
        at, moves = linearised(self.body, prior.pose), np.zeros(24, bool)
        for point in np.flatnonzero(readmitted):
            moves[at.slots[point, 6 : at.columns[point]]] = True
        moves[:6] = readmitted[TORSO_POINTS].any()
        slots = np.flatnonzero(moves)
        cap = self.settings.joint_sd_cap_rad
        pose_variance = per_slot(REFOUND_TORSO_SD_M, cap, cap, cap)[slots] ** 2
        velocity = np.where(moves, 0.0, prior.velocity)
        P = widened(prior.covariance, slots, pose_variance, self._motion.velocity_variance()[slots])
        return Estimate(prior.arrays, velocity, P)

    def _report(self, accepted: np.ndarray, gated: np.ndarray, distances: np.ndarray) -> EkfState:
        x, pose = self._estimate, self._estimate.pose
        self._angles = pose.angles(self._angles)
        points_world, point_covariance, covariance, rates = report(
            x.arrays,
            x.velocity,
            x.covariance,
            self.body.lengths,
            self.body.stick_origins_torso,
            self._lasting.covariance,
            self.settings.joint_sd_cap_rad**-2,
            self._angles,
        )
        tracking, reason = assess(accepted, gated, self.blind_s, self.settings.lost_after_s)
        return EkfState(
            stamp_ns=self._stamp_ns,
            pose=pose,
            velocity=x.velocity,
            drift=self._drift(x.velocity),
            covariance=covariance,
            angles=self._angles,
            rates=rates,
            points_world=points_world,
            point_covariance=point_covariance,
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
        return self._motion.transition(self._last_dt).reach * velocity / self._last_dt
