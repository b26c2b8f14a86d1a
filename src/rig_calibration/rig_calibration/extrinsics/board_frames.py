"""Frames of a board in the room: those of one at rest averaged, of one carried about which to use, in which it lies on
the floor, and where to carry it next.

Frames are used that several cameras share, spread over the volume, the board moving slowly. The board lies on the floor
when the user says so, or where nothing was ever below its plane.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.rigid import inverse

from ..boards.board import Board, TargetDetection
from ..bundle.initial_poses import cameras_by_pose, common_frames, groups_of
from ..bundle.problem import symmetry_order_of
from ..bundle.robust_fit import CLEAR_SDS
from ..bundle.solve import solve_rig

Feature = tuple[str | int, ...]

MAX_FRAMES = 120
CELLS = 3  # an image is divided into so many cells along its width and along its height


def group_by_frame(detections: Iterable[TargetDetection]) -> dict[int, list[TargetDetection]]:
    """Group detections by frame, ascending; in each, by camera's name."""
    groups: dict[int, list[TargetDetection]] = {}
    for detection in sorted(detections, key=lambda detection: (detection.frame_index, detection.camera)):
        groups.setdefault(detection.frame_index, []).append(detection)
    return groups


def choose_frames(detections: Sequence[TargetDetection], most: int = MAX_FRAMES) -> tuple[int, ...]:
    """Choose at most ``most`` of the frames that two or more cameras see, ascending.

    Greedily the one that adds most: pairs of cameras and cells of their images that few of the chosen have, each worth
    less the more often it is there. A board that moved fast counts less (exposure and synchronisation smear it). Of
    equal ones the earliest: the same detections, in any order, give the same choice.
    """
    groups = {frame_index: group for frame_index, group in group_by_frame(detections).items() if len(group) > 1}
    if len(groups) <= most:
        return tuple(groups)
    stillness = _stillness(groups)
    features = {frame_index: _features(group) for frame_index, group in groups.items()}
    seen: Counter[Feature] = Counter()
    chosen: list[int] = []
    while len(chosen) < most:
        best = max(
            features,
            key=lambda frame_index: (stillness[frame_index] * _gain(features[frame_index], seen), -frame_index),
        )
        chosen.append(best)
        seen.update(features.pop(best))
    return tuple(sorted(chosen))


def speeds_px(detections: Iterable[TargetDetection]) -> dict[tuple[str, int], float]:
    """Measure how far the board moves a frame (median over its corners, px), by camera and frame: the slower of the way
    from the frame before and to the frame after. Missing where a camera saw the board only once."""
    by_camera: dict[str, list[TargetDetection]] = {}
    for detection in sorted(detections, key=lambda detection: (detection.camera, detection.frame_index)):
        by_camera.setdefault(detection.camera, []).append(detection)
    speeds: dict[tuple[str, int], float] = {}
    for camera, track in by_camera.items():
        for one, two in pairwise(track):
            speed = shift_px(one, two) / (two.frame_index - one.frame_index)
            for frame_index in (one.frame_index, two.frame_index):
                speeds[camera, frame_index] = min(speed, speeds.get((camera, frame_index), np.inf))
    return {key: speed for key, speed in speeds.items() if np.isfinite(speed)}


def shift_px(one: TargetDetection, two: TargetDetection) -> float:
    """Measure how far the board moved between two detections of one camera: median over the corners both show, px."""
    _, here, there = np.intersect1d(one.ids, two.ids, return_indices=True)
    way = np.linalg.norm(one.pixels[here] - two.pixels[there], axis=1)
    return float(np.median(way)) if len(way) else float("inf")


def _stillness(groups: Mapping[int, Sequence[TargetDetection]]) -> dict[int, float]:
    """1 for a board at rest, a half at the usual speed, towards 0 when it is swung."""
    speeds = speeds_px(detection for group in groups.values() for detection in group)
    usual = max(float(np.median(list(speeds.values()))), 1e-3) if speeds else 1.0
    fastest = {m: max(speeds.get((s.camera, m), usual) for s in group) for m, group in groups.items()}
    return {frame_index: 1.0 / (1.0 + speed / usual) for frame_index, speed in fastest.items()}


def _features(group: Sequence[TargetDetection]) -> tuple[Feature, ...]:
    cells = [(detection.camera, *_cell(detection)) for detection in group]
    return (*combinations(sorted({detection.camera for detection in group}), 2), *cells)


def _cell(detection: TargetDetection) -> tuple[int, int]:
    column, row = detection.pixels.mean(axis=0) / detection.image_size * CELLS
    return int(column), int(row)


def _gain(features: Sequence[Feature], seen: Counter[Feature]) -> float:
    return sum(1.0 / (1 + seen[feature]) for feature in features)


# --- When the board lies on the floor.

FloorAt = int | Literal["first", "last", "lowest"]

# Thresholds: judgement, no measurement.
BELOW_M = 0.03  # so far may another board's corner, or a camera, lie below the plane of a board on the floor
STRAYS_PERCENT = 1  # of all corners, so many may lie lower still: poses go wrong now and then


def frames_on_floor(
    cameras: Mapping[str, CameraModel], moving: Sequence[TargetDetection], board: Board, when: FloorAt
) -> tuple[int, ...]:
    """Find the frames in which the carried ``board`` lies on the floor, at one place.

    ``when``: a frame, the first or last one that shows the board, or "lowest": found by solving for the rig without a
    floor. Raises InputError when there is no such frame.
    """
    if not moving:
        raise InputError("no picture shows the carried board", remedy="Check --board and --moving.")
    if when != "lowest":
        shown = {detection.frame_index for detection in moving}
        return resting_around(moving, min(shown) if when == "first" else max(shown) if when == "last" else when)
    chosen = set(choose_frames(moving))
    if not chosen:
        raise InputError(
            "in no frame do two cameras show the carried board",
            remedy="Carry it where two or more cameras see it at once.",
        )
    some = [detection for detection in moving if detection.frame_index in chosen]
    solution = solve_rig(
        cameras, some, {some[0].target: board.corners_board}, symmetry_orders={some[0].target: symmetry_order_of(board)}
    )
    poses = {frame_index: T for (_, frame_index), T in solution.T_reference_target.items()}
    centres = [inverse(T)[:3, 3] for T in solution.T_camera_reference.values()]
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
            remedy=f"Name a frame that does, of {_ranges(list(groups))}.",
        )
    frames = list(groups)
    here = frames.index(frame_index)
    first = last = here
    while first > 0 and _rests(groups[frames[first - 1]], groups[frame_index]):
        first -= 1
    while last + 1 < len(frames) and _rests(groups[frames[last + 1]], groups[frame_index]):
        last += 1
    return tuple(frames[first : last + 1])


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
            remedy="Lay it on the floor at the end and say when (--floor-at last or --floor-at FRAME), give pictures "
            "of it on the floor (--floor), or do without a floor (--floor-at none).",
        )
    return tuple(sorted(found))


def _rests(one: Sequence[TargetDetection], other: Sequence[TargetDetection]) -> bool:
    """Do all cameras that saw the board both times see it at the same place, and is there one?"""
    ways = [shift_px(a, b) for a in one for b in other if a.camera == b.camera]
    return bool(ways) and max(ways) <= SAME_PLACE_PX


def _ranges(frames: Sequence[int]) -> str:
    """Numbers as text, at most eight of them."""
    shown = [str(frame_index) for frame_index in frames[:8]]
    return ", ".join(shown) + (f", ... {frames[-1]}" if len(frames) > 8 else "")


# --- The corners of a still board, averaged over frames without the hands that cover some.


# Thresholds: measured by python bench/calibration.py.
SAME_PLACE_PX = 1.0  # corners that lie further apart (median over the board) belong to a board, or a camera, that moved
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
    good = shown & (apart <= CLEAR_SDS * scatter)
    count = good.sum(axis=0)
    mean = np.where(good[..., None], pixels, 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
    return mean, count.astype(float)


# --- Progress while the board is carried.

ENOUGH_SHARED = 12  # so many frames tie one camera to another
ENOUGH_FRAMES = 40
ENOUGH_CELLS = 5  # of the 9 cells of its image, a camera should have seen the board in so many


@dataclass(frozen=True)
class MotionProgress:
    """frames : those in which two or more cameras saw the board. shared : frames by pair of cameras. groups : of
    cameras that are tied to each other. cells : by camera, in how many of the 9 cells of its image the board was."""

    cameras: tuple[str, ...]
    shared_frames: int
    shared: Mapping[tuple[str, str], int]
    groups: tuple[tuple[str, ...], ...]
    cells: Mapping[str, int]

    @property
    def advice(self) -> str:
        """What to do next; empty when it is enough."""
        if len(self.groups) > 1:
            return self._bring_together()
        if self.shared_frames < ENOUGH_FRAMES:
            return f"carry on: {self.shared_frames} of {ENOUGH_FRAMES} frames"
        poorest = min(self.cameras, key=lambda name: (self.cells[name], name))
        if self.cells[poorest] < ENOUGH_CELLS:
            return f"carry the board to more places of {poorest}'s image: near and far, left and right"
        return ""

    def _bring_together(self) -> str:
        """Return the pair across two groups that has most in common already, else the first of each."""
        first, rest = self.groups[0], [name for group in self.groups[1:] for name in group]
        across = {(a, b): self.shared.get((min(a, b), max(a, b)), 0) for a in first for b in rest}
        (one, other), count = max(across.items(), key=lambda item: item[1])
        shown = f"share {count} of {ENOUGH_SHARED} frames" if count else "share no view"
        return f"{one} and {other} {shown}: carry the board where both see it"


def motion_progress(cameras: Sequence[str], detections: Sequence[TargetDetection]) -> MotionProgress:
    """Measure how far the detections of the carried board tie ``cameras`` together."""
    shared = common_frames(detections)
    strong = {pair for pair, count in shared.items() if count >= ENOUGH_SHARED}
    cells: dict[str, set[tuple[int, int]]] = {name: set() for name in cameras}
    for detection in detections:
        cells[detection.camera].add(_cell(detection))
    return MotionProgress(
        cameras=tuple(sorted(cameras)),
        shared_frames=sum(len(names) > 1 for names in cameras_by_pose(detections).values()),
        shared=shared,
        groups=tuple(groups_of(cameras, strong)),
        cells={name: len(found) for name, found in cells.items()},
    )
