"""The views that an adjustment works with: corners on the board and in the image, and how well each is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError

from ..boards.board import Board, TargetDetection
from .parameters import Array

MIN_CORNERS = 8
MIN_SPREAD = 0.02  # the corners' shape on the board: its shorter axis over its longer one; below, they lie on a line
MIN_VIEWS = 3


@dataclass(frozen=True, eq=False)
class View:
    """One detection, ready for the adjustment.

    ids (n,) as the detection's; points_board (n, 3) in units of the board's diagonal, whose middle is the origin;
    bow (n, 2) how far a corner stands out where the middle does by one unit, for bending along x and along y;
    pixels (n, 2); sigma_px.
    """

    detection: TargetDetection
    ids: npt.NDArray[np.int64]
    points_board: Array
    bow: Array
    pixels: Array
    sigma_px: float

    def __len__(self) -> int:
        return len(self.pixels)

    def without(self, corners: npt.NDArray[np.bool_]) -> View:
        """The view without the marked corners (n,)."""
        keep = ~corners
        ids, points, bow, pixels = self.ids[keep], self.points_board[keep], self.bow[keep], self.pixels[keep]
        return View(self.detection, ids, points, bow, pixels, self.sigma_px)


def make_views(
    detections: Sequence[TargetDetection], board: Board
) -> tuple[list[View], list[tuple[TargetDetection, str]]]:
    """The views worth adjusting, ordered by moment, and the detections that show too little, with the reason.

    Raises InputError for what cannot belong together: images of several sizes or cameras, corners that the board does
    not have, fewer than three views.
    """
    ordered = sorted(detections, key=lambda detection: detection.frame_index)
    _require_one_camera(ordered)
    kept, poor = [], []
    for detection in ordered:
        view = view_of(detection, board)
        if isinstance(view, str):
            poor.append((detection, view))
        else:
            kept.append(view)
    if len(kept) < MIN_VIEWS:
        raise InputError(
            f"{len(kept)} views of the board can be used, {MIN_VIEWS} are the least",
            where=ordered[0].camera if ordered else "",
            remedy="Take 20 or more, tilted and all over the image; check the board's size.",
        )
    return kept, poor


def view_of(detection: TargetDetection, board: Board) -> View | str:
    """The detection ready for the adjustment, or why it is too little to fix the board's pose.

    Raises InputError for corners that the board does not have.
    """
    corners = board.corners_board
    _require_corners_of(detection, len(corners))
    reason = _poverty(detection, corners)
    if reason:
        return reason
    points = (corners - corners.mean(axis=0)) / diagonal_m(board)
    bow = 1.0 - (points[:, :2] / np.abs(points[:, :2]).max(axis=0)) ** 2
    pixels = np.asarray(detection.pixels, float).reshape(-1, 2)
    return View(detection, detection.ids, points[detection.ids], bow[detection.ids], pixels, detection.sigma_px)


def diagonal_m(board: Board) -> float:
    """The board's unit of length in the adjustment: the diagonal of its corners, m."""
    return float(np.linalg.norm(np.ptp(board.corners_board, axis=0)))


def _poverty(detection: TargetDetection, corners: Array) -> str:
    """Why a detection is too little to fix the board's pose, "" when it is not."""
    if len(detection) < MIN_CORNERS:
        return f"shows {len(detection)} corners only"
    pixels = np.asarray(detection.pixels, float)
    if not np.isfinite(pixels).all():
        return "has corners that are no numbers"
    seen = corners[detection.ids, :2]
    spread = np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)
    return "shows corners on one line only" if spread[1] < MIN_SPREAD * spread[0] else ""


def _require_one_camera(detections: Sequence[TargetDetection]) -> None:
    sizes = sorted({detection.image_size for detection in detections})
    if len(sizes) > 1:
        listed = ", ".join(f"{w} x {h} (first: moment {_first(detections, (w, h))})" for w, h in sizes)
        raise InputError(
            f"the images have several sizes: {listed}",
            where=detections[0].camera,
            remedy="Give images of one size: the one that the camera will work with.",
        )
    cameras = sorted({detection.camera for detection in detections})
    if len(cameras) > 1:
        raise InputError(
            f"the views come from several cameras: {', '.join(cameras)}",
            remedy="Calibrate each camera's intrinsics by itself.",
        )


def _first(detections: Sequence[TargetDetection], size: tuple[int, int]) -> int:
    return next(detection.frame_index for detection in detections if detection.image_size == size)


def _require_corners_of(detection: TargetDetection, count: int) -> None:
    wrong = [int(corner) for corner in detection.ids if not 0 <= corner < count]
    if wrong:
        raise InputError(
            f"moment {detection.frame_index} shows corner {wrong[0]}, but the board has {count} corners",
            where=detection.camera,
            remedy="Name the board that was filmed, and film only one.",
        )
    if len(np.unique(detection.ids)) != len(detection.ids):
        raise InputError(
            f"moment {detection.frame_index} shows a corner twice",
            where=detection.camera,
            remedy="Leave this view out.",
        )
