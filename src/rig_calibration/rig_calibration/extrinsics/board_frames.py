"""Frames of a board in the room: averages of a board at rest; choice of frames of a carried board, those on the floor,
and advice where to carry it next.

The board lies on the floor in frames that the user names, or where nothing was ever below its plane.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from typing import Literal

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array

from ..boards.board import Board, TargetDetection
from ..bundle.initial_poses import common_frames, groups_of
from ..bundle.solve import solve_rig
from .calibrate import FLOOR

MAX_FRAMES = 160


def group_by_frame(detections: Iterable[TargetDetection]) -> dict[int, list[TargetDetection]]:
    """Group detections by frame, ascending; in each, by camera's name."""
    groups: dict[int, list[TargetDetection]] = {}
    for detection in sorted(detections, key=lambda detection: (detection.frame_index, detection.camera)):
        groups.setdefault(detection.frame_index, []).append(detection)
    return groups


def shared_frames(detections: Iterable[TargetDetection], most: int = MAX_FRAMES) -> tuple[int, ...]:
    """Choose the frames that two or more cameras see, at most ``most``, evenly spread, ascending."""
    shared = [frame_index for frame_index, group in group_by_frame(detections).items() if len(group) > 1]
    return tuple(shared[:: max(1, -(-len(shared) // most))])


# --- When the board lies on the floor.

LOWEST: Literal["lowest"] = "lowest"
FloorAt = int | Literal["lowest"]

# Thresholds: judgement, no measurement.
BELOW_M = 0.03  # largest depth of another board's corner, or a camera, below the plane of a board on the floor
STRAYS_PERCENT = 1  # of all corners that may lie lower still, as some poses are wrong


def frames_on_floor(
    cameras: Mapping[str, CameraModel], moving: Sequence[TargetDetection], board: Board, when: FloorAt
) -> tuple[int, ...]:
    """Find the frames in which the carried ``board`` lies on the floor, at one place.

    ``when``: a frame, or "lowest": found by solving for the rig without a floor. Raises InputError when there is no
    such frame.
    """
    if when != LOWEST:
        return resting_around(moving, when)
    chosen = set(shared_frames(moving))
    if not chosen:
        raise InputError(
            "in no frame do two cameras show the carried board",
            remedy="Carry it where two or more cameras see it at once.",
        )
    some = [detection for detection in moving if detection.frame_index in chosen]
    target = some[0].target
    alike = () if board.half_turn_is_visible else (target,)
    solution = solve_rig(cameras, some, {target: board.corners_board}, alike=alike)
    poses = {frame_index: T for (_, frame_index), T in solution.T_reference_target.items()}
    centres = [camera.centre_world for camera in solution.cameras.values()]
    lying = lying_frames(poses, board.corners_board, centres)
    return max((resting_around(moving, frame_index) for frame_index in lying[::-1]), key=len)


def resting_around(detections: Iterable[TargetDetection], frame_index: int) -> tuple[int, ...]:
    """Find ``frame_index`` and those right before and after it at which the board rests, as far as the cameras saw it.

    Raises InputError when no camera saw the board at ``frame``.
    """
    groups = group_by_frame(detections)
    if frame_index not in groups:
        raise InputError(
            f"no camera shows the board in frame {frame_index}",
            remedy=f"Name a frame that does, from {min(groups)} to {max(groups)}.",
        )

    def rests(frame: int) -> bool:
        return _rests(groups[frame], groups[frame_index])

    before = takewhile(rests, [frame for frame in reversed(groups) if frame < frame_index])
    after = takewhile(rests, [frame for frame in groups if frame > frame_index])
    return tuple(sorted([*before, frame_index, *after]))


def lying_frames(
    T_reference_board: Mapping[int, Array], corners_board: Array, centres_reference: Sequence[Array]
) -> tuple[int, ...]:
    """Find the frames, ascending, in which no corner of any other frame, and no camera, lies below the board's plane.

    ``corners_board`` (n, 3); centres (3,). Raises InputError when there is no such frame.
    """
    poses = np.array(list(T_reference_board.values()))
    corners = poses[:, None, :3, :3] @ corners_board[..., None]
    everything = np.concatenate([(corners[..., 0] + poses[:, None, :3, 3]).reshape(-1, 3), centres_reference])
    heights = np.einsum("mek,mk->me", everything - poses[:, None, :3, 3], poses[:, :3, 2])
    lowest = np.percentile(heights, STRAYS_PERCENT, axis=1)
    found = [frame for frame, low in zip(T_reference_board, lowest, strict=True) if low > -BELOW_M]
    if not found:
        raise InputError(
            "in no frame does the carried board lie on the floor: each time it was elsewhere below that plane",
            remedy="Lay it on the floor and say when (--floor-at FRAME), give pictures of it there (--floor), or do "
            "without a floor (--floor-at none).",
        )
    return tuple(sorted(found))


def _rests(one: Sequence[TargetDetection], other: Sequence[TargetDetection]) -> bool:
    """Return whether some camera saw the board both times, and all such cameras at the same place."""
    ways = []
    for a, b in ((a, b) for a in one for b in other if a.camera == b.camera):
        _, here, there = np.intersect1d(a.ids, b.ids, return_indices=True)
        ways.append(_distance(a.pixels[here], b.pixels[there]))
    return bool(ways) and max(ways) <= SAME_PLACE_PX


# --- The corners of a still board, averaged over frames without the hands that cover some.


# Thresholds: measured by python bench/calibration.py.
SAME_PLACE_PX = 1.0  # corners that lie further apart (median over the board) belong to a board, or a camera, that moved
MIN_SHARE = 1 / 3  # of the agreeing frames that must show a corner
LASTING_PX = 0.05  # not removed by averaging: compression, the grid of pixels and the lens err alike in every frame


def average_still_board(detections: Sequence[TargetDetection], board: Board) -> TargetDetection:
    """Average one camera's ``detections`` of a board that lies still, as one of FLOOR.

    A corner's frames that stray from the median (a hand at its edge, a board that was moved) are left out. Needs one
    detection or more.
    """
    ordered = sorted(detections, key=lambda detection: detection.frame_index)
    pixels = _table(ordered, len(board.corners_board), board.half_turn_is_visible)  # (F, N, 2)
    least = max(1.0, MIN_SHARE * len(ordered))
    ids = np.flatnonzero(np.isfinite(pixels[..., 0]).sum(axis=0) >= least)
    good = np.linalg.norm(pixels[:, ids] - np.nanmedian(pixels[:, ids], axis=0), axis=2) <= SAME_PLACE_PX  # NaN is not
    count = good.sum(axis=0)
    mean = np.where(good[..., None], pixels[:, ids], 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
    single = float(np.median([detection.sigma_px for detection in ordered]))
    sigma = float(np.hypot(single / np.sqrt(np.median(count)), LASTING_PX))
    kept = count >= least
    return replace(ordered[0], frame_index=0, target=FLOOR, ids=ids[kept], pixels=mean[kept], sigma_px=sigma)


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


def _distance(one: Array, other: Array) -> float:
    """Return the median distance, px, of the common corners; infinite without any."""
    apart = np.linalg.norm(one - other, axis=1)
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if apart.size else float("inf")


# --- Progress while the board is carried.

ENOUGH_SHARED = 12  # common frames that tie one camera to another
ENOUGH_FRAMES = 40


def motion_advice(cameras: Sequence[str], detections: Sequence[TargetDetection]) -> tuple[int, str]:
    """Count the frames of the carried board that tie ``cameras`` together, and advise what to do next; "" when they are
    enough."""
    shared, frames = common_frames(detections), len(shared_frames(detections, len(detections) + 1))
    groups = groups_of(cameras, [pair for pair, count in shared.items() if count >= ENOUGH_SHARED])
    if len(groups) > 1:  # the pair across two groups that has most in common already
        across = [tuple(sorted((a, b))) for a in groups[0] for group in groups[1:] for b in group]
        one, other = max(across, key=lambda pair: shared.get((pair[0], pair[1]), 0))
        count = shared.get((one, other), 0)
        shown = f"share {count} of {ENOUGH_SHARED} frames" if count else "share no view"
        return frames, f"{one} and {other} {shown}: carry the board where both see it"
    return frames, "" if frames >= ENOUGH_FRAMES else f"carry on: {frames} of {ENOUGH_FRAMES} frames"
