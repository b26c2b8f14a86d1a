"""A track scored against a session's truth: thesis Tables 7.1 and 7.2, and what they leave out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig.errors import InputError
from capture_rig.truth import Truth
from stick_figure import metrics
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES

from .track import Track

CHI2_95_3DOF = 7.814727903251179


@dataclass(frozen=True, eq=False)
class Scores:
    """Errors in mm and degrees over the truth's frames; NaN where nothing could be compared.

    frames : truth frames; tracked : those for which the track has a body.
    mean_mm, p95_mm : over all points of all tracked frames; over_200mm : share of tracked frames with any point
    further off; rmse_mean_mm : mean over the points of each point's RMSE (thesis Table 7.2).
    point_mm, point_mm_without_offset : (15,) mean error of each point, as it is and after its constant offset in the
    pelvis frame is taken out. angle_rmse_deg : (18,) or None. inside_95 : share of point errors inside the track's own
    95 % ellipsoid.
    """

    frames: int
    tracked: int
    mean_mm: float
    p95_mm: float
    over_200mm: float
    rmse_mean_mm: float
    mean_mm_without_offset: float
    point_mm: np.ndarray
    point_mm_without_offset: np.ndarray
    angle_rmse_deg: np.ndarray | None
    inside_95: float
    errors_mm: np.ndarray

    def figures(self) -> dict[str, object]:
        """Name to number, for a line of JSON."""
        whole: dict[str, object] = {"frames": self.frames, "tracked": self.tracked}
        numbers = ("mean_mm", "p95_mm", "over_200mm", "rmse_mean_mm", "mean_mm_without_offset", "inside_95")
        whole.update({name: round(float(getattr(self, name)), 4) for name in numbers})
        whole["point_mm"] = dict(zip(POINT_NAMES, np.round(self.point_mm, 1).tolist(), strict=True))
        if self.angle_rmse_deg is not None:
            whole["angle_rmse_deg"] = dict(zip(ANGLE_NAMES, np.round(self.angle_rmse_deg, 1).tolist(), strict=True))
        return whole


def score(track: Track, truth: Truth) -> Scores:
    """Compare a track with the truth, frame by frame; InputError when they share no frame."""
    aligned = track.at(truth.frames)
    tracked = np.isfinite(aligned.points_world).all(axis=(1, 2))
    if not tracked.any():
        raise InputError(
            f"the track shares none of its {len(track.frames)} frames with the truth",
            where=str(truth.source),
            remedy="Check that track and truth are of the same session.",
        )
    estimate, reference = truth.comparable(aligned.points_world[tracked]), truth.points_world[tracked]
    summary = metrics.summary(estimate, reference)
    centred = metrics.without_offsets(estimate, reference)
    errors = metrics.point_errors(estimate, reference)
    return Scores(
        frames=len(truth.frames),
        tracked=int(tracked.sum()),
        mean_mm=1e3 * summary.mean,
        p95_mm=1e3 * summary.p95,
        over_200mm=summary.share_over,
        rmse_mean_mm=1e3 * summary.thesis_mean,
        mean_mm_without_offset=1e3 * metrics.summary(centred, reference).mean,
        point_mm=1e3 * np.nanmean(errors, axis=0),
        point_mm_without_offset=1e3 * np.nanmean(metrics.point_errors(centred, reference), axis=0),
        angle_rmse_deg=_angle_rmse_deg(aligned.angles[tracked], truth, tracked),
        inside_95=_share_inside(estimate - reference, aligned.covariance[tracked]),
        errors_mm=1e3 * metrics.point_errors(truth.comparable(aligned.points_world), truth.points_world),
    )


def _angle_rmse_deg(angles: np.ndarray, truth: Truth, tracked: np.ndarray) -> np.ndarray | None:
    return None if truth.angles is None else np.rad2deg(metrics.rmse_angles(angles, truth.angles[tracked]))


def _share_inside(errors: np.ndarray, covariance: np.ndarray) -> float:
    known = np.isfinite(errors).all(-1)
    solved = np.linalg.solve(covariance[known], errors[known][..., None])[..., 0]
    distance = np.einsum("ni,ni->n", errors[known], solved)
    return float((distance <= CHI2_95_3DOF).mean())
