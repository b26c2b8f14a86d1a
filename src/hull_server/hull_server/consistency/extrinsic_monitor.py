"""Watches each camera's extrinsic calibration through the silhouettes of a moving person.

The epipolar tangents of two cameras differ when either camera has moved. With many cameras and a person who moves, all
differences that involve one rotated camera fit the same three angles. So the angles of all cameras are estimated
together by robust least squares (outliers: shadows, hidden or missing parts), with a prior that most calibrations are
sound. Then each camera is tested alone: how much better are the differences explained if it, and no other, has moved
(model evidence: MacKay, "Bayesian interpolation", Neural Computation 1992), also compared with a silhouette that is too
large or too small? Errors of a degree are found within seconds, long before the camera harms the hull enough to be
excluded. The thresholds are those of bench/camera_movement.py.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from capture_rig import Rig
from capture_rig.stamps import StampThrottle

from ..settings import CalibrationSettings
from ..views import Masks, RigViews
from .epipolar_tangents import UNKNOWNS, Array, EpipolarTangentFinder, Tangents

# what is measured when
PERIOD_S = 0.2  # between frame sets that are measured
# Thresholds: chosen with python bench/camera_movement.py.
RECENT_SETS = 20  # four seconds
TESTED_EVERY = 3  # measured sets
EARLY = 0.1  # share of the period by which a frame set may come early: stamps jitter
MIN_MOTION_RAD = np.radians(0.5)  # if the contours moved by less, silhouettes err as they did before

# the noise model
TYPICAL_RAD, WRONG_RAD = np.radians(0.12), np.radians(1.5)  # standard deviation of sound and of wrong calibrations
TYPICAL_PX, LARGE_PX = 2.0, 10.0  # by which silhouettes are larger or smaller, normally and at worst
CORRELATION_S = 0.5  # silhouette errors persist for about this long
LEAST_NOISE_PX, MOST_NOISE_PX = 0.5, 4.0
OUTLIER_SIGMAS = 3.0
GENTLE_ROUNDS, ROUNDS = 3, 8  # of reweighting: the first ones only reduce the weight of outliers
SYSTEMATIC_RAD = np.radians(0.08)  # of every angle: lenses, and silhouettes that err in one direction for long

# when a camera is named
FEWEST_CAMERAS = 3
FEWEST = 12  # differences of a camera; fewer are not enough
SIGMAS = 3.0
CONFIRMATIONS = 4  # tests in a row before a camera is named; one is enough ...
GROSS = 4.0  # ... when the error is so many times what is allowed
ENOUGH_CAMERAS = 5  # each camera less doubles what is allowed: faults are harder to attribute
INLIERS = 0.5  # share of the camera's differences that its rotation must explain
CLEARER = 3.0  # evidence by which it must exceed every other explanation


@dataclass(frozen=True, eq=False)
class ExtrinsicErrors:
    """How far the cameras are from their calibration. Radians, by camera; only cameras that could be measured.

    rotation_error_rad : angle of each camera's rotation from its calibration, if it alone has moved; sd_rad : its
    standard deviation; roll_rad : the part about the optical axis. suspects : cameras that have certainly moved, and a
    message with the remedy.
    """

    rotation_error_rad: Mapping[str, float] = field(default_factory=dict)
    sd_rad: Mapping[str, float] = field(default_factory=dict)
    roll_rad: Mapping[str, float] = field(default_factory=dict)
    suspects: Mapping[str, str] = field(default_factory=dict)


class ExtrinsicMonitor:
    """Monitors the calibration of one rig. One thread at a time. The same sets give the same results."""

    def __init__(self, rig: Rig, views: RigViews, settings: CalibrationSettings | None = None) -> None:
        self.settings, self.names = settings or CalibrationSettings(), views.names
        self.errors = ExtrinsicErrors()
        self._finder = EpipolarTangentFinder(rig, views)
        self._recent: deque[Tangents] = deque(maxlen=RECENT_SETS)
        self._throttle, self._measured = StampThrottle(PERIOD_S, early_share=EARLY), 0
        self._in_a_row = [0] * len(views.names)

    def update(self, masks: Masks, stamp_ns: int) -> ExtrinsicErrors:
        """Measure one frame set's canvas masks (h, w) uint8, levels of ``capture_rig.mask_levels``, once a period.

        Sets without a person change nothing.
        """
        if not self.settings.enabled or len(self.names) < FEWEST_CAMERAS or not self._throttle.step_s(stamp_ns):
            return self.errors
        tangents = self._finder.find(masks)
        if tangents.first.size and self._has_moved(tangents):
            self._recent.append(tangents)
            self._measured += 1
            if self._measured % TESTED_EVERY == 0:
                self.errors = self._test()
        return self.errors

    def _has_moved(self, tangents: Tangents) -> bool:
        """Check that the body moved since the last measured set: a still body adds no information."""
        if not self._recent:
            return True
        moved_rad = np.abs(tangents.angles - self._recent[-1].angles)
        known = np.isfinite(moved_rad)
        return not known.any() or float(np.median(moved_rad[known])) > MIN_MOTION_RAD

    def _test(self) -> ExtrinsicErrors:
        """Test every camera by the recent measurements."""
        recent = estimate_extrinsic_errors(self._recent, len(self.names), PERIOD_S)
        present = sum(error.count >= FEWEST for error in recent)
        lenience = 2.0 ** max(ENOUGH_CAMERAS - present, 0)
        allowed_rad = np.radians(self.settings.limit_deg) * lenience
        errors: dict[str, ExtrinsicError] = {}
        suspects: dict[str, str] = {}
        for camera, name in enumerate(self.names):
            if recent[camera].count < FEWEST:
                continue
            errors[name] = recent[camera]
            excess_rad = _certain_error_rad(recent, camera, CLEARER * lenience)
            self._in_a_row[camera] = self._in_a_row[camera] + 1 if excess_rad > allowed_rad else 0
            if self._in_a_row[camera] >= CONFIRMATIONS or excess_rad > GROSS * allowed_rad:
                suspects[name] = self._reason(name, errors[name])
        return ExtrinsicErrors(
            rotation_error_rad={name: error.angle_rad for name, error in errors.items()},
            sd_rad={name: error.sd_rad for name, error in errors.items()},
            roll_rad={name: float(error.rotation_rad[2]) for name, error in errors.items()},
            suspects=suspects,
        )

    def _reason(self, name: str, error: ExtrinsicError) -> str:
        aside, about = np.degrees(np.hypot(*error.rotation_rad[:2])), np.degrees(abs(error.rotation_rad[2]))
        return (
            f"{name} stands {np.degrees(error.angle_rad):.1f} degrees from where its calibration says ({aside:.1f} "
            f"aside, {about:.1f} about its axis), as the other {len(self.names) - 1} show: was it moved? Put it back, "
            "or calibrate it again"
        )


@dataclass(frozen=True, eq=False)
class ExtrinsicError:
    """One camera's estimated rotation from its calibration.

    rotation_rad (3,) : rotation vector in the camera's frame (x right, y down, z forward), radians, if it alone has
    moved; a translation appears as the rotation with the same effect on the images of the body. sd_rad : standard
    deviation of its angle. evidence : twice the log ratio of probabilities to no error; evidence_of_growth : the same
    for a silhouette too large or too small. inlier_fraction : share of the camera's differences that it explains. count
    : of those.
    """

    rotation_rad: Array
    sd_rad: float
    evidence: float
    evidence_of_growth: float
    inlier_fraction: float
    count: int

    @property
    def angle_rad(self) -> float:
        return float(np.linalg.norm(self.rotation_rad))


def estimate_extrinsic_errors(tangents: Sequence[Tangents], cameras: int, step_s: float) -> list[ExtrinsicError]:
    """Estimate the error of each of the ``cameras`` of a rig, by the tangents of frame sets ``step_s`` apart."""
    first, second, y, one, other = (np.concatenate(parts) for parts in list(zip(*tangents, strict=True))[:5])
    rows, share = np.arange(len(y)), min(1.0, step_s / CORRELATION_S)
    parts_of_camera = np.zeros((len(y), cameras, UNKNOWNS))
    parts_of_camera[rows, first], parts_of_camera[rows, second] = one, other
    G: Array = parts_of_camera.reshape(len(y), -1)  # the differences y (m,) in pixels are G times the unknowns (4 n,)
    weight, noise_px = _robust_weights(G, y, cameras, share)
    A, c = (total * (share / noise_px**2) for total in _normal_equations(G, y, weight))
    no_error, _, _ = _evidence(A, c, _prior(cameras))
    errors = []
    for camera in range(cameras):
        rotated, x, covariance = _evidence(A, c, _prior(cameras, wrong=camera))
        grown, _, _ = _evidence(A, c, _prior(cameras, large=camera))
        own = slice(UNKNOWNS * camera, UNKNOWNS * camera + 3)
        along = x[own] / max(float(np.linalg.norm(x[own])), 1e-12)
        mine = (first == camera) | (second == camera)
        inliers = np.abs(y[mine] - G[mine] @ x) < OUTLIER_SIGMAS * noise_px
        errors.append(
            ExtrinsicError(
                rotation_rad=x[own],
                sd_rad=float(np.sqrt(along @ covariance[own, own] @ along)),
                evidence=rotated - no_error,
                evidence_of_growth=grown - no_error,
                inlier_fraction=float(inliers.mean()) if inliers.size else 0.0,
                count=inliers.size,
            )
        )
    return errors


def _certain_error_rad(errors: list[ExtrinsicError], camera: int, clearer: float) -> float:
    """Return the part of the camera's error that is certain; 0 unless it is the clearly best explanation."""
    mine = errors[camera]
    others = [mine.evidence_of_growth, *(error.evidence for c, error in enumerate(errors) if c != camera)]
    if mine.count < FEWEST or mine.inlier_fraction < INLIERS or mine.evidence - max(others) < clearer:
        return 0.0
    return mine.angle_rad - SIGMAS * float(np.hypot(mine.sd_rad, SYSTEMATIC_RAD))


def _robust_weights(G: Array, y: Array, cameras: int, share: float) -> tuple[Array, float]:
    """Fit all cameras' unknowns; return the weight of each difference, and their noise in pixels.

    The prior of a camera widens with the error found (Tipping, "Sparse Bayesian learning", JMLR 2001).
    """
    x: Array = np.zeros(UNKNOWNS * cameras)
    prior, weight, noise_px = _prior(cameras), np.ones(len(y)), LEAST_NOISE_PX
    for round_ in range(ROUNDS):
        residual = np.abs(y - G @ x)
        noise_px = float(np.clip(np.median(residual) / 0.6745, LEAST_NOISE_PX, MOST_NOISE_PX)) if len(y) else 1.0
        u = residual / (OUTLIER_SIGMAS * noise_px)
        weight = 1 / (1 + u) ** 2 if round_ < GENTLE_ROUNDS else 1 / (1 + u * u) ** 2
        A, c = _normal_equations(G, y, weight)
        solved = np.linalg.solve(A * share / noise_px**2 + np.diag(prior), c * share / noise_px**2)
        x = np.asarray(solved, np.float64)
        squared = (x.reshape(cameras, UNKNOWNS)[:, :3] ** 2).sum(1)
        prior.reshape(cameras, UNKNOWNS)[:, :3] = (1 / (TYPICAL_RAD**2 + squared))[:, None]
    return weight, noise_px


def _prior(cameras: int, wrong: int | None = None, large: int | None = None) -> Array:
    """Return precisions (4 n,) of sound calibrations and silhouettes, but for one ``wrong`` or ``large`` camera."""
    prior = np.tile([1 / TYPICAL_RAD**2] * 3 + [1 / TYPICAL_PX**2], cameras)
    if wrong is not None:
        prior[UNKNOWNS * wrong : UNKNOWNS * wrong + 3] = 1 / WRONG_RAD**2
    if large is not None:
        prior[UNKNOWNS * large + 3] = 1 / LARGE_PX**2
    return prior


def _evidence(A: Array, c: Array, prior: Array) -> tuple[float, Array, Array]:
    """Return twice the log evidence (up to a constant), the most probable unknowns, and their covariance."""
    precision = A + np.diag(prior)
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    x = covariance @ c
    return float(c @ x - np.linalg.slogdet(precision)[1] + np.log(prior).sum()), x, covariance


def _normal_equations(G: Array, y: Array, weight: Array) -> tuple[Array, Array]:
    """Return G^T W G (4 n, 4 n) and G^T W y (4 n,)."""
    weighted = weight[:, None] * G
    return weighted.T @ G, weighted.T @ y
