"""Shadows in mono images: floor that is darker by a locally constant factor and keeps its texture."""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.rig import Volume

from .background_model import BackgroundModel
from .frame_source import Image, Mask
from .regions import Box
from .settings import FloorShadowSettings

GRID_PX = 8  # the floor's outline in the image needs no finer grid
MAX_FLOOR_DISTANCE_M = 20.0
MIN_WINDOW_PX = 5  # 3 x 3 pixels hold too little texture to tell anything apart
BLOCK_OF_HEIGHT = 1 / 120  # sums are formed over square blocks of this share of the image height
TEXTURE_BLOCKS = 7  # a square of so many blocks decides whether texture persists
PATCH_PERSISTENCE = 0.4, 1.5  # the whole patch keeps a share of it between these, ...
MIN_EVIDENCE_SIGMAS = 10.0  # ... and not by chance: a floor so plain that its texture could not be seen proves nothing
MIN_PATCH_WINDOWS = 10  # fewer windows agree by chance
_THREE = np.ones((3, 3), np.uint8)


class FloorShadow:
    """Tells which foreground pixels only show the floor in shadow.

    Around each pixel, in a small window, image x and background mu have means X and M; a = X / M is how much darker it
    is here. A shadow keeps the floor's texture, x - X = a (mu - M) + noise; a body covers it and brings its own. Two
    numbers tell them apart, summed over the neighbourhood where x is darker at all and the pixel's ray meets the floor
    (bodies above the horizon are never touched):

    - what is left, the mean square of (x - X) - a (mu - M), is noise in a shadow, and more on edges and textures;
    - the persistence, the regression of x - X on a (mu - M), is 1 in a shadow and 0 on smooth clothes.

    Both also hold for each connected patch as a whole, or the patch is none: by chance they hold in small ones. The
    rim of a shadow, where windows reach out of it, is thin, and goes with the patch it borders.
    """

    def __init__(
        self, camera: CameraModel, background: BackgroundModel, sigma_floor: float, settings: FloorShadowSettings
    ) -> None:
        """``sigma_floor``: smallest sigma that a pixel is taken to have, grey levels."""
        side = max(2 * round((settings.window * camera.height - 1) / 2) + 1, MIN_WINDOW_PX)
        self._settings, self._window = settings, (side, side)
        self.alignment_px = self._block = max(2 * round(BLOCK_OF_HEIGHT * camera.height / 2), 2)
        self._rim = np.ones((2 * side + 1, 2 * side + 1), np.uint8)
        self._mean = _thinned(background.mean)
        mean_window = cv2.blur(background.mean, self._window)
        self._per_mean_window = _thinned(1 / np.maximum(mean_window, np.float32(1e-3)))
        self._sigma = max(float(np.median(background.sigma)), sigma_floor)
        self._floor = floor_pixels(camera)
        self._min_area_px = max(settings.min_area * camera.height**2, MIN_PATCH_WINDOWS * side**2)

    def shadow(self, image: Image, mask: Mask, box: Box | None = None) -> Mask:
        """255 at pixels of ``mask`` where ``image`` (H, W) fits the shadowed floor, else 0.

        ``mask`` covers ``box`` of the image, or all of it.
        """
        box = box or Box.whole(image.shape)
        found = np.zeros_like(mask)
        inner = Box.around(cv2.bitwise_and(mask, self._floor[box.slices]))
        if not inner.empty:
            inner = inner.grown(self._block, mask.shape, self._block)
            at = inner.outside(box).slices
            found[inner.slices] = self._patches(image[at], mask[inner.slices], at)
        return found

    def _patches(self, image: Image, mask: Mask, at: tuple[slice, slice]) -> Mask:
        looked_at = cv2.bitwise_and(mask, self._floor[at])
        dark, detail, expected = self._details(image, _thinned(looked_at), at)
        blocks = self._large_patches(*self._sums(dark, detail, expected))
        if not blocks.any():
            return np.zeros_like(mask)
        candidates = cv2.bitwise_and(_enlarged(dark, 2, mask.shape), looked_at)
        patches = cv2.bitwise_and(_enlarged(blocks, self._block, mask.shape), candidates)
        patches = cv2.morphologyEx(patches, cv2.MORPH_OPEN, _THREE)
        return cv2.bitwise_or(patches, self._rims(patches, candidates, mask))

    def _details(self, image: Image, mask: Mask, at: tuple[slice, slice]) -> tuple[Mask, np.ndarray, np.ndarray]:
        """Of every second row and column: pixels that may be shadow; x - X and a (mu - M) there, else 0 (float32)."""
        x, X = _thinned(image).astype(np.float32), _thinned(cv2.boxFilter(image, cv2.CV_32F, self._window))
        half = tuple(slice(s.start // 2, s.start // 2 + n) for s, n in zip(at, x.shape, strict=True))
        a = cv2.multiply(X, self._per_mean_window[half])
        dark = cv2.bitwise_and(cv2.inRange(a, self._settings.darkest, self._settings.lightest), mask)
        detail = cv2.copyTo(cv2.subtract(x, X), dark)
        expected = cv2.copyTo(cv2.subtract(cv2.multiply(a, self._mean[half]), X), dark)
        return dark, detail, expected

    def _sums(self, dark: Mask, detail: np.ndarray, expected: np.ndarray) -> tuple[np.ndarray, ...]:
        """Block by block (float32): pixels that may be shadow; what is left, squared; texture shared; texture there."""
        rest = cv2.subtract(detail, expected)
        products = (rest, rest), (detail, expected), (expected, expected)
        count = self._blocks(dark) * np.float32(self._block**2 / 255)
        return count, *(self._blocks(cv2.multiply(*pair)) * np.float32(self._block**2) for pair in products)

    def _blocks(self, values: np.ndarray) -> np.ndarray:
        """Means of blocks (float32) of thinned values; what is missing to whole blocks counts as 0."""
        side = self._block // 2
        down, right = (-n % side for n in values.shape)
        if down or right:
            values = cv2.copyMakeBorder(values, 0, down, 0, right, cv2.BORDER_CONSTANT, value=0)
        size = values.shape[1] // side, values.shape[0] // side
        return cv2.resize(values, size, interpolation=cv2.INTER_AREA).astype(np.float32, copy=False)

    def _large_patches(self, count: np.ndarray, rest: np.ndarray, shared: np.ndarray, power: np.ndarray) -> Mask:
        """255 at the blocks of patches that are large and, as a whole, keep the floor's texture beyond doubt."""
        s = self._settings
        quiet = _near(rest) <= _near(count) * np.float32((s.residual * self._sigma) ** 2)
        fits = quiet & (_around(shared) >= np.float32(s.persistence) * _around(power)) & (2 * count > self._block**2)
        patches, labels = cv2.connectedComponents(fits.astype(np.uint8), connectivity=4)
        sums = (np.bincount(labels.reshape(-1), v.reshape(-1), patches) for v in (count, rest, shared, power))
        area_px, left, kept, there = sums
        least, most = PATCH_PERSISTENCE
        chance = np.sqrt(there * left / np.maximum(area_px, 1))  # standard deviation of `kept` if nothing were shared
        large = (area_px >= self._min_area_px) & (kept >= least * there) & (kept <= most * there)
        large &= kept >= MIN_EVIDENCE_SIGMAS * chance
        large[0] = False  # what does not fit
        return np.where(large, np.uint8(255), np.uint8(0))[labels]

    def _rims(self, patches: Mask, candidates: Mask, mask: Mask) -> Mask:
        """Candidates beside a patch that are too thin to be a part of a body."""
        reach = len(self._rim)
        at = Box.around(patches).grown(reach, mask.shape).slices
        rest = cv2.subtract(mask[at], patches[at])
        thin = cv2.subtract(rest, cv2.morphologyEx(rest, cv2.MORPH_OPEN, self._rim))
        rims = np.zeros_like(mask)
        rims[at] = cv2.bitwise_and(cv2.bitwise_and(thin, candidates[at]), cv2.dilate(patches[at], self._rim))
        return rims


def _thinned(values: np.ndarray) -> np.ndarray:
    """Every second row and column."""
    return np.ascontiguousarray(values[::2, ::2])


def _enlarged(small: Mask, times: int, shape: tuple[int, ...]) -> Mask:
    """Each pixel repeated both ways, cut to ``shape``."""
    full = cv2.resize(small, None, fx=times, fy=times, interpolation=cv2.INTER_NEAREST)
    return np.ascontiguousarray(full[: shape[0], : shape[1]])


def _near(blocks: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(blocks, (3, 3), 0, borderType=cv2.BORDER_CONSTANT)


def _around(blocks: np.ndarray) -> np.ndarray:
    return cv2.blur(blocks, (TEXTURE_BLOCKS, TEXTURE_BLOCKS), borderType=cv2.BORDER_CONSTANT)


def floor_pixels(camera: CameraModel, volume: Volume | None = None, reach_m: float = 0.0) -> Mask:
    """(H, W) uint8: 255 where a pixel's ray meets the floor z = 0 within 20 m, else 0.

    With a ``volume``, only where it does so inside it or not farther than ``reach_m`` (and a pixel or two) around it.
    """
    u, v = np.meshgrid(np.arange(0, camera.width, GRID_PX), np.arange(0, camera.height, GRID_PX))
    rays = camera.rays_world(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(*u.shape, 3)
    height_m = camera.centre_world[2]
    meets = (height_m > 0) & (-rays[..., 2] * MAX_FLOOR_DISTANCE_M > height_m)
    if volume is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            floor_world = camera.centre_world[:2] - rays[..., :2] * (height_m / rays[..., 2:])
        low, high = volume.low[:2] - reach_m, volume.high[:2] + reach_m
        meets &= ((low <= floor_world) & (floor_world <= high)).all(axis=-1)
    grid = np.where(meets, np.uint8(255), np.uint8(0))
    if volume is not None:
        grid = cv2.dilate(grid, _THREE)  # the grid is coarse: rather a pixel too many
    full = cv2.resize(grid, (u.shape[1] * GRID_PX, u.shape[0] * GRID_PX), interpolation=cv2.INTER_NEAREST)
    return np.ascontiguousarray(full[: camera.height, : camera.width])
