"""The floor board: its corners averaged over several frames, and the pose of one camera from it (thesis 6.1).

It is mostly seen at a grazing angle. A plane has two poses that fit its picture nearly as well (Schweighofer & Pinz
2006): both are kept unless the corners rule one out. EPnP is not used: it fails by metres at a grazing angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.rigid import inverse, transform

from ..boards.board import Board, TargetDetection
from ..bundle.problem import MIN_CORNERS, detection_poses, target_shape

FLOOR = "floor"  # the name of the target
RULED_OUT_SDS = 5  # standard deviations by which the second solution must explain the corners worse to be ruled out


@dataclass(frozen=True, eq=False)
class FloorView:
    """How one camera sees the board on the floor.

    T_camera_board : (4, 4). rms_px : of the corners' coordinates. other : the second solution (4, 4), None when the
    corners rule it out. distance_m and angle (rad, from the board's normal) : of the camera, from the board's middle.
    """

    camera: str
    T_camera_board: Array
    rms_px: float
    corners: int
    other: Array | None
    distance_m: float
    angle: float


def floor_view(detection: TargetDetection, corners_board: Array, camera: CameraModel) -> FloorView:
    """Find the camera's pose before the board that ``detection`` shows. Only the intrinsics of ``camera`` are used.

    ``corners_board`` (n, 3) metres. Raises InputError for too few corners, and for a board seen from below.
    """
    if len(detection) < MIN_CORNERS:
        raise InputError(
            f"only {len(detection)} corners of the board are seen",
            where=detection.camera,
            remedy=f"Show it whole, or give its {MIN_CORNERS} outer corners (--corners).",
        )
    points = corners_board[detection.ids]
    solutions = _solutions(detection, corners_board, camera)
    if not solutions:
        raise InputError(
            "the corners fit no pose of the board",
            where=detection.camera,
            remedy="Check its corners in the picture, or give its outer corners (--corners).",
        )
    above = [(rms, T) for rms, T in solutions if inverse(T)[2, 3] > 0]
    if not above:
        raise InputError(
            "the corners' order is that of a board seen from below or in a mirror",
            where=detection.camera,
            remedy="Lay the print upwards, switch off the camera's mirroring, and give outer corners "
            "in reading order: the first row's two ends, then the last row's last and first.",
        )
    rms, T = above[0]
    to_camera = inverse(T)[:3, 3] - points.mean(axis=0)
    distance = float(np.linalg.norm(to_camera))
    return FloorView(
        camera=detection.camera,
        T_camera_board=T,
        rms_px=rms,
        corners=len(detection),
        other=_not_ruled_out(above, len(detection), max(detection.sigma_px, rms)),
        distance_m=distance,
        angle=float(np.arccos(np.clip(to_camera[2] / distance, -1.0, 1.0))),
    )


def _solutions(detection: TargetDetection, corners_board: Array, camera: CameraModel) -> list[tuple[float, Array]]:
    """Poses that fit, the best first: (rms of the raw pixels' coordinates, T_camera_board)."""
    shape = target_shape(detection.target, corners_board)
    poses = detection_poses(detection, camera, shape)
    if poses is None:
        return []
    found = [transform(R, t - R @ shape.centroid) for R, t in zip(poses.R, poses.t, strict=True)]
    points = corners_board[detection.ids]
    misses = [replace(camera, T_camera_world=T).project(points) - detection.pixels for T in found]
    return sorted(((_rms(miss), T) for miss, T in zip(misses, found, strict=True)), key=lambda pair: pair[0])


def _rms(misses: Array) -> float:
    """Return that of the coordinates, without corners beyond the reach of the lens; infinite where all are."""
    reached = misses[np.isfinite(misses).all(axis=1)]
    return float(np.sqrt((reached**2).mean())) if reached.size else float("inf")


def _not_ruled_out(solutions: list[tuple[float, Array]], corners: int, sigma: float) -> Array | None:
    """Return the next best solution, when its residual is not clearly worse."""
    worse = [2 * corners * (rms**2 - solutions[0][0] ** 2) for rms, _ in solutions]
    return solutions[1][1] if len(solutions) > 1 and worse[1] < (RULED_OUT_SDS * sigma) ** 2 else None


# --- The corners of a still board, averaged over frames without the hands that cover some.


# Thresholds: measured by python bench/calibration.py.
SAME_PLACE_PX = 1.0  # corners that lie further apart (median over the board) belong to a board, or a camera, that moved
OUTLIER_SDS = 4.0
MIN_SHARE = 1 / 3  # a corner counts when so many of the frames that agree show it
LASTING_PX = 0.05  # not removed by averaging: compression, the grid of pixels and the lens err alike in every frame


@dataclass(frozen=True, eq=False)
class StillBoard:
    """What one camera's frames say together.

    detection : the averaged corners. frames : the frames that agree. moved_frames : those that show the
    board elsewhere.
    """

    detection: TargetDetection
    frames: tuple[int, ...]
    moved_frames: tuple[int, ...]


def average_still_board(detections: Sequence[TargetDetection], board: Board, *, target: str) -> StillBoard:
    """Average one camera's ``detections`` of a board that lies still, as a detection of ``target``.

    The largest group of frames that show the board at the same place is taken, of equal ones the earliest; in it, a
    corner's frames that stray from the median (a hand at its edge) are left out. Needs one detection or more.
    """
    ordered = sorted(detections, key=lambda detection: detection.frame_index)
    pixels = _table(ordered, len(board.corners_board), board.half_turn_is_visible)  # (F, N, 2)
    together = _largest_group(pixels)
    chosen = pixels[together]
    single = float(np.median([ordered[index].sigma_px for index in np.flatnonzero(together)]))
    mean, count = _mean_without_outliers(chosen, single)
    ids = np.flatnonzero(count >= max(1.0, MIN_SHARE * len(chosen)))
    sigma = float(np.hypot(single / np.sqrt(np.median(count[ids])), LASTING_PX))
    averaged = replace(ordered[0], frame_index=0, target=target, ids=ids, pixels=mean[ids], sigma_px=sigma)
    frames = np.array([detection.frame_index for detection in ordered])
    return StillBoard(averaged, tuple(frames[together].tolist()), tuple(frames[~together].tolist()))


def _table(detections: Sequence[TargetDetection], corners: int, half_turn_is_visible: bool) -> Array:
    """(F, corners, 2) pixels, NaN where a frame does not show a corner; boards that may be seen either way round are
    counted as the first frame counts them."""
    table = np.full((len(detections), corners, 2), np.nan)
    for row, detection in zip(table, detections, strict=True):
        row[detection.ids] = detection.pixels
    if not half_turn_is_visible:
        for row in table[1:]:
            if _distance(row[::-1], table[0]) < _distance(row, table[0]):
                row[:] = row[::-1].copy()
    return table


def _largest_group(pixels: Array) -> npt.NDArray[np.bool_]:
    """(F,) which frames show the board at the place at which most show it."""
    near = np.array([[_distance(one, other) <= SAME_PLACE_PX for other in pixels] for one in pixels])
    return near[near.sum(axis=1).argmax()]


def _distance(one: Array, other: Array) -> float:
    """Median distance, px, of the corners that both show; infinite when they share none."""
    apart = np.linalg.norm(one - other, axis=1)
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if apart.size else float("inf")


def _mean_without_outliers(pixels: Array, sigma_px: float) -> tuple[Array, Array]:
    """Mean (N, 2) and number of frames (N,) of each corner; median and MAD (their noise, where that is more) tell
    which frames stray."""
    shown = np.isfinite(pixels[..., 0])
    seen = np.flatnonzero(shown.any(axis=0))
    median = np.full(pixels.shape[1:], np.nan)
    median[seen] = np.nanmedian(pixels[:, seen], axis=0)
    apart = np.linalg.norm(pixels - median, axis=2)
    scatter = max(sigma_px, 1.4826 * float(np.median(apart[shown])))
    good = shown & (apart <= OUTLIER_SDS * scatter)
    count = good.sum(axis=0)
    mean = np.where(good[..., None], pixels, 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
    return mean, count.astype(float)
