"""Robust alignment of a camera's pictures with a reference picture: the motion of the camera between them.

All edges of the scene move together when the camera does. Its motion is found by Gauss-Newton steps on the reference's
steepest places (Lucas and Kanade 1981, in the inverse compositional form of Baker and Matthews, IJCV 2004), with robust
weights against what does not move with the rest: people, shadows, a chair that was moved. :func:`robust_step` and the
choice of the places serve two models of motion: :class:`PictureAlignment` measures the three angles of a camera that
was turned, through its lens, in pictures of which nothing is known but the reference; :mod:`.background.shift` follows
shift and roll by a fraction of a pixel, against the background in the light of now.

cv2.findTransformECC on the same pictures has no robust weights: with people in view it errs by 0.2 to 1.5 px where the
camera has not moved (here 0.01 to 0.04 px), on recorded and rendered sessions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.kernel import njit
from capture_rig.rigid import rotation_matrix, rotation_vector
from capture_rig.small_matrices import solve_positive
from capture_rig.visibility import of_shape

from .background.kernels import BEYOND_NOISE, BIN_SIGMAS, HALF_MEDIAN, OPTIONS, WITHIN_NOISE, median_of

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.float32]
Indices = npt.NDArray[np.intp]

FEW_PLACES = 60
FEWEST = 3  # measurements whose median counts: what springs back, or one bad picture, is no movement
STEPS = 4  # of a robust fit, each with the weights of the one before


# --- of both models of motion: the places, and a step of the fit


def gradients(picture: Picture) -> tuple[Picture, Picture]:
    """Return the slopes of a picture (H, W[, C]) to the right and downwards, of its shape, levels a pixel."""
    right, down = (cv2.Scharr(picture, cv2.CV_32F, *d, scale=1 / 32) for d in ((1, 0), (0, 1)))
    return np.asarray(right, np.float32).reshape(picture.shape), np.asarray(down, np.float32).reshape(picture.shape)


def steepest(steepness: Picture, least: float, cells_across: int, in_cell: int) -> tuple[Indices, Indices]:
    """Return row and column (n,) of the ``in_cell`` steepest places of every cell.

    Those that are not steeper than ``least``, next to a steeper one, or at the border are left out.
    """
    side = max(steepness.shape[1] // cells_across, 4)
    peak = (steepness >= cv2.dilate(steepness, np.ones((3, 3), np.uint8))) & (steepness > least)
    peak[[0, 1, 2, -3, -2, -1]] = False
    peak[:, [0, 1, 2, -3, -2, -1]] = False
    row, column = np.nonzero(peak)
    cell = row // side * steepness.shape[1] + column // side
    order = np.lexsort((-steepness[row, column], cell))
    row, column, cell = row[order], column[order], cell[order]
    taken = np.arange(len(cell)) - np.searchsorted(cell, cell) < in_cell
    return row[taken], column[taken]


@njit(**OPTIONS)
def robust_step(rest, slopes, variance, trust, prior):  # type: ignore[no-untyped-def]
    """Fit rest = -slopes x by iteratively reweighted least squares: by how much the picture moved.

    rest, variance (n, C) float32: picture minus reference, and the variance of that by noise. slopes (n, C, 3) float32:
    by how much the reference changes for each parameter x (3,) of the motion. trust (n,) float32: weights. prior (3,) :
    information that x is zero. Weights are those of Geman and McClure: quadratic within WITHIN_NOISE robust standard
    deviations, without influence far beyond. Returns x; zero where it cannot be known.
    """
    n, channels = rest.shape
    x, factor, distance = np.zeros(3), np.zeros((3, 3)), np.empty(n, np.float32)
    for _ in range(STEPS):
        for i in range(n):
            total = 0.0
            for c in range(channels):
                left = rest[i, c] + slopes[i, c, 0] * x[0] + slopes[i, c, 1] * x[1] + slopes[i, c, 2] * x[2]
                total += left * left / variance[i, c]
            distance[i] = np.sqrt(total / channels)
        scale = max(HALF_MEDIAN * median_of(distance, trust, BIN_SIGMAS), 1.0)
        A, b = np.diag(prior), np.zeros(3)
        for i in range(n):
            share = distance[i] / (WITHIN_NOISE * scale)
            bounded = 1.0 / (1.0 + share * share)
            for c in range(channels):
                w = trust[i] * bounded * bounded / variance[i, c]
                for j in range(3):
                    b[j] -= w * slopes[i, c, j] * rest[i, c]
                    for k in range(j + 1):
                        A[j, k] += w * slopes[i, c, j] * slopes[i, c, k]
        if not solve_positive(A, b, factor, x):
            return np.zeros(3)
    return x


# --- a camera that was turned

MOST_STEPS, CONVERGED_RAD = 8, 2e-5
GUESSES = 3
LINEAR_PX = 0.5  # edges are a pixel or two wide: a fit to their slopes is right within this, and a place agrees
WELL_KNOWN = 0.5  # when so many agree there is no need to search
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

    def __init__(self, camera: CameraModel, mean: Picture, sigma: float) -> None:
        """``mean`` (H, W[, 3]) : the reference, grey levels, may have half of the camera's size, as all pictures then.
        ``sigma`` : noise of a frame's pixel, grey levels."""
        self._camera = replace(of_shape(camera, mean.shape), T_camera_world=np.eye(4))  # its world is its own frame
        self._focal_px = float(self._camera.K[0, 0])
        self._views = contrast_pyramid(mean)
        factor, brightness = work_factor(mean.shape), float(np.median(mean if mean.ndim == 2 else mean[..., 1]))
        noise = max(SMOOTHED * sigma / factor, LEAST_NOISE) / (brightness + DARK_LEVEL)
        self._levels = [
            edge_points(self._camera, view, factor << level, noise / (1 << level))
            for level, view in enumerate(self._views)
        ]
        self._chance = 0.0
        self._chance = float(np.mean([self._agreeing(self._views[0], rotation_matrix(R)) for R in WRONG_TURNS_RAD]))

    @property
    def has_enough_edges(self) -> bool:
        """Whether the reference has enough edges to measure a turn."""
        return len(self._levels[0].value) >= FEW_PLACES

    def align(self, image: npt.NDArray, start_rad: Array | None = None, search: bool = True) -> Alignment | None:
        """The turn that fits ``image`` (H, W[, 3]) best; None when too little of the reference's edges is in view.

        It is looked for near ``start_rad``: within a few pixels, or with ``search``, where the nearest fits badly,
        everywhere within ten degrees.
        """
        if not self.has_enough_edges:
            return None
        views = contrast_pyramid(image)
        start_rad = np.zeros(3) if start_rad is None else start_rad
        best = self._refine(views[:1] if search else views, start_rad)
        if search and (best is None or best.agreeing < WELL_KNOWN):
            guesses = coarse_guesses(self._views[-1], views[-1], self._focal_px / self._levels[-1].scale)
            found = [best, *(self._refine(views, guess_rad) for guess_rad in guesses[:GUESSES])]
            best = max(filter(None, found), key=lambda each: each.agreeing, default=None)
        return best

    def shift(self, image: npt.NDArray, start: tuple[float, float, float]) -> tuple[float, float, float] | None:
        """Return how far the picture's middle has moved right and down (pixels), and its roll (radians), near a
        ``start``; None when too little of the reference's edges is in view."""
        right_px, down_px, roll_rad = start
        found = self.align(image, np.array([-down_px / self._focal_px, right_px / self._focal_px, roll_rad]), False)
        if found is None:
            return None
        tilt_rad, pan_rad, roll_rad = found.turn_rad.tolist()
        return self._focal_px * pan_rad, -self._focal_px * tilt_rad, roll_rad

    def _refine(self, views: list[Picture], start_rad: Array) -> Alignment | None:
        """Gauss-Newton on some levels of the pyramid, from the coarsest to the finest."""
        R, levels = rotation_matrix(start_rad), list(zip(self._levels, views, strict=False))
        for points, view, within in [*((*each, np.inf) for each in levels[::-1]), (*levels[0], 1.0)]:
            for _ in range(MOST_STEPS):
                rest, seen = self._residual(view, points, R)
                if seen.sum() * points.scale < FEW_PLACES * self._levels[0].scale:
                    return None
                trust = np.where(np.abs(rest) < within * points.agrees, seen, 0.0).astype(np.float32)
                step_rad = robust_step(rest[:, None], points.slopes, points.variance, trust, np.zeros(3))
                R = R @ rotation_matrix(step_rad)
                if np.abs(step_rad).max() < CONVERGED_RAD * points.scale:
                    break
        return Alignment(rotation_vector(R), self._agreeing(views[0], R), self._agreeing(views[0], np.eye(3)))

    def _residual(self, view: Picture, points: EdgePoints, R: Array) -> tuple[Picture, Picture]:
        """(n,) how much more contrast the view has where the turn R puts each place, and 1 where a place is in view."""
        at = (self._camera.project(points.rays @ R.T) - (points.scale - 1) / 2) / points.scale
        seen = np.all((at >= 0) & (at <= np.array(view.shape[::-1]) - 1), axis=1)
        at = np.where(seen[:, None], at, 0.0).astype(np.float32)
        value = np.asarray(cv2.remap(view, at[:, :1], at[:, 1:], cv2.INTER_LINEAR), np.float32)
        return value.reshape(-1) - points.value, np.asarray(seen, np.float32)

    def _agreeing(self, view: Picture, R: Array) -> float:
        """Return the share of the places in view that agree with a turn, beyond chance."""
        points = self._levels[0]
        if not self.has_enough_edges:
            return 0.0
        rest, seen = self._residual(view, points, R)
        share = float(((np.abs(rest) < points.agrees) * seen).sum() / max(seen.sum(), 1))
        return max(0.0, (share - self._chance) / (1 - self._chance))


# --- what is compared: a pyramid of local contrast

WORK_AREA_PX = 320 * 240  # pictures are compared at about this size: a tenth of its pixel is 0.02 degrees
LEVELS = 3  # each half as large as the one before
CELLS_ACROSS, IN_CELL = 16, 6  # places: so many in every cell of the picture, so that they are spread over it
SURROUNDINGS = 1 / 6  # of the picture's longer side: brightness is taken relative to the mean of so much around
DARK_LEVEL = 8.0  # grey levels; keeps noise in black places small
SMOOTHED = (1 + 4 + 1) / 16  # what a smoothing by (1 2 1) / 4, across and down, leaves of the noise
LEAST_NOISE = 0.4  # grey levels at working size: codecs smooth noise away, and what they leave is no signal
TINY_TURN_RAD = np.cbrt(np.finfo(float).eps)  # of a difference quotient


@dataclass(frozen=True, eq=False)
class EdgePoints:
    """The n places that are compared at one level of the pyramid.

    rays (n, 3) : directions in the camera's frame, of length 1. value (n,) : the reference's contrast there. slopes
    (n, 1, 3) : how much it changes for a turn of the camera, 1 / rad. variance (n, 1) : of a frame's contrast. agrees
    (n,) : by how much contrast a place that agrees may differ. scale : u_image = scale u_level + (scale - 1) / 2.
    """

    rays: Array
    value: Picture
    slopes: Picture
    variance: Picture
    agrees: Picture
    scale: int


def contrast_pyramid(image: npt.NDArray) -> list[Picture]:
    """Local contrast of an image (H, W[, 3]) at the working size and at each half of it, the finest first.

    Contrast is the difference to the mean of the surroundings as a share of it: lamps, flicker and wide shadows, which
    dim a place and its surroundings alike, leave it as it is.
    """
    factor, found = work_factor(image.shape), []
    height, width = (n // (factor << LEVELS) << LEVELS or n // factor for n in image.shape[:2])
    green = image if image.ndim == 2 else cv2.extractChannel(image, 1)
    grey = green[: height * factor, : width * factor]
    for level in range(LEVELS):
        grey = cv2.resize(grey, (width >> level, height >> level), interpolation=cv2.INTER_AREA).astype(np.float32)
        side = 2 * round(SURROUNDINGS * max(grey.shape) / 2) + 1
        around = cv2.blur(grey, (side, side), borderType=cv2.BORDER_REFLECT) + DARK_LEVEL
        found.append((cv2.GaussianBlur(grey, (3, 3), 0) + DARK_LEVEL - around) / around)
    return found


def work_factor(shape: tuple[int, ...]) -> int:
    """Return how many pixels of the image, across and down, make one of the working size."""
    return max(1, round(math.sqrt(shape[0] * shape[1] / WORK_AREA_PX)))


def edge_points(camera: CameraModel, view: Picture, scale: int, noise: float) -> EdgePoints:
    """Return the places to compare in a ``view`` of the reference's contrast, of whose pixels one is ``scale`` wide;
    few or none where it has no edges. ``noise`` : standard deviation of a frame's contrast."""
    right, down = gradients(view)
    steepness = np.hypot(right, down)
    at = steepest(steepness, BEYOND_NOISE * noise, CELLS_ACROSS, IN_CELL)
    pixels = scale * np.column_stack(at[::-1]) + (scale - 1) / 2
    rays = camera.rays_world(pixels)
    moved = [camera.project(rays + np.cross(turn, rays)) - pixels for turn in TINY_TURN_RAD * np.eye(3)]
    gradient = np.stack([right[at], down[at]], axis=-1)
    slopes = np.einsum("nk,jnk->nj", gradient, np.stack(moved) / TINY_TURN_RAD / scale)
    known = np.isfinite(slopes).all(axis=1)
    agrees = np.maximum(WITHIN_NOISE * noise, LINEAR_PX * steepness[at])
    variance = np.full((len(agrees), 1), noise**2)
    value, slopes, variance, agrees = (
        each[known].astype(np.float32) for each in (view[at], slopes[:, None], variance, agrees)
    )
    return EdgePoints(rays[known], value, slopes, variance, agrees, scale)


# --- search: every shift and roll on a coarse grid

SHIFTS = 10  # pixels of the coarsest level, to each side: one is about a degree
ROLLS_DEG = (0.0, -2.5, 2.5, -5.0, 5.0)
MOST_CONTRAST = 0.3  # what stands before the room must not outweigh it


def coarse_guesses(reference: Picture, view: Picture, focal_px: float) -> list[Array]:
    """Return the rotation vectors (3,), radians, in the camera's frame, of the shift that fits best for every roll, the
    best first.

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
    return [turn_rad for _, turn_rad in sorted(found, key=lambda each: -each[0])]
