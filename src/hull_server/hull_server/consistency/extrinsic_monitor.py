"""Watches each camera's extrinsic calibration through the silhouettes of a moving person.

All planes through two cameras' centres contain the baseline. The two outermost ones that touch the body do so at
frontier points, which both cameras see on their contours (Rieger 1986; Cipolla, Astrom and Giblin, "Motion from the
frontier of curved surfaces", ICCV 1995). So both cameras must measure the same two angles about the baseline, whatever
the body's shape; they differ by a contour's error, or when either camera has moved (Sinha, Pollefeys and McMillan,
"Camera network calibration from dynamic silhouettes", CVPR 2004). With many cameras and a person who moves, all
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
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import CameraModel, Rig
from capture_rig.kernel import kernel
from capture_rig.stamps import StampThrottle

from ..bitset import FIRST_BITS, highest_bit, lowest_bit, nonzero_bytes, nonzero_span
from ..settings import CalibrationSettings
from ..views import Masks, RigViews
from . import EARLY

Array = npt.NDArray[np.float64]

# what is measured when
PERIOD_S = 0.2  # between frame sets that are measured
# Thresholds: chosen with python bench/camera_movement.py.
RECENT_SETS = 20  # four seconds
TESTED_EVERY = 3  # measured sets
MIN_MOTION_RAD = np.radians(0.5)  # if the contours moved by less, silhouettes err as they did before

# the noise model
SIGMAS = 3.0  # beyond which a difference is an outlier, and within which an error may be none
TYPICAL_RAD, WRONG_RAD = np.radians(0.12), np.radians(1.5)  # standard deviation of sound and of wrong calibrations
TYPICAL_PX, LARGE_PX = 2.0, 10.0  # by which silhouettes are larger or smaller, normally and at worst
CORRELATION_S = 0.5  # silhouette errors persist for about this long
LEAST_NOISE_PX, MOST_NOISE_PX = 0.5, 4.0
GENTLE_ROUNDS, ROUNDS = 3, 8  # of reweighting: the first ones only reduce the weight of outliers
SYSTEMATIC_RAD = np.radians(0.08)  # of every angle: lenses, and silhouettes that err in one direction for long

# when a camera is named
FEWEST_CAMERAS = 3
FEWEST = 12  # differences of a camera; fewer are not enough
CONFIRMATIONS = 4  # tests in a row before a camera is named; one is enough ...
GROSS = 4.0  # ... when the error is so many times what is allowed
ENOUGH_CAMERAS = 5  # each camera less doubles what is allowed: faults are harder to attribute
CLEARER = 3.0  # evidence by which it must exceed every other explanation

# which tangents are used
MARGIN_PX = 4  # a contour nearer than this to unseen pixels may be cut off
LEAST_ROWS = 10  # silhouettes with fewer rows are not a body
LEAST_SINE = 0.2  # rays nearer to the baseline measure the angle badly
WIDEST_RAD = np.radians(150.0)  # a body seen over a wider angle contains the baseline
UNCERTAIN_PX = 3.0  # a tangent that moves by more when possible-shadow pixels are counted is not used
UNKNOWNS = 4  # of a camera: three rotation angles, and how much larger its silhouette is all around


@dataclass(frozen=True, eq=False)
class ExtrinsicError:
    """One camera's estimated rotation from its calibration, radians.

    rotation_rad (3,) : rotation vector in the camera's frame (x right, y down, z forward), if it alone has moved; a
    translation appears as the rotation with the same effect on the images of the body. sd_rad : standard deviation of
    its angle. evidence : twice the log ratio of probabilities to no error; evidence_of_growth : the same for a
    silhouette too large or too small. count : of the camera's differences.
    """

    rotation_rad: Array
    sd_rad: float
    evidence: float
    evidence_of_growth: float
    count: int

    @property
    def angle_rad(self) -> float:
        return float(np.linalg.norm(self.rotation_rad))

    @property
    def roll_rad(self) -> float:
        """The part about the optical axis."""
        return float(self.rotation_rad[2])


@dataclass(frozen=True, eq=False)
class ExtrinsicErrors:
    """How far the cameras that could be measured are from their calibration, by name; suspects : those that have
    certainly moved, and a message with the remedy."""

    of_camera: Mapping[str, ExtrinsicError] = field(default_factory=dict)
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
        errors = {name: error for name, error in zip(self.names, recent, strict=True) if error.count >= FEWEST}
        suspects: dict[str, str] = {}
        for camera, name in enumerate(self.names):
            if name in errors:
                excess_rad = _certain_error_rad(recent, camera, CLEARER * lenience)
                self._in_a_row[camera] = self._in_a_row[camera] + 1 if excess_rad > allowed_rad else 0
                if self._in_a_row[camera] >= CONFIRMATIONS or excess_rad > GROSS * allowed_rad:
                    suspects[name] = self._reason(name, errors[name])
        return ExtrinsicErrors(errors, suspects)

    def _reason(self, name: str, error: ExtrinsicError) -> str:
        aside, about = np.degrees(np.hypot(*error.rotation_rad[:2])), np.degrees(abs(error.rotation_rad[2]))
        return (
            f"{name} stands {np.degrees(error.angle_rad):.1f} degrees from where its calibration says ({aside:.1f} "
            f"aside, {about:.1f} about its axis), as the other {len(self.names) - 1} show: was it moved? Put it back, "
            "or calibrate it again"
        )


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
        errors.append(
            ExtrinsicError(
                rotation_rad=x[own],
                sd_rad=float(np.sqrt(along @ covariance[own, own] @ along)),
                evidence=rotated - no_error,
                evidence_of_growth=grown - no_error,
                count=int(mine.sum()),
            )
        )
    return errors


def _certain_error_rad(errors: list[ExtrinsicError], camera: int, clearer: float) -> float:
    """Return the part of the camera's error that is certain; 0 unless it is the clearly best explanation."""
    mine = errors[camera]
    others = [mine.evidence_of_growth, *(error.evidence for c, error in enumerate(errors) if c != camera)]
    if mine.count < FEWEST or mine.evidence - max(others) < clearer:
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
        u = residual / (SIGMAS * noise_px)
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


# --- the measured tangents


class Tangents(NamedTuple):
    """The m tangent planes measured by two cameras each.

    first, second (m,) : indices of the cameras. difference_px (m,) : first minus second angle about the baseline, over
    its change for one pixel of noise in both images. first_part, second_part (m, 4) : derivatives of that difference by
    rotations of each camera about its own axes (x right, y down, z forward; radians) and by a silhouette that is larger
    by a pixel all around. angles (n, n, 2) : of the tangent planes that each camera measures about the baseline to each
    other camera, radians; NaN where it cannot.
    """

    first: npt.NDArray[np.int64]
    second: npt.NDArray[np.int64]
    difference_px: Array
    first_part: Array
    second_part: Array
    angles: Array


class _Contacts(NamedTuple):
    """One camera's tangent planes about the baseline to each camera j: largest angle (k = 0) and smallest (k = 1).

    angle (n, 2) : radians. part (n, 2, 4) : its derivatives by this camera's unknowns. noise (n, 2) : of the angle, for
    a pixel of noise. valid (n, 2) : whether it could be measured.
    """

    angle: Array
    part: Array
    noise: Array
    valid: npt.NDArray[np.bool_]


class EpipolarTangentFinder:
    """Measures the tangent planes of all pairs of cameras; tables of the calibration are computed once."""

    def __init__(self, rig: Rig, views: RigViews) -> None:
        self._names = views.names
        self._cameras = [rig.camera(name).undistorted_view().camera for name in views.names]
        self._to_ray_world = [np.linalg.inv(c.K).T @ c.R_camera_world for c in self._cameras]
        middle = (np.asarray(rig.volume.low) + np.asarray(rig.volume.high)) / 2
        self._axes = np.array([[_axes(a, b, middle) for b in self._cameras] for a in self._cameras])
        self._uncut = [_away_from_cuts(seen) for seen in views.seen]
        self._second, self._first = np.triu_indices(len(self._cameras), 1)

    def find(self, masks: Mapping[str, npt.NDArray[np.uint8]]) -> Tangents:
        """Measure canvas masks (h, w) uint8, levels of ``capture_rig.mask_levels``, of some cameras of the rig."""
        found = [self._contacts(i, masks.get(name)) for i, name in enumerate(self._names)]
        angle, part, noise, valid = (np.stack(of_all) for of_all in zip(*found, strict=True))
        i, j = self._first, self._second
        both, side = np.nonzero(valid[i, j] & valid[j, i])
        i, j = i[both], j[both]
        together = np.hypot(noise[i, j, side], noise[j, i, side])
        return Tangents(
            first=i,
            second=j,
            difference_px=(angle[i, j, side] - angle[j, i, side]) / together,
            first_part=part[i, j, side] / together[:, None],
            second_part=-part[j, i, side] / together[:, None],
            angles=np.where(valid, angle, np.nan),
        )

    def _contacts(self, camera: int, mask: npt.NDArray[np.uint8] | None) -> _Contacts:
        corners = None if mask is None else _corners(mask)
        if corners is None:
            n = len(self._cameras), 2
            return _Contacts(np.zeros(n), np.zeros((*n, UNKNOWNS)), np.ones(n), np.zeros(n, bool))
        (rays, uncut), (wide_rays, wide_uncut) = (
            (self._rays(camera, pixels), self._uncut[camera][pixels[:, 1], pixels[:, 0]]) for pixels in corners
        )
        at, angle, across = self._outermost(camera, rays)
        wide_at, wide_angle, _ = self._outermost(camera, wide_rays)
        axes, ray = self._axes[camera][:, None], rays[at]
        sine = np.maximum(np.hypot(across[..., 0], across[..., 1]), 1e-9)
        noise = 1.0 / (sine * self._cameras[camera].K[0, 0])
        # direction in which the angle grows, and its derivative by rotations about the camera's axes
        along = (across[..., :1] * axes[..., 1, :] - across[..., 1:] * axes[..., 0, :]) / sine[..., None]
        turn = np.cross(ray, along) @ self._cameras[camera].R_camera_world.T / sine[..., None]
        valid = uncut[at] & wide_uncut[wide_at] & (sine > LEAST_SINE)
        valid &= np.abs(angle - wide_angle) <= UNCERTAIN_PX * noise
        wide = (wide_angle[:, 0] - wide_angle[:, 1] > WIDEST_RAD) | (np.abs(wide_angle).max(1) > WIDEST_RAD)
        valid[wide] = valid[camera] = False
        return _Contacts(angle, np.concatenate([turn, (noise * [1, -1])[..., None]], axis=2), noise, valid)

    def _rays(self, camera: int, pixels: npt.NDArray[np.int32]) -> Array:
        """Convert pixels (k, 2) to unit directions (k, 3) in the map frame."""
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ self._to_ray_world[camera]
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def _outermost(self, camera: int, rays: Array) -> tuple[npt.NDArray[np.int64], Array, Array]:
        """Find the rays with the largest and smallest angle about each baseline.

        Returns index (n, 2) and angle (n, 2) of the ray, and its coordinates (n, 2, 2) across the baseline.
        """
        across = np.einsum("kc,nac->nka", rays, self._axes[camera])
        angle = np.arctan2(across[..., 1], across[..., 0])
        at = np.stack([angle.argmax(1), angle.argmin(1)], axis=1)
        of = np.arange(len(angle))[:, None]
        return at, angle[of, at], across[of, at]


def _corners(mask: npt.NDArray[np.uint8]) -> list[npt.NDArray[np.int32]] | None:
    """Find corners (k, 2) u, v of the convex hulls of the sure foreground, and of all nonzero pixels; None if empty."""
    words, found = np.ascontiguousarray(mask).view(np.uint64), []
    ends = np.empty((2 * len(words), 2), np.int32)
    for certain in (True, False):
        count = _row_ends(words, certain, ends)
        if count < 2 * LEAST_ROWS:
            return None
        found.append(np.asarray(cv2.convexHull(ends[:count]), np.int32).reshape(-1, 2))
    return found


def _axes(first: CameraModel, second: CameraModel, middle_world: Array) -> Array:
    """Return two unit directions (2, 3) across the baseline: to the middle of the volume, and perpendicular to that."""
    line = second.centre_world - first.centre_world
    line = line / max(float(np.linalg.norm(line)), 1e-9)
    line = line if first.name < second.name else -line  # the same for both cameras
    to_middle = middle_world - first.centre_world
    to_middle = to_middle - to_middle @ line * line
    to_middle = to_middle / max(float(np.linalg.norm(to_middle)), 1e-9)
    return np.stack([to_middle, np.cross(line, to_middle)])


def _away_from_cuts(seen: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Find the pixels (H, W) farther than MARGIN_PX from unseen ones."""
    padded = np.pad(seen, MARGIN_PX)
    inner = cv2.erode(padded, np.ones((2 * MARGIN_PX + 1,) * 2, np.uint8))
    return np.asarray(inner[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] > 0)


@kernel
def _row_ends(words, certain, points):  # type: ignore[no-untyped-def]
    """Write the first and last nonzero pixel (u, v) of each row of a mask to ``points``; return their number.

    words (h, w / 8) : of the mask, eight pixels a word. certain : only FOREGROUND counts.
    """
    count = 0
    for v in range(words.shape[0]):
        first, last = nonzero_span(words[v])
        while first < last and _marks(words[v, first], certain) == 0:
            first += 1
        if first < last:
            while _marks(words[v, last - 1], certain) == 0:
                last -= 1
            ones, others = _marks(words[v, first], certain), _marks(words[v, last - 1], certain)
            points[count, 0], points[count, 1] = 8 * first + lowest_bit(ones) // 8, v
            points[count + 1, 0], points[count + 1, 1] = 8 * last - 8 + highest_bit(others) // 8, v
            count += 2
    return count


@kernel
def _marks(word, certain):  # type: ignore[no-untyped-def]
    """Return a word with 1 in every byte that is not zero or, where only ``certain`` counts, that is FOREGROUND."""
    return nonzero_bytes(~word) ^ FIRST_BITS if certain else nonzero_bytes(word)
