"""A track scored against a session's truth: thesis Tables 7.1 and 7.2, and further figures."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

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


# points ---------------------------------------------------------------------------------------------------------------


DIMENSIONS = 3
INSIDE_95 = float(chi2.ppf(0.95, DIMENSIONS))
"""Squared Mahalanobis distance that 95 % of the errors stay below when the covariance is right."""
LARGE_ERROR_MM = 1e3 * LARGE_ERROR_M
CLEAR_MM = 0.5 * LARGE_ERROR_MM
"""A point farther off is lost; a frame with all 15 points nearer than half of that is clear."""


def nees_of(errors: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Normalised estimation error squared (F, 15), e^T P^-1 e, of errors (F, 15, 3) m with the covariances stated for
    them, m^2; NaN where either is unknown, infinite where P claims certainty."""
    known = np.isfinite(errors).all(-1) & np.isfinite(covariance).all((-2, -1))
    out = np.full(errors.shape[:-1], np.nan)
    out[known] = np.inf
    regular = known & (np.linalg.det(np.where(known[..., None, None], covariance, np.eye(DIMENSIONS))) > 0.0)
    e = errors[regular]
    out[regular] = np.einsum("ni,ni->n", e, np.linalg.solve(covariance[regular], e[..., None])[..., 0])
    return out


def mean_of_known(values: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return the mean over the known values; NaN where there is none."""
    known = ~np.isnan(values)
    count = known.sum(axis)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis) / np.maximum(count, 1), np.nan)


def share_below(bound: float, values: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return the share of the known values that are at most the bound; NaN where there is none."""
    return mean_of_known(np.where(np.isnan(values), np.nan, values <= bound), axis)


@dataclass(frozen=True, eq=False)
class PointScores:
    """Errors of each point, (15,), or of all points together; NaN where nothing could be compared.

    over_200mm : share of frames in which it, or any point, is farther off. rmse_mm : thesis eq. 7.3, corrected (it sums
    signed differences, so that +10 and -10 mm would cancel to 0); of all the mean of the points' own, the last line of
    Table 7.2. ..._without_offset : after each point's constant offset in the pelvis frame is taken out: where
    truth and stick figure mean different places by "shoulder" or "hip", that part is not the tracker's error, and the
    covariance is about our own definition of the points (docs/reference/points.md).
    inside_95 : share of errors inside the track's 95 % ellipsoid. nees : mean of :func:`nees_of`, 3 when
    the covariance is right, more for an overconfident track (Bar-Shalom, Li & Kirubarajan, Estimation with Applications
    to Tracking and Navigation, 5.4).
    """

    mean_mm: np.ndarray
    median_mm: np.ndarray
    p95_mm: np.ndarray
    over_200mm: np.ndarray
    rmse_mm: np.ndarray
    mean_mm_without_offset: np.ndarray
    inside_95: np.ndarray
    inside_95_without_offset: np.ndarray
    nees: np.ndarray

    @classmethod
    def of(cls, errors_mm: np.ndarray, centred_mm: np.ndarray, nees: np.ndarray, centred: np.ndarray) -> PointScores:
        """Summarise the columns of errors (F, n) as they are and without offsets, and of their NEES."""

        known = [column[np.isfinite(column)] for column in errors_mm.T]
        middle, high = np.transpose([np.percentile(k, [50, 95]) if len(k) else [np.nan, np.nan] for k in known])
        return cls(
            mean_of_known(errors_mm, 0),
            middle,
            high,
            1.0 - share_below(LARGE_ERROR_MM, errors_mm, 0),
            np.sqrt(mean_of_known(errors_mm**2, 0)),
            mean_of_known(centred_mm, 0),
            share_below(INSIDE_95, nees, 0),
            share_below(INSIDE_95, centred, 0),
            mean_of_known(nees, 0),
        )


OVERALL = (
    *("mean_mm", "median_mm", "p95_mm", "over_200mm", "rmse_mean_mm", "mean_mm_without_offset", "inside_95"),
    *("inside_95_without_offset", "flagged_of_bad", "false_alarms"),
)


@dataclass(frozen=True, eq=False)
class Scores:
    """Errors over the truth's frames, NaN where nothing could be compared.

    frames : truth frames; tracked : those for which the track has a body. Everything else is over these:
    all_points, points : errors of all points together, and of each. point_offset_mm : (15, 3) constant offset of each
    in the pelvis frame, track minus truth, forward, left and up. angles : the joint angles. calls : the parts of the
    body that are called doubtful or lost, rightly or not. errors_mm : (frames, 15) every error.
    """

    frames: int
    tracked: int
    all_points: PointScores
    points: PointScores
    point_offset_mm: np.ndarray
    angles: AngleScores
    calls: PartCalls
    errors_mm: np.ndarray

    @property
    def mean_mm(self) -> float:
        """Of all points."""
        return float(self.all_points.mean_mm)

    @property
    def overall(self) -> dict[str, float]:
        """The figures of all points together, by their names in OVERALL."""
        calls = {"flagged_of_bad": self.calls.flagged_of_bad, "false_alarms": self.calls.false_alarms}
        every = {**vars(self.all_points), "rmse_mean_mm": self.all_points.rmse_mm, **calls}
        return {name: float(every[name]) for name in OVERALL}

    def figures(self) -> dict[str, object]:
        """Name to number, for a line of JSON."""
        points = self.points
        return {
            "frames": self.frames,
            "tracked": self.tracked,
            **{name: number(value) for name, value in self.overall.items()},
            "nees": number(float(self.all_points.nees)),
            "point_mm": _named(POINT_NAMES, points.mean_mm, 1),
            "point_offset_mm": dict(zip(POINT_NAMES, self.point_offset_mm.round(1).tolist(), strict=True)),
            "point_rmse_mm": _named(POINT_NAMES, points.rmse_mm, 1),
            "point_inside_95": _named(POINT_NAMES, points.inside_95, 3),
            "point_inside_95_without_offset": _named(POINT_NAMES, points.inside_95_without_offset, 3),
            "angle_rmse_deg": _named(ANGLE_NAMES, np.rad2deg(self.angles.rmse_rad), 1),
            "torso_rmse_deg": number(np.rad2deg(self.angles.torso_rmse_rad)),
        }


def score(track: Track, truth: Truth) -> Scores:
    """Compare a track with the truth, frame by frame; InputError when they share no frame."""
    aligned = track.at(truth.frames)
    tracked = np.isfinite(aligned.points_world).all(axis=(1, 2))
    if not tracked.any():
        what = f"the track shares none of its {len(track.frames)} frames with the truth"
        raise InputError(what, where=str(truth.source), remedy="Check that track and truth are of the same session.")
    estimate, reference = truth.comparable(aligned.points_world), truth.points_world
    errors = estimate - reference
    errors_mm = 1e3 * metrics.point_errors(estimate, reference)
    offsets = metrics.joint_offsets(estimate[tracked], reference[tracked])
    centred = np.full_like(errors, np.nan)
    centred[tracked] = metrics.without_offsets(estimate[tracked], reference[tracked]) - reference[tracked]
    nees, nees_centred = nees_of(errors, aligned.covariance), nees_of(centred, aligned.covariance)
    measured = errors_mm, 1e3 * np.linalg.norm(centred, axis=2), nees, nees_centred
    points, together = PointScores.of(*measured), PointScores.of(*(values.reshape(-1, 1) for values in measured))
    worst_mm = np.nan_to_num(errors_mm).max(axis=1)[np.isfinite(errors_mm).any(axis=1)]
    of_all = {name: values[0] for name, values in vars(together).items()}
    of_all |= {"over_200mm": share(worst_mm > LARGE_ERROR_MM), "rmse_mm": mean_of_known(points.rmse_mm)}
    return Scores(
        frames=len(truth.frames),
        tracked=int(tracked.sum()),
        all_points=PointScores(**of_all),
        points=points,
        point_offset_mm=1e3 * offsets,
        angles=score_angles(aligned.angles, aligned.points_world, angle_truth(truth)),
        calls=PartCalls.of(errors_mm, aligned.parts),
        errors_mm=errors_mm,
    )


def _named(names: tuple[str, ...], values: np.ndarray, digits: int) -> dict[str, float | None]:
    return {name: number(value, digits) for name, value in zip(names, values, strict=True)}


def number(value: float, digits: int = 4) -> float | None:
    """Return a number for JSON: None if it is not finite."""
    return round(float(value), digits) if np.isfinite(value) else None


@dataclass(frozen=True, eq=False)
class PartCalls:
    """Published states of the parts of the body (``PART_NAMES``) against their errors, frame by frame, where tracked.

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
        far = errors_mm > LARGE_ERROR_MM
        wrong = np.stack([far[:, list(points)].any(axis=1) for points in PART_POINTS], axis=1)
        clear = (errors_mm < CLEAR_MM).all(axis=1)
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
