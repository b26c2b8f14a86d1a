"""Measures by how much a camera has turned since a reference picture was taken, from another picture of the scene.

All edges of the scene that are in view move together when the camera turns, as its rotation and its lens say. The three
angles are found by Gauss-Newton steps on the pictures themselves (Lucas and Kanade 1981, in the inverse compositional
form of Baker and Matthews, IJCV 2004), with robust weights against what does not move with the rest: people, shadows,
a chair that was moved. A camera that was pushed aside is found, too: what is nearer moves more, but all moves.

cv2.findTransformECC on the same pictures has no robust weights: with people in view it errs by 0.2 to 1.5 px where the
camera has not moved (here 0.01 to 0.04 px), on recorded and rendered sessions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import lens
from capture_rig.camera import CameraModel
from capture_rig.rigid import rotation_matrix, rotation_vector
from capture_rig.small_matrices import robust_weight
from capture_rig.visibility import of_shape

from .background.kernels import BEYOND_NOISE, WITHIN_NOISE

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.float32]

MOST_STEPS, LAST_STEPS, CONVERGED_RAD = 8, 3, 2e-5
# Thresholds: in standard deviations of the pixels' noise, measured by python bench/camera_faults.py --moved.
SCALE_QUANTILE, SCALE_QUANTILE_SIGMAS = 0.3, 0.385  # the typical residual's: more than half may be hidden
LINEAR_PX = 0.5  # edges are a pixel or two wide: a fit to their slopes is right within this, and a place agrees
FEW_POINTS, FEW_CELLS = 60, 12
WELL_KNOWN = 0.5  # share of agreeing edges above which no search is needed
SINGULAR = np.sqrt(np.finfo(float).eps)  # half of the digits are left
BY_CHANCE = 0.5  # a place that agrees as often as this with turns that are wrong is not used
WRONG_TURNS_RAD = np.radians([(a, b, c) for a in (-5, 0, 4) for b in (-4, 0, 5) for c in (-2, 1) if a or b])


@dataclass(frozen=True, eq=False)
class Alignment:
    """How the camera has turned since the reference.

    turn_rad (3,) : rotation vector of the camera in its own frame (x right, y down, z forward), radians: what was
    in direction d is now in direction exp(turn) d. agreeing : share of the reference's edges, as far as they are in
    view, that are where this turn puts them, beyond what chance does: 0 when the picture has nothing to do with the
    reference, 1 when nothing is hidden. agreeing_unmoved : the same without any turn.
    """

    turn_rad: Array
    agreeing: float
    agreeing_unmoved: float


class PictureAlignment:
    """Compares pictures with one reference. Not for two threads at a time."""

    def __init__(self, camera: CameraModel, mean: npt.NDArray[np.float32], sigma: float) -> None:
        """``mean`` (H, W[, 3]) : the reference, grey levels, may have half of the camera's size, as all pictures then.
        ``sigma`` : noise of a frame's pixel, grey levels."""
        camera = of_shape(camera, mean.shape)
        self._K, self._D, self._reach = camera.K, camera.D, lens.reach_radius(camera.D)
        self._levels, self._views = choose_edge_points(camera, mean, sigma), contrast_pyramid(mean)
        self._chance = self._agree_by_chance(self._views[0])

    @property
    def has_enough_edges(self) -> bool:
        """Whether the reference has enough edges, in enough parts of the picture, to measure a turn."""
        finest = self._levels[0]
        return len(finest.value) >= FEW_POINTS and len(np.unique(finest.cell)) >= FEW_CELLS

    def displacement_of(self, turn_rad: Array) -> tuple[float, float, float]:
        """Return how far a small turn moves the picture's middle right and down (pixels), and its roll (radians)."""
        f = self._K[0, 0]
        return float(f * turn_rad[1]), float(-f * turn_rad[0]), float(turn_rad[2])

    def turn_of(self, right_px: float, down_px: float, roll_rad: float) -> Array:
        """Return the inverse of :meth:`displacement_of`."""
        return np.array([-down_px / self._K[0, 0], right_px / self._K[0, 0], roll_rad])

    def align(self, image: npt.NDArray, start_rad: Array | None = None, search: bool = True) -> Alignment | None:
        """The turn that fits ``image`` (H, W[, 3]) best; None when too little of the reference's edges is in view.

        It is looked for near ``start_rad``: within a few pixels, or with ``search``, where the nearest fits badly,
        everywhere within ten degrees.
        """
        if not self.has_enough_edges:
            return None
        views = contrast_pyramid(image)
        levels = self._levels[:1] if search else self._levels
        best = self._refine(views, levels, np.zeros(3) if start_rad is None else start_rad)
        if search and (best is None or best.agreeing < WELL_KNOWN):
            for guess_rad in coarse_guesses(self._views[-1], views[-1], self._K[0, 0] / self._levels[-1].scale):
                other = self._refine(views, self._levels, guess_rad)
                if other is not None and (best is None or other.agreeing > best.agreeing):
                    best = other
        return best

    def _agree_by_chance(self, view: Picture) -> float:
        """Keep the points that seldom agree with wrong turns; returns how often they do."""
        points = self._levels[0]
        if not len(points.value):
            return 1.0
        found = [self._residual(view, points, rotation_matrix(turn)) for turn in WRONG_TURNS_RAD]
        agree = np.sum([_agree(residual, points) & seen for residual, seen in found], axis=0)
        share = agree / np.maximum(np.sum([seen for _, seen in found], axis=0), 1)
        self._levels[0] = points.subset(share < BY_CHANCE)
        return float(np.mean(share[share < BY_CHANCE])) if (share < BY_CHANCE).any() else 1.0

    def _refine(self, views: Sequence[Picture], levels: Sequence[EdgePoints], start_rad: Array) -> Alignment | None:
        """Gauss-Newton from the coarsest of the ``levels`` to the finest, at last with the places alone that agree."""
        stages = [(points, view, MOST_STEPS) for points, view in zip(levels, views, strict=False)]
        R = rotation_matrix(start_rad)
        for points, view, steps in [*reversed(stages), (levels[0], views[0], LAST_STEPS)]:
            weights = _weights if steps == MOST_STEPS else _agree
            for _ in range(steps):
                residual, seen = self._residual(view, points, R)
                if np.count_nonzero(seen) < FEW_POINTS / 4:
                    return None
                weighted = points.slope * np.where(seen, weights(residual, points), 0.0)[:, None]
                step_rad = np.linalg.lstsq(weighted.T @ points.slope, residual @ weighted, SINGULAR)[0]
                R = R @ rotation_matrix(-step_rad)
                if np.abs(step_rad).max() < CONVERGED_RAD * points.scale:
                    break
        return self._measure(views[0], R)

    def _residual(self, view: Picture, points: EdgePoints, R: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """(n,) how much more contrast the view has where the turn R puts each place, and which places are in view."""
        rays = points.rays @ R.T
        ideal = rays[:, :2] / np.maximum(rays[:, 2:], 1e-3)
        at = lens.distort(ideal, self._D) * self._K.diagonal()[:2] + self._K[:2, 2]
        at = ((at - points.offset) / points.scale).clip(-9, 32766).astype(np.float32)
        within = np.hypot(*ideal.T) < self._reach  # a lens that folds would put what lies beyond back into the picture
        seen = within & ((at >= 0) & (at <= np.array(view.shape[::-1]) - 1)).all(axis=1)
        value = cv2.remap(view, at[:, :1], at[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return value.reshape(-1) - points.value, seen

    def _measure(self, view: Picture, R: Array) -> Alignment | None:
        points = self._levels[0]
        residual, seen = self._residual(view, points, R)
        if np.count_nonzero(seen) < FEW_POINTS:
            return None
        unmoved, seen_unmoved = self._residual(view, points, np.eye(3))
        return Alignment(
            turn_rad=rotation_vector(R),
            agreeing=self._beyond_chance(_agree(residual, points) & seen, seen),
            agreeing_unmoved=self._beyond_chance(_agree(unmoved, points) & seen_unmoved, seen_unmoved),
        )

    def _beyond_chance(self, agree: npt.NDArray[np.bool_], seen: npt.NDArray[np.bool_]) -> float:
        share = agree.sum() / max(int(seen.sum()), 1)
        return max(0.0, float((share - self._chance) / (1 - self._chance)))


def _agree(residual: Array, points: EdgePoints) -> npt.NDArray[np.bool_]:
    return np.abs(residual) < np.maximum(WITHIN_NOISE * points.noise, LINEAR_PX * points.steepness)


def _weights(residual: Array, points: EdgePoints) -> Array:
    """Geman and McClure: quadratic within a few standard deviations, no influence of what lies far beyond."""
    typical = max(float(np.quantile(np.abs(residual), SCALE_QUANTILE)) / SCALE_QUANTILE_SIGMAS, points.noise)
    x = residual / (WITHIN_NOISE * typical)
    return np.asarray(robust_weight.py_func(1.0, x * x))


# --- search: every shift and roll on a coarse grid

SHIFTS = 10  # pixels of the coarsest level, to each side: one is about a degree
ROLLS_DEG = (0.0, -2.5, 2.5, -5.0, 5.0)
GUESSES = 3
MOST_CONTRAST = 0.3  # what stands before the room must not outweigh it


def coarse_guesses(reference: Picture, view: Picture, focal_px: float) -> list[Array]:
    """Return the rotation vectors (3,), radians, in the camera's frame, of the shifts that fit best, one a roll.

    reference, view (h, w) : contrast on the coarsest level. focal_px : of its pixels.
    """
    reference, view = (np.clip(each, -MOST_CONTRAST, MOST_CONTRAST) for each in (reference, view))
    middle, size, found = ((view.shape[1] - 1) / 2, (view.shape[0] - 1) / 2), view.shape[::-1], []
    for deg in ROLLS_DEG:
        turned = cv2.warpAffine(reference, cv2.getRotationMatrix2D(middle, -deg, 1.0), size)
        fits = cv2.matchTemplate(view, turned[SHIFTS:-SHIFTS, SHIFTS:-SHIFTS], cv2.TM_CCOEFF_NORMED)
        _, fit, _, (right, down) = cv2.minMaxLoc(fits)
        turn_rad = np.array([(SHIFTS - down) / focal_px, (right - SHIFTS) / focal_px, np.radians(deg)])
        found.append((fit, turn_rad))
    return [turn_rad for _, turn_rad in sorted(found, key=lambda each: -each[0])[:GUESSES]]


# --- the places that are compared: the steepest of a pyramid of local contrast, spread over the picture

WORK_AREA_PX = 320 * 240  # pictures are compared at about this size: a tenth of its pixel is 0.02 degrees
LEVELS = 3  # each half as large as the one before
CELLS_ACROSS = 16  # the strongest places of every cell are taken, so that they are spread over the picture
POINTS_IN_CELL = 6
SURROUNDINGS = 1 / 6  # of the picture's longer side: brightness is taken relative to the mean of so much around
DARK_LEVEL = 8.0  # grey levels; keeps noise in black places small
# Thresholds: SMOOTHED from the filter (1 2 1)/4; else, in standard deviations of the pixels' noise, measured by
# python bench/camera_faults.py --moved.
SMOOTHED = (1 + 4 + 1) / 16  # what a smoothing by (1 2 1) / 4, across and down, leaves of the noise
LEAST_NOISE = 0.4  # grey levels at working size: codecs smooth noise away, and what they leave is no signal
FLAT = 0.012  # an edge that rises by less than this share of the brightness a pixel is none
TINY_TURN_RAD = np.cbrt(np.finfo(float).eps)  # of a difference quotient


@dataclass(frozen=True, eq=False)
class EdgePoints:
    """The n places that are compared at one level of the pyramid.

    rays (n, 3) : directions in the camera's frame, of length 1. value (n,) : the reference's contrast there.
    steepness (n,) : how much that changes in a pixel of this level at most. slope (n, 3) : how much it changes for a
    turn of the camera, 1 / rad. cell (n,) : which part of the picture. noise : standard deviation of a frame's
    contrast. scale, offset : u_image = scale u_level + offset.
    """

    rays: Array
    value: Array
    steepness: Array
    slope: Array
    cell: npt.NDArray[np.int64]
    noise: float
    scale: float

    @property
    def offset(self) -> float:
        return (self.scale - 1) / 2

    def subset(self, chosen: npt.NDArray[np.bool_] | npt.NDArray[np.int64]) -> EdgePoints:
        """Some of the places: a mask, or their numbers."""
        parts = {name: getattr(self, name)[chosen] for name in ("rays", "value", "steepness", "slope", "cell")}
        return replace(self, **parts)


def contrast_pyramid(image: npt.NDArray, levels: int = LEVELS) -> list[Picture]:
    """Local contrast of an image (H, W[, 3]) at the working size and at each half of it, the finest first.

    Contrast is the difference to the mean of the surroundings as a share of it: lamps, flicker and wide shadows, which
    dim a place and its surroundings alike, leave it as it is.
    """
    factor = work_factor(image.shape)
    height, width = (n // (factor << levels) * (factor << levels) or n // factor * factor for n in image.shape[:2])
    green = image if image.ndim == 2 else cv2.extractChannel(image, 1)
    size = width // factor, height // factor
    grey = cv2.resize(green[:height, :width], size, interpolation=cv2.INTER_AREA).astype(np.float32)
    found = [_contrast(grey)]
    for level in range(1, levels):
        half = cv2.resize(grey, (size[0] >> level, size[1] >> level), interpolation=cv2.INTER_AREA)
        found.append(_contrast(half.astype(np.float32)))
    return found


def work_factor(shape: tuple[int, ...]) -> int:
    """Return how many pixels of the image, across and down, make one of the working size."""
    return max(1, round(math.sqrt(shape[0] * shape[1] / WORK_AREA_PX)))


def _contrast(grey: Picture) -> Picture:
    side = 2 * round(SURROUNDINGS * max(grey.shape) / 2) + 1
    around = cv2.blur(grey, (side, side), borderType=cv2.BORDER_REFLECT) + DARK_LEVEL
    smooth = cv2.GaussianBlur(grey, (3, 3), 0)
    return np.asarray((smooth - around + DARK_LEVEL) / around, np.float32)


def choose_edge_points(camera: CameraModel, mean: npt.NDArray[np.float32], sigma: float) -> list[EdgePoints]:
    """Return the places to compare at each level, finest first; few or none where the picture has no edges.

    ``mean`` (H, W[, 3]) : the reference picture, grey levels. ``sigma`` : noise of a pixel of a frame, grey levels.
    """
    camera = replace(camera, T_camera_world=np.eye(4))  # its world is its own frame
    factor, found = work_factor(mean.shape), []
    brightness = float(np.median(mean if mean.ndim == 2 else mean[..., 1])) + DARK_LEVEL
    for level, picture in enumerate(contrast_pyramid(mean)):
        scale = float(factor << level)
        noise = max(SMOOTHED * sigma / scale, LEAST_NOISE / (1 << level)) / brightness
        gradient = np.stack([cv2.Scharr(picture, cv2.CV_32F, *d) / 32 for d in ((1, 0), (0, 1))], axis=-1)
        steepness = np.hypot(gradient[..., 0], gradient[..., 1])
        row, column, cell = strongest(steepness, max(BEYOND_NOISE * noise, FLAT), CELLS_ACROSS, POINTS_IN_CELL)
        pixels = scale * np.column_stack([column, row]) + (scale - 1) / 2
        rays, turns = camera.rays_world(pixels), TINY_TURN_RAD * np.eye(3)
        moved = [camera.project(rays + np.cross(turn, rays)) - pixels for turn in turns]
        slope = np.einsum("nk,jnk->nj", gradient[row, column], np.stack(moved) / TINY_TURN_RAD / scale)
        value, steepness = (each[row, column].astype(float) for each in (picture, steepness))
        points = EdgePoints(rays, value, steepness, slope, cell, noise, scale)
        found.append(points.subset(np.isfinite(slope).all(axis=1)))
    return found


def strongest(
    steepness: Picture, least: float, cells_across: int, in_cell: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return row, column and cell (n,) of the ``in_cell`` steepest places of every cell.

    Those that are not steeper than ``least``, next to a steeper one, or at the border are left out.
    """
    width = steepness.shape[1]
    side = max(width // cells_across, 4)
    peak = (steepness >= cv2.dilate(steepness, np.ones((3, 3), np.uint8))) & (steepness > least)
    peak[[0, 1, 2, -3, -2, -1]] = False
    peak[:, [0, 1, 2, -3, -2, -1]] = False
    row, column = np.nonzero(peak)
    cell = row // side * (-(-width // side)) + column // side
    order = np.lexsort((-steepness[row, column], cell))
    row, column, cell = row[order], column[order], cell[order]
    taken = np.arange(len(cell)) - np.searchsorted(cell, cell) < in_cell
    return row[taken], column[taken], cell[taken]
