"""A wand of bright markers on a line, at known distances: its detection in one image.

Its detections go to :func:`.solve.solve_rig` beside those of boards, or alone:

    solve_rig(cameras, detections, {WAND: wand_points(marks_m)}, alike={WAND} if wand_looks_alike(marks_m) else ())

Markers on a line at positions s_i appear on a line of the image at u_i = (a s_i + b) / (c s_i + 1): with four or more
the cross ratio identifies a wand, with three the spacing does, because the far end of a wand of that length cannot be
much farther away than the near end: z_far / z_near = 1 + c (s_far - s_near), s counted from s_near.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array

from .board import TargetDetection

Grey = npt.NDArray[np.uint8]

WAND = "wand"
MIN_ASYMMETRY = 0.15  # of the wand's length: least difference from the mirror image by which ends are distinguished
MAX_BLOBS = 10
# Thresholds: judgement, no measurement.
OFF_PLACE = 0.02  # of the wand's length in the image: a spot farther from its place, along or beside, is no marker
MIN_MARK_DISTANCE = 2 * OFF_PLACE  # of the wand's length: nearer, a spot might be either
MAX_DEPTH_RATIO = 1.6  # far end over near end, in distance: a wand seen from less than twice its length away is refused
MIN_CONTRAST = 30  # grey levels of a marker's peak above its surroundings
PEAK_SHARE = 0.4  # of the brightest marker: threshold of markers
MIN_AREA_PX, MAX_AREA_SHARE = 2, 0.01  # of the image
MAX_ELONGATION = 4  # length over width: a longer streak is a reflection or moved while exposed
RIM_PX = 2  # around the thresholded blob, whose soft edge counts too
CENTROID_SIGMA_PX = 0.1


def wand_points(marks_m: Sequence[float]) -> Array:
    """(k, 3) the markers of a wand in its own frame, x along it, m. InputError for fewer than two, or equal ones."""
    marks = _marks(marks_m)
    return np.column_stack([marks, np.zeros((len(marks), 2))])


def wand_looks_alike(marks_m: Sequence[float]) -> bool:
    """Whether a wand looks the same from both ends (two markers, or evenly spaced ones); InputError where nearly so."""
    marks = _marks(marks_m)
    spacing = np.diff(marks) / np.ptp(marks)
    unlike = float(np.abs(spacing - spacing[::-1]).max())
    if 1e-3 < unlike < MIN_ASYMMETRY:
        raise InputError(
            f"the markers at {', '.join(f'{m:g}' for m in marks)} m are spaced almost, but not quite, "
            "alike from both ends",
            where="wand marks",
            remedy="Space them evenly, or clearly unevenly (0, 0.25, 0.4).",
        )
    return unlike <= 1e-3


def find_wand(
    image: np.ndarray,
    marks_m: Sequence[float],
    camera: CameraModel,
    *,
    frame_index: int = 0,
    target: str = WAND,
    background: np.ndarray | None = None,
) -> TargetDetection | None:
    """Find the wand in an image (H, W[, 3]) uint8; None when its markers are not all seen.

    The image should be dark but for the wand (short exposure), or ``background`` be given: the same view without it.
    """
    marks = _marks(marks_m)
    blobs = find_blobs(image, background)
    ideal = camera.ideal_points(blobs)
    reached = np.flatnonzero(np.isfinite(ideal).all(axis=1))
    rows = label_markers(ideal[reached], marks)
    if rows is None:
        return None
    pixels = blobs[reached][rows]
    size = (image.shape[1], image.shape[0])
    return TargetDetection(camera.name, frame_index, np.arange(len(marks)), pixels, size, target, CENTROID_SIGMA_PX)


def _marks(marks_m: Sequence[float]) -> Array:
    marks = np.asarray(marks_m, float).ravel()
    remedy = "Give the markers' places along the wand in metres, as 0,0.25,0.4."
    if not 2 <= len(marks) <= 6 or not np.isfinite(marks).all():
        raise InputError(f"a wand of {len(marks)} markers cannot be used", where="wand marks", remedy=remedy)
    if np.any(np.diff(marks) < MIN_MARK_DISTANCE * np.ptp(marks)) or np.ptp(marks) <= 0:
        raise InputError(
            f"the markers at {', '.join(f'{m:g}' for m in marks)} m do not rise, or nearly coincide",
            where="wand marks",
            remedy=remedy,
        )
    return marks


# --- Which bright spot is which marker.


def label_markers(points: Array, marks_m: Array) -> Array | None:
    """Return the rows of ``points`` (n, 2), undistorted, brightest first, of the markers at ``marks_m`` (k,), in order.

    None when no k of them can be the wand. Of a wand that looks the same from both ends, either order.
    """
    best, chosen = np.inf, None
    for rows in combinations(range(min(len(points), MAX_BLOBS)), len(marks_m)):
        along = _on_a_line(points[list(rows)])
        if along is None:
            continue
        order = np.asarray(rows)[np.argsort(along)]
        for candidate, u in ((order, np.sort(along)), (order[::-1], np.sort(-along))):
            cost = _cost(u, marks_m)
            if cost < best - 1e-12:
                best, chosen = cost, candidate
    return chosen


def _on_a_line(points: Array) -> Array | None:
    """Return the places (k,) along the line through the points; None when they are not collinear, or coincide."""
    centred = points - points.mean(0)
    _, _, axes = np.linalg.svd(centred, full_matrices=True)
    along, across = centred @ axes[0], centred @ axes[1]
    length = np.ptp(along)
    return along if length > 0 and np.abs(across).max() <= OFF_PLACE * length else None


def _cost(u: Array, marks_m: Array) -> float:
    """Return the misfit of spots and wand: of their places, with the implied depth; infinite for impossible ones.

    Both ``u`` and ``marks_m`` rise.
    """
    s = (marks_m - marks_m[0]) / (marks_m[-1] - marks_m[0])
    u = (u - u[0]) / (u[-1] - u[0])
    if len(s) == 2:
        return 0.0
    # u = (a s) / (c s + 1) with u(1) = 1: a = 1 + c, hence u - s = c s (1 - u), and 1 + c = z_far / z_near
    weight = (s * (1 - u))[1:-1]
    c = float(weight @ (u - s)[1:-1] / (weight @ weight))
    if not 1 / MAX_DEPTH_RATIO <= 1 + c <= MAX_DEPTH_RATIO:
        return np.inf
    misfit = float(np.abs((1 + c) * s / (c * s + 1) - u).max())
    return misfit / OFF_PLACE + abs(np.log(1 + c)) if misfit <= OFF_PLACE else np.inf


# --- Bright markers in an image: light-emitting diodes, retro-reflective balls.


def find_blobs(image: np.ndarray, background: np.ndarray | None = None) -> Array:
    """Find compact spots in an image (H, W[, 3]) uint8 that are brighter than their surroundings: their centroids
    (n, 2), pixel centres at whole numbers, brightest first.

    ``background``: the same view without the wand; if missing, spots larger than a marker are background. Centroids are
    weighted by the marker's coverage of each pixel. Raises InputError when ``background`` is of another size.
    """
    grey = _grey(image)
    bright = _above(grey, None if background is None else _grey(background))
    peak = float(bright.max(initial=0.0))
    if peak < MIN_CONTRAST:
        return np.empty((0, 2))
    mask = (bright > max(PEAK_SHARE * peak, MIN_CONTRAST / 2)).astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(mask)
    lit = _with_rim(mask)
    _, _, width, height, area = boxes.T
    compact = (area >= MIN_AREA_PX) & (area <= MAX_AREA_SHARE * mask.size) & (area > 0.3 * width * height)
    compact &= np.maximum(width, height) <= MAX_ELONGATION * np.minimum(width, height)
    found = [_measure(grey, bright, lit, labels == i, boxes[i]) for i in range(1, count) if compact[i]]
    return np.array(sorted(found, key=lambda blob: -blob[2]), float).reshape(-1, 3)[:, :2]


def _grey(image: np.ndarray) -> Grey:
    grey = image if image.ndim == 2 else image.max(axis=2)  # markers may be of any colour
    if grey.dtype != np.uint8:
        raise InputError(f"an image of {grey.dtype} was given", remedy="Give 8-bit images.")
    return np.ascontiguousarray(grey)


def _above(grey: Grey, background: Grey | None) -> npt.NDArray[np.float32]:
    """Return the brightness above the surroundings, grey levels, less the surroundings' noise."""
    behind = background
    if behind is None:
        side = 2 * (max(grey.shape) // 50) + 1
        round_ = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        behind = cv2.morphologyEx(grey, cv2.MORPH_OPEN, round_).astype(np.uint8)
    elif behind.shape != grey.shape:
        raise InputError(
            f"the background has {behind.shape[1]} x {behind.shape[0]} pixels, the image "
            f"{grey.shape[1]} x {grey.shape[0]}",
            remedy="Take both with the same camera settings.",
        )
    difference = cv2.subtract(grey, behind).astype(np.float32)
    return np.maximum(difference - 2 * np.median(difference), 0)


def _with_rim(mask: Grey) -> Grey:
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * RIM_PX + 1, 2 * RIM_PX + 1))
    return np.asarray(cv2.dilate(mask, disc), np.uint8)


def _measure(
    grey: Grey, bright: npt.NDArray[np.float32], lit: Grey, blob: npt.NDArray[np.bool_], box: np.ndarray
) -> tuple[float, float, float]:
    """Return centroid and brightness of a blob; ``lit`` marks all blobs and their rims.

    The background behind the marker is inpainted from around it, which gives the pixels' coverage: a dark stick on one
    side of a ball before a brighter wall would otherwise shift it by 0.03 px, and make a wand 0.1 % too long.
    """
    x, y, width, height = (int(v) for v in box[:4])
    margin = RIM_PX + 4
    part = np.s_[max(y - margin, 0) : y + height + margin, max(x - margin, 0) : x + width + margin]
    own = _with_rim(blob[part].astype(np.uint8)) > 0
    behind = cv2.inpaint(np.ascontiguousarray(grey[part]), np.ascontiguousarray(lit[part]), 1.5, cv2.INPAINT_TELEA)
    full = float(grey[part][blob[part]].max())
    coverage = (grey[part] - behind.astype(float)) / np.maximum(full - behind.astype(float), 1.0)
    weight = np.where(own, np.clip(coverage, 0.0, 1.0), 0.0)
    rows, columns = np.mgrid[part]
    total = weight.sum()
    return (weight * columns).sum() / total, (weight * rows).sum() / total, float(bright[part][own].sum())
