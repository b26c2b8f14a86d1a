"""A wand of bright markers on a line, at known distances: what one image shows of it.

Its sightings go to :func:`.solve.solve_rig` beside those of boards, or alone:

    solve_rig(cameras, sightings, {WAND: wand_points(marks_m)}, turnable={WAND: wand_turns(marks_m)})
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from ..boards.sighting import Sighting
from .rigid import Array
from .sighting_poses import undistorted
from .wand_blobs import CENTROID_SIGMA_PX, find_blobs
from .wand_labels import label_markers

WAND = "wand"
LEAST_MARK_DISTANCE = 0.05  # of the wand's length
TELLING = 0.15  # of the wand's length: markers that differ by less from their mirror image do not tell the ends


def wand_points(marks_m: Sequence[float]) -> Array:
    """(k, 3) the markers of a wand in its own frame, x along it, m. InputError for fewer than two, or equal ones."""
    marks = _marks(marks_m)
    return np.column_stack([marks, np.zeros((len(marks), 2))])


def wand_turns(marks_m: Sequence[float]) -> int:
    """2 when a wand looks the same from both ends (two markers, or evenly spaced ones), else 1."""
    return 2 if _symmetric(_marks(marks_m)) else 1


def find_wand(
    image: np.ndarray,
    marks_m: Sequence[float],
    camera: CameraModel,
    *,
    moment: int = 0,
    target: str = WAND,
    background: np.ndarray | None = None,
) -> Sighting | None:
    """The wand in an image (H, W[, 3]) uint8, or None when its markers are not all seen.

    The image should be dark but for the wand (short exposure), or ``background`` be given: the same view without it.
    """
    marks = _marks(marks_m)
    blobs = find_blobs(image, background)
    ideal = undistorted(blobs.centroid, camera)
    reached = np.flatnonzero(np.isfinite(ideal).all(axis=1))
    rows = label_markers(ideal[reached], marks)
    if rows is None:
        return None
    pixels = blobs.centroid[reached][rows]
    size = (image.shape[1], image.shape[0])
    return Sighting(camera.name, moment, np.arange(len(marks)), pixels, size, target, CENTROID_SIGMA_PX)


def _marks(marks_m: Sequence[float]) -> Array:
    marks = np.asarray(marks_m, float).ravel()
    remedy = "Give the markers' places along the wand in metres, as 0,0.25,0.4."
    if not 2 <= len(marks) <= 6 or not np.isfinite(marks).all():
        raise InputError(f"a wand of {len(marks)} markers cannot be used", where="wand marks", remedy=remedy)
    if np.any(np.diff(marks) < LEAST_MARK_DISTANCE * np.ptp(marks)) or np.ptp(marks) <= 0:
        raise InputError(
            f"the markers at {', '.join(f'{m:g}' for m in marks)} m do not rise, or nearly coincide",
            where="wand marks",
            remedy=remedy,
        )
    return marks


def _symmetric(marks: Array) -> bool:
    spacing = np.diff(marks) / np.ptp(marks)
    mirrored = spacing[::-1]
    if np.allclose(spacing, mirrored, atol=1e-3):
        return True
    if np.abs(spacing - mirrored).max() < TELLING:
        raise InputError(
            f"the markers at {', '.join(f'{m:g}' for m in marks)} m are spaced almost, but not quite, "
            "alike from both ends",
            where="wand marks",
            remedy="Space them evenly, or clearly unevenly (0, 0.25, 0.4).",
        )
    return False
