"""Finds checkerboard patterns of any size: corners as saddle points of the image, linked to their neighbours.

A checkerboard's corner is a saddle of the grey levels; the two directions along which the saddle is flat are the edges
(compare Geiger et al. 2012, Duda & Frese 2018). Two saddles are neighbours when each is the nearest one along an edge
of the other and their bright and dark quadrants are swapped. Connected neighbours make a lattice.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from capture_rig.lens import Array

MAX_SADDLES = 3000
HALF = 0.5
"""Tolerance, half way to the nearest wrong answer: of a field, of the variance of a window, of the step between
neighbouring quadrants, of the sine between an edge and the way to a neighbour."""
# Thresholds: measured by python bench/calibration.py --boards (found at which tilt and size).
MIN_STRENGTH = 0.02  # of the response of the image's 20th strongest saddle
NEIGHBOURS = 24
MIN_CORNERS = 6
RING = 2.0  # radius of the ring, over the smoothing


@dataclass(frozen=True, eq=False)
class Saddles:
    """n saddle points: ``pixels`` (n, 2); unit directions ``first``, ``second`` (n, 2) of the two edges, so that the
    quadrant between them counterclockwise from first to second is bright."""

    pixels: Array
    first: Array
    second: Array


def find_lattices(image: npt.NDArray[np.uint8], smoothing_px: tuple[float, float]) -> list[Array]:
    """Find all lattices of at least ``MIN_CORNERS`` corners in a grey image (H, W), the one that covers most of it
    first (a photograph may show a screen that shows the board): (rows, columns, 2) pixels, NaN where no corner was
    found; row to row and column to column form a right-handed pair (x right, y down).

    ``smoothing_px``: Gaussian to smooth with, in x and y."""
    saddles = find_saddles(image, smoothing_px)
    if len(saddles.pixels) < MIN_CORNERS:
        return []
    links = _in_quads(_mutual_links(saddles), saddles.pixels)
    found = [_lattice(saddles, cells) for cells in _walk(links) if len(cells) >= MIN_CORNERS]
    hulls = [cv2.convexHull(lattice[np.isfinite(lattice[:, :, 0])].astype(np.float32)) for lattice in found]
    return [found[k] for k in np.argsort([-cv2.contourArea(hull) for hull in hulls], kind="stable")]


def find_saddles(image: npt.NDArray[np.uint8], smoothing_px: tuple[float, float]) -> Saddles:
    """Find the image's saddle points, strongest first."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), smoothing_px[0], sigmaY=smoothing_px[1])
    xx = cv2.Sobel(smooth, cv2.CV_32F, 2, 0, ksize=3, scale=0.25)
    yy = cv2.Sobel(smooth, cv2.CV_32F, 0, 2, ksize=3, scale=0.25)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3, scale=0.25)
    strength = xy * xy - xx * yy
    top = cv2.dilate(strength, np.ones((3, 3), np.uint8))
    peak = (strength >= top) & (strength > 0)
    peak[:2], peak[-2:], peak[:, :2], peak[:, -2:] = False, False, False, False
    row, column = np.nonzero(peak)
    values = strength[row, column]
    if len(values) == 0:
        return Saddles(*np.zeros((3, 0, 2)))
    order = np.argsort(-values, kind="stable")[:MAX_SADDLES]
    order = order[values[order] > MIN_STRENGTH * values[order[min(len(order) - 1, 20)]]]
    row, column = row[order], column[order]
    hessian = [each[row, column].astype(float) for each in (xx, xy, yy)]
    pixels = _saddle_point(smooth, row, column, *hessian)
    first, second = _flat_directions(*hessian)
    crossing = _is_crossing(smooth, pixels, first, second, RING * max(smoothing_px))
    return Saddles(pixels[crossing], first[crossing], second[crossing])


def _saddle_point(smooth: np.ndarray, row: np.ndarray, column: np.ndarray, xx: Array, xy: Array, yy: Array) -> Array:
    """Return where the gradient vanishes, by one Newton step (at most one pixel)."""
    gx = 0.5 * (smooth[row, column + 1] - smooth[row, column - 1])
    gy = 0.5 * (smooth[row + 1, column] - smooth[row - 1, column])
    determinant = xx * yy - xy * xy
    step = np.stack([-(yy * gx - xy * gy), -(xx * gy - xy * gx)], 1) / determinant[:, None]
    return np.stack([column, row], 1) + step.clip(-1, 1)


def _flat_directions(xx: Array, xy: Array, yy: Array) -> tuple[Array, Array]:
    """Return the two directions d with d^T H d = 0, on both sides of the direction in which the image gets brighter."""
    half, mean = np.hypot(0.5 * (xx - yy), xy), 0.5 * (xx + yy)
    bright = 0.5 * np.arctan2(2 * xy, xx - yy)
    rising, falling = np.maximum(mean + half, 1e-9), np.maximum(half - mean, 1e-9)
    opening = np.arctan(np.sqrt(rising / falling))
    first, second = bright - opening, bright + opening
    return np.stack([np.cos(first), np.sin(first)], 1), np.stack([np.cos(second), np.sin(second)], 1)


def _is_crossing(
    smooth: np.ndarray, pixels: Array, first: Array, second: Array, radius: float
) -> npt.NDArray[np.bool_]:
    """Whether opposite quadrants are alike, and neighbouring ones not, on a ring of this ``radius``."""
    bisectors = [first + second, second - first]
    bisectors = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in bisectors]
    ring = [pixels + radius * side * each for each in bisectors for side in (1, -1)]
    x, y = np.ascontiguousarray(np.moveaxis(np.stack(ring), 2, 0), np.float32)
    bright, bright_too, dark, dark_too = cv2.remap(smooth, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    step = np.minimum(bright, bright_too) - np.maximum(dark, dark_too)
    return step > HALF * np.maximum(np.abs(bright - bright_too), np.abs(dark - dark_too))


def _in_quads(links: npt.NDArray[np.int64], pixels: Array) -> npt.NDArray[np.int64]:
    """Return only the links that are sides of a closed, convex quadrilateral."""
    back = _back_slots(links)
    slots = np.arange(4)[None].repeat(len(links), 0)
    place, slot, path = np.arange(len(links))[:, None].repeat(4, 1), slots, []
    alive = links >= 0
    for _ in range(4):  # round the quadrilateral, always taking the same turn
        path.append((place, slot))
        alive = alive & (links[place, slot] >= 0)
        place, slot = links[place, slot], (back[place, slot] + 1) % 4
    alive &= place == np.arange(len(links))[:, None]
    alive &= _is_convex(pixels, [each for each, _ in path])
    kept = np.zeros(links.shape, bool)
    for here, towards in path:
        kept[here[alive], towards[alive]] = True
    answered = kept[links, back] & (links >= 0)
    return _keep_mutual(np.where(kept | answered, links, -1))


def _back_slots(links: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return (n, 4): the slot in which the neighbour links back; 0 where there is no neighbour."""
    return np.argmax(links[links] == np.arange(len(links))[:, None, None], axis=2)


def _is_convex(pixels: Array, corners: list[npt.NDArray[np.int64]]) -> npt.NDArray[np.bool_]:
    a, b, c, d = (pixels[corner] for corner in corners)
    sides = [b - a, c - b, d - c, a - d]
    turns = np.stack([_cross(sides[k], sides[(k + 1) % 4]) for k in range(4)])
    return np.asarray(np.all(turns > 0, axis=0) | np.all(turns < 0, axis=0))


def _mutual_links(saddles: Saddles) -> npt.NDArray[np.int64]:
    """Return (n, 4): the neighbour along +first, +second, -first, -second; -1 where there is none."""
    count = min(NEIGHBOURS, len(saddles.pixels) - 1)
    _, near = cKDTree(saddles.pixels).query(saddles.pixels, k=count + 1)
    near = near[:, 1:]
    way = saddles.pixels[near] - saddles.pixels[:, None]
    length = np.linalg.norm(way, axis=2)
    way = way / np.maximum(length, 1e-9)[:, :, None]
    best = np.full((len(near), 4), -1)
    for slot, (edge, swapped) in enumerate([(saddles.first, saddles.second), (saddles.second, saddles.first)] * 2):
        sign = 1.0 if slot < 2 else -1.0
        ahead = np.einsum("nkc,nc->nk", way, sign * edge) > 0
        aside = np.abs(_cross(way, edge[:, None])) < HALF
        parallel = np.abs(_cross(swapped[near], way)) < HALF
        cost = np.where(ahead & aside & parallel, length, np.inf)
        choice = np.argmin(cost, axis=1)
        best[:, slot] = np.where(np.isfinite(cost.min(axis=1)), near[np.arange(len(near)), choice], -1)
    return _keep_mutual(best)


def _keep_mutual(best: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    index = np.arange(len(best))[:, None]
    answered = np.any(best[best] == index[:, :, None], axis=2) & (best >= 0)
    return np.where(answered, best, -1)


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _walk(links: npt.NDArray[np.int64]) -> list[dict[int, tuple[int, int]]]:
    """Connected saddles with integer coordinates: saddle -> (column, row)."""
    seen: set[int] = set()
    components = []
    for seed in range(len(links)):
        if seed not in seen and np.count_nonzero(links[seed] >= 0) >= 2:
            cells = _walk_from(seed, links, seen)
            seen.update(cells)
            components.append(cells)
    return components


def _walk_from(seed: int, links: npt.NDArray[np.int64], seen: set[int]) -> dict[int, tuple[int, int]]:
    """Grow the grid breadth first; the first saddle at a place stays.

    ``heading``: the quarter turn by which a saddle's slots are turned against the grid's axes.
    """
    cells, heading, taken = {seed: (0, 0)}, {seed: 0}, {(0, 0)}
    queue = deque([seed])
    while queue:
        here = queue.popleft()
        for slot, there in enumerate(links[here].tolist()):
            if there < 0 or there in cells or there in seen:
                continue
            axis = (slot + heading[here]) % 4
            place = (cells[here][0] + (1, 0, -1, 0)[axis], cells[here][1] + (0, 1, 0, -1)[axis])
            back = np.flatnonzero(links[there] == here)
            if place in taken or len(back) == 0:
                continue
            cells[there], heading[there] = place, (axis + 2 - int(back[0])) % 4
            taken.add(place)
            queue.append(there)
    return cells


def _lattice(saddles: Saddles, cells: dict[int, tuple[int, int]]) -> Array:
    index = np.array(list(cells), dtype=np.int64)
    places = np.array([cells[key] for key in cells], dtype=np.int64).reshape(-1, 2)
    places -= places.min(axis=0)
    columns, rows = places.max(axis=0) + 1
    pixels = np.full((rows, columns, 2), np.nan)
    pixels[places[:, 1], places[:, 0]] = saddles.pixels[index]
    return pixels


# --- The image scaled in one or both directions: the detector finds patterns of a certain size.


OWN_BLUR_PX = 0.6  # of an ordinary image: optics and pixel
COMFORTABLE_PX = 900  # long side at which boards are found fast
MAX_PIXELS = 8_000_000
STRETCHES = ((1, 2), (1, 3), (1, 4), (2, 2), (1, 2, 2.2), (2, 1), (2, 6), (0.5, 0.5))  # across, down, blur


@dataclass(frozen=True)
class Variant:
    """The image ``across`` times as wide and ``down`` times as high, to be smoothed so that its blur, its own included,
    becomes about ``blur_px`` in all directions (a blur that differs with the direction turns the edges that are seen at
    a corner)."""

    across: float = 1.0
    down: float = 1.0
    blur_px: float = 1.35

    @property
    def smoothing_px(self) -> tuple[float, float]:
        """Standard deviation of the Gaussian still needed, in both directions."""
        own = OWN_BLUR_PX * max(self.across, 0.5), OWN_BLUR_PX * max(self.down, 0.5)
        wanted = max(self.blur_px, 1.1 * max(own))
        return math.sqrt(wanted**2 - own[0] ** 2), math.sqrt(wanted**2 - own[1] ** 2)

    def make(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Return the scaled image."""
        if self.across == self.down == 1.0:
            return image
        smaller = self.across < 1 and self.down < 1
        method = cv2.INTER_AREA if smaller else cv2.INTER_CUBIC
        return np.asarray(cv2.resize(image, self._size(image.shape), interpolation=method), np.uint8)

    def to_raw(self, pixels: Array) -> Array:
        """Pixels (..., 2) of the scaled image in the raw one."""
        return (pixels + 0.5) / [self.across, self.down] - 0.5

    def _size(self, shape: tuple[int, ...]) -> tuple[int, int]:
        return max(round(shape[1] * self.across), 1), max(round(shape[0] * self.down), 1)


def variants_for(shape: tuple[int, ...], thorough: bool) -> tuple[Variant, ...]:
    """Choose the variants to search, in order: large images made smaller first; ``thorough`` adds enlarged and
    stretched ones, in which small boards and boards at a grazing angle have ordinary sizes. All of them stay below
    ``MAX_PIXELS``."""
    long_side = max(shape[:2])
    scale = COMFORTABLE_PX / long_side if long_side > 1.2 * COMFORTABLE_PX else 1.0
    variants = [Variant(scale, scale), Variant()] if scale < 1 else [Variant()]
    if thorough:
        variants += [Variant(scale * across, scale * down, *rest) for across, down, *rest in STRETCHES]
        variants += [Variant(1, 2), Variant(1, 3), Variant(2, 2)] if scale < 1 else []
    return tuple(each for each in variants if each.across * each.down * shape[0] * shape[1] <= MAX_PIXELS)
