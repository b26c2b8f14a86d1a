"""A track scored against a session's truth: thesis Tables 7.1 and 7.2, and what they leave out."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from capture_rig.errors import InputError
from capture_rig.session import Truth
from mocap_packets.fit import GOOD, PART_NAMES, PART_POINTS
from stick_figure import metrics
from stick_figure.body import Body
from stick_figure.kinematics import inverse
from stick_figure.metrics import LARGE_ERROR_M
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, BALL_ANGLES, HINGE_ANGLES, POINT_NAMES

from .track import Track

STRAIGHT_RAD = np.deg2rad(20.0)
"""Closer to straight (or to an arm's or thigh's singular direction) a limb does not determine its angles.

At 20 degrees an error of 20 mm of the hand turns the upper arm's twist by about 0.15 rad; straight, without bound.
"""


@dataclass(frozen=True, eq=False)
class AngleTruth:
    """angles (F, 18) rad and R_world_torso (F, 3, 3), NaN where unknown; source : where they come from, in words."""

    angles: np.ndarray
    R_world_torso: np.ndarray
    source: str


@dataclass(frozen=True, eq=False)
class AngleScores:
    """Errors of the joint angles over the tracked frames.

    rmse_rad : (18,) of wrapped differences (thesis eq. 7.2), over the frames in which the truth defines the angle.
    share_defined : (18,) share of the compared frames in which it does.
    torso_rmse_rad : of the torso's rotation angle to the truth (thesis eq. 7.1).
    """

    rmse_rad: np.ndarray
    share_defined: np.ndarray
    torso_rmse_rad: float
    source: str


def score_angles(angles: np.ndarray, points_world: np.ndarray, truth: AngleTruth) -> AngleScores:
    """Compare a track's angles (F, 18) rad and points (F, 15, 3) m, NaN where it has none, with the truth, by frame."""
    known = np.isfinite(truth.angles).all(1) & np.isfinite(angles).all(1)
    compared = known[:, None] & defined(truth.angles)
    turned = metrics.rotation_angle(_rotations(fit_poses(points_world)), truth.R_world_torso)
    turned = turned[np.isfinite(turned)]
    return AngleScores(
        rmse_rad=metrics.rmse_angles(angles, np.where(compared, truth.angles, np.nan)),
        share_defined=compared.sum(0) / max(int(known.sum()), 1),
        torso_rmse_rad=float(np.sqrt(np.mean(turned**2))) if turned.size else float("nan"),
        source=truth.source,
    )


def angle_truth(truth: Truth) -> AngleTruth:
    """Return the truth's own angles, or else those of a stick figure fitted to its points."""
    points = truth.stick_figure_points()
    poses = fit_poses(points)
    if truth.angles is not None:
        return AngleTruth(truth.angles, _rotations(poses), f"the angles in {truth.source.name}")
    angles, previous = np.full((len(poses), 18), np.nan), None
    for frame, pose in enumerate(poses):
        if pose is not None:
            angles[frame] = previous = pose.angles(previous)
    return AngleTruth(angles, _rotations(poses), f"inverse kinematics of the points in {truth.source.name}")


def fit_poses(points_world: np.ndarray) -> list[Pose | None]:
    """Poses fitted to reference points (F, 15, 3) m, limbs of median length; None where they are unknown or impossible.

    An angle that a straight limb leaves undetermined is carried over from the pose before.
    """
    whole = np.isfinite(points_world).all((1, 2))
    poses: list[Pose | None] = [None] * len(points_world)
    if not whole.any():
        return poses
    body, previous = Body.from_points(points_world[whole]), None
    for frame in np.flatnonzero(whole):
        with suppress(InputError):
            poses[frame] = previous = inverse(body, points_world[frame], previous)
    return poses


def defined(angles: np.ndarray) -> np.ndarray:
    """(F, 18) bool: the angles that a pose (F, 18) rad determines well.

    The third angle of a shoulder or hip is the twist of the upper limb, which shows only in a bent elbow or knee. First
    and third turn about the same axis where the second is a right angle (arm straight forward or back, thigh
    horizontal): neither is determined there.
    """
    out = np.isfinite(angles)
    closest = np.sin(STRAIGHT_RAD)
    for ball, (first, second, third) in enumerate(BALL_ANGLES):
        regular = np.abs(np.cos(angles[:, second])) > closest
        out[:, first] &= regular
        if ball:  # the neck has no third
            out[:, third] &= regular & (np.abs(np.sin(angles[:, HINGE_ANGLES[ball - 1]])) > closest)
    return out


def _rotations(poses: list[Pose | None]) -> np.ndarray:
    """R_world_torso (F, 3, 3) of the rigid fits to the torso's points; NaN where there is no pose."""
    unknown = np.full((3, 3), np.nan)
    return np.array([unknown if pose is None else pose.R_world_torso for pose in poses]).reshape(-1, 3, 3)


# joint angles ---------------------------------------------------------------------------------------------------------


DIMENSIONS = 3
INSIDE_95 = float(chi2.ppf(0.95, DIMENSIONS))
"""Squared Mahalanobis distance that 95 % of the errors stay below when the covariance is right."""


@dataclass(frozen=True, eq=False)
class CovarianceCoverage:
    """How the errors of the 15 points compare with the covariances that the track states.

    point_inside_95 : (15,) share of each point's errors inside its 95 % ellipsoid; inside_95 : of all points' together.
    point_nees : (15,) mean normalised estimation error squared, e^T P^-1 e: 3 when the covariance is right, more for an
    overconfident track (Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 5.4);
    nees : of all points together.
    NaN where nothing could be compared.
    """

    point_inside_95: np.ndarray
    inside_95: float
    point_nees: np.ndarray
    nees: float


def covariance_coverage(errors: np.ndarray, covariance: np.ndarray) -> CovarianceCoverage:
    """Compare errors (F, 15, 3) m, NaN where unknown, with the covariances (F, 15, 3, 3) m^2 stated for them."""
    squared = squared_distances(errors, covariance)
    known = np.isfinite(errors).all(-1)
    inside = np.where(known, squared <= INSIDE_95, np.nan)
    return CovarianceCoverage(
        mean_of_known(inside, 0), float(mean_of_known(inside)), mean_of_known(squared, 0), float(mean_of_known(squared))
    )


def squared_distances(errors: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """NEES (F, 15) of each error, e^T P^-1 e; NaN where unknown, infinite where P claims certainty."""
    known = np.isfinite(errors).all(-1) & np.isfinite(covariance).all((-2, -1))
    out = np.full(errors.shape[:-1], np.nan)
    certain = known.copy()
    certain[known] = np.linalg.det(covariance[known]) <= 0.0
    out[certain] = np.inf
    regular = known & ~certain
    solved = np.linalg.solve(covariance[regular], errors[regular][..., None])[..., 0]
    out[regular] = np.einsum("ni,ni->n", errors[regular], solved)
    return out


def mean_of_known(values: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return the mean over the known values; NaN where there is none."""
    known = ~np.isnan(values)
    count = known.sum(axis)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis) / np.maximum(count, 1), np.nan)


OVERALL = (
    *("mean_mm", "median_mm", "p95_mm", "over_200mm", "rmse_mean_mm", "mean_mm_without_offset", "inside_95"),
    *("inside_95_without_offset", "flagged_of_bad", "false_alarms"),
)


@dataclass(frozen=True, eq=False)
class Scores:
    """Errors over the truth's frames, metres as mm; NaN where nothing could be compared.

    frames : truth frames; tracked : those for which the track has a body. Everything else is over these:
    mean_mm, median_mm, p95_mm : of all points together; over_200mm : share of frames with any point further off;
    rmse_mean_mm : mean over the points of each point's RMSE (thesis Table 7.2).
    mean_mm_without_offset : after each point's constant offset in the pelvis frame is taken out: where truth and stick
    figure mean different places by "shoulder" or "hip", that part says nothing about tracking. point_offset_mm :
    (15, 3) those offsets, track minus truth, forward, left and up.
    point_... : (15,) the same of each point; point_over_200mm : share of frames in which it is further off.
    coverage : the errors against the track's own covariances; coverage_without_offset : what is left of them without
    constant offsets, for the covariance is about our own definition of the points (docs/points.md). angles : the joint
    angles. calls : the parts of the body that are called doubtful or lost, rightly or not.
    errors_mm : (frames, 15) every error, NaN where there is none.
    """

    frames: int
    tracked: int
    mean_mm: float
    median_mm: float
    p95_mm: float
    over_200mm: float
    rmse_mean_mm: float
    mean_mm_without_offset: float
    point_mm: np.ndarray
    point_rmse_mm: np.ndarray
    point_median_mm: np.ndarray
    point_p95_mm: np.ndarray
    point_over_200mm: np.ndarray
    point_mm_without_offset: np.ndarray
    point_offset_mm: np.ndarray
    coverage: CovarianceCoverage
    coverage_without_offset: CovarianceCoverage
    angles: AngleScores
    calls: PartCalls
    errors_mm: np.ndarray

    @property
    def angle_rmse_deg(self) -> np.ndarray:
        """(18,) RMSE of each angle where the truth defines it."""
        return np.rad2deg(self.angles.rmse_rad)

    @property
    def overall(self) -> dict[str, float]:
        """The figures of all points together, by their names in OVERALL."""
        inside_95, centred = self.coverage.inside_95, self.coverage_without_offset.inside_95
        of_parts = inside_95, centred, self.calls.flagged_of_bad, self.calls.false_alarms
        values = (*(getattr(self, name) for name in OVERALL[: -len(of_parts)]), *of_parts)
        return dict(zip(OVERALL, values, strict=True))

    def figures(self) -> dict[str, object]:
        """Name to number, for a line of JSON."""
        whole: dict[str, object] = {"frames": self.frames, "tracked": self.tracked}
        whole.update({name: number(value) for name, value in self.overall.items()})
        whole["nees"] = number(self.coverage.nees)
        whole["point_mm"] = _named(POINT_NAMES, self.point_mm, 1)
        offsets = self.point_offset_mm.round(1).tolist()
        whole["point_offset_mm"] = dict(zip(POINT_NAMES, offsets, strict=True))
        whole["point_rmse_mm"] = _named(POINT_NAMES, self.point_rmse_mm, 1)
        whole["point_inside_95"] = _named(POINT_NAMES, self.coverage.point_inside_95, 3)
        centred = self.coverage_without_offset.point_inside_95
        whole["point_inside_95_without_offset"] = _named(POINT_NAMES, centred, 3)
        whole["angle_rmse_deg"] = _named(ANGLE_NAMES, self.angle_rmse_deg, 1)
        whole["torso_rmse_deg"] = number(np.rad2deg(self.angles.torso_rmse_rad))
        return whole


def score(track: Track, truth: Truth) -> Scores:
    """Compare a track with the truth, frame by frame; InputError when they share no frame."""
    aligned = track.at(truth.frames)
    tracked = np.isfinite(aligned.points_world).all(axis=(1, 2))
    if not tracked.any():
        what = f"the track shares none of its {len(track.frames)} frames with the truth"
        raise InputError(what, where=str(truth.source), remedy="Check that track and truth are of the same session.")
    estimate, reference = truth.comparable(aligned.points_world), truth.points_world
    centred = metrics.without_offsets(estimate[tracked], reference[tracked])
    summary = metrics.summary(estimate[tracked], reference[tracked])
    errors_mm = 1e3 * metrics.point_errors(estimate, reference)
    errors_centred = metrics.point_errors(centred, reference[tracked])
    return Scores(
        frames=len(truth.frames),
        tracked=int(tracked.sum()),
        mean_mm=1e3 * summary.mean,
        median_mm=1e3 * summary.median,
        p95_mm=1e3 * summary.p95,
        over_200mm=summary.share_over,
        rmse_mean_mm=1e3 * summary.thesis_mean,
        mean_mm_without_offset=1e3 * metrics.summary(centred, reference[tracked]).mean,
        point_mm=_by_point(errors_mm, np.mean),
        point_rmse_mm=1e3 * summary.rmse_per_point,
        point_median_mm=_by_point(errors_mm, np.median),
        point_p95_mm=_by_point(errors_mm, lambda known: np.percentile(known, 95)),
        point_over_200mm=_by_point(errors_mm, lambda known: np.mean(known > 1e3 * metrics.LARGE_ERROR_M)),
        point_mm_without_offset=1e3 * _by_point(errors_centred, np.mean),
        point_offset_mm=1e3 * metrics.joint_offsets(estimate[tracked], reference[tracked]),
        coverage=covariance_coverage(estimate - reference, aligned.covariance),
        coverage_without_offset=covariance_coverage(centred - reference[tracked], aligned.covariance[tracked]),
        angles=score_angles(aligned.angles, aligned.points_world, angle_truth(truth)),
        calls=PartCalls.of(errors_mm, aligned.parts),
        errors_mm=errors_mm,
    )


def _by_point(errors: np.ndarray, statistic: Callable[[np.ndarray], Any]) -> np.ndarray:
    """Return (15,) the statistic of each point's known errors (F, 15); NaN for a point that has none."""
    columns = [column[np.isfinite(column)] for column in errors.T]
    return np.array([statistic(known) if len(known) else np.nan for known in columns])


def _named(names: tuple[str, ...], values: np.ndarray, digits: int) -> dict[str, float | None]:
    return {name: number(value, digits) for name, value in zip(names, values, strict=True)}


def number(value: float, digits: int = 4) -> float | None:
    """Return a number as JSON knows them: None for what is not finite."""
    return round(float(value), digits) if np.isfinite(value) else None


CLEAR_M = 0.1
"""A frame is clear when all 15 points are nearer to the truth."""


@dataclass(frozen=True, eq=False)
class PartCalls:
    """What a track says of the parts of the body (``PART_NAMES``), frame by frame; an untracked frame says nothing.

    wrong : (F, 5) bool, a point of the part is more than 200 mm off. called : (F, 5) bool, its published state is
    doubtful or lost. clear : (F,) bool, frames with all points known and less than 100 mm off.
    """

    wrong: np.ndarray
    called: np.ndarray
    clear: np.ndarray

    @classmethod
    def of(cls, errors_mm: np.ndarray, parts: np.ndarray) -> PartCalls:
        """Compare errors (F, 15), NaN where unknown, with the states (F, 5) of the parts, empty where unknown."""
        told = (parts.reshape(-1, len(PART_NAMES)) != "").all(axis=1)
        far = errors_mm > 1e3 * LARGE_ERROR_M
        wrong = np.stack([far[:, list(points)].any(axis=1) for points in PART_POINTS], axis=1)
        clear = (errors_mm < 1e3 * CLEAR_M).all(axis=1)
        return cls(wrong & told[:, None], (parts != GOOD) & told[:, None], clear & told)

    @property
    def flagged_of_bad(self) -> float:
        """Share of the wrong parts that are called; NaN without any."""
        return share(self.called[self.wrong])

    @property
    def false_alarms(self) -> float:
        """Share of the clear frames in which any part is called; NaN without any."""
        return share(self.called[self.clear].any(axis=1))


def share(chosen: np.ndarray) -> float:
    """Return the share of the true ones; NaN of nothing."""
    return float(chosen.mean()) if chosen.size else float("nan")
