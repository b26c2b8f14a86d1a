"""How much of the background's texture a picture still shows where it is darker: a shadow keeps it, a body hides it.

With x the picture's level and mu the background's, X and M their means over a window, and a = X / M, the *detail* is
x - X, and the *texture* that should be there a (mu - M). Sums over places are (4, ...) float32: the number of places,
(detail - texture)^2, detail texture, and texture^2.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ..frame_source import Image, Mask

Floats = npt.NDArray[np.floating]


def halve(image: np.ndarray) -> np.ndarray:
    """The image at half its size (rounded up), each pixel the mean of the four it covers; odd sides are continued."""
    down, right = image.shape[0] % 2, image.shape[1] % 2
    if down or right:
        image = cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_REPLICATE)
    return cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)


def shadow_sums(
    image: Image, expected: Floats, mask: Mask, window: int, block: int, limits: tuple[float, float]
) -> tuple[Mask, Floats]:
    """Sum, block by block, how a mono image keeps the background's texture where it is darker.

    Every second row and column is looked at; image, expected, mask (h, w), mask not 0 at pixels that are looked at.
    limits : of a. Gives dark (ceil(h / 2), ceil(w / 2)) uint8, 255 where a pixel counts, and the sums (4, blocks down,
    blocks across) over the pixels that a block stands for.
    """
    X, M = (_mean_around(each, window)[::2, ::2] for each in (image, expected))
    darker = X / np.maximum(M, np.float32(1e-3))
    dark = (mask[::2, ::2] > 0) & (darker >= limits[0]) & (darker <= limits[1])
    values = _products(image[::2, ::2] - X, darker * expected[::2, ::2] - X, dark)
    side = block // 2
    down, across = (-(-n // side) for n in dark.shape)
    below, beside = down * side - dark.shape[0], across * side - dark.shape[1]
    padded = (cv2.copyMakeBorder(each, 0, below, 0, beside, cv2.BORDER_CONSTANT) for each in values)
    means = [cv2.resize(each, (across, down), interpolation=cv2.INTER_AREA) for each in padded]
    return np.where(dark, np.uint8(255), np.uint8(0)), np.stack(means) * np.float32(block**2)


def blocks_that_fit(sums: Floats, limit: float, persistence: float, least_px: float, reach: int) -> Mask:
    """Return (h, w) uint8: 255 at blocks that fit the shadowed floor; see :class:`.shadows.FloorShadow`.

    sums (4, h, w) : of :func:`shadow_sums`. What is left, over the 3 x 3 blocks around (weights 1 2 1, both ways), is
    less than ``limit`` a pixel, and of the texture within ``reach`` blocks a share of ``persistence`` is seen.
    least_px : of the block's pixels.
    """
    near, wide = np.array([1, 2, 1], np.float32), (2 * reach + 1,) * 2
    count, left = (cv2.sepFilter2D(each, -1, near, near, borderType=cv2.BORDER_CONSTANT) for each in sums[:2])
    shared, power = (_sum_around(each, wide) for each in sums[2:])
    fits = (sums[0] >= least_px) & (left <= count * limit) & (shared >= persistence * power)
    return np.where(fits, np.uint8(255), np.uint8(0))


def drop_lost_texture(image: Image, expected: Floats, found: Mask, window: int, hidden: float, share: float) -> Floats:
    """Write 0 into ``found`` (h, w) where 2 x 2 pixels lack the background's texture; means are over ``window`` such.

    image (2 h, 2 w), expected (2 h, 2 w) float32, an odd side is continued. A texture whose variance is no more than
    ``hidden`` is not seen, one of which the image has less than a ``share`` is lost. Windows are of what was found
    alone. Returns the terms (4, h, w) of the sums, 0 where nothing stays.
    """
    x, mu, inside = halve(image.astype(np.float32)), halve(expected), (found > 0).astype(np.float32)
    wide = (window, window)
    count = np.maximum(_sum_around(inside, wide), 1)
    X, M, product, square = (_sum_around(each * inside, wide) / count for each in (x, mu, x * mu, mu * mu))
    darker = X / np.maximum(M, 1)
    shared, power = darker * (product - X * M), darker * darker * (square - M * M)
    found[(power > hidden) & (shared < share * power)] = 0
    return _products(x - X, darker * (mu - M), found > 0)


def sum_by_label(labels: np.ndarray, values: Floats, count: int) -> npt.NDArray[np.float64]:
    """Add up values (4, h, w) over the places of each of ``count`` labels (h, w), 0 left out: (4, count)."""
    at = np.flatnonzero(labels)
    label = labels.reshape(-1)[at]
    return np.stack([np.bincount(label, each.reshape(-1)[at], count) for each in values])


def as_dark_as_near(image: Image, expected: Floats, patch: Mask, window: int, limit: float) -> Mask:
    """Return (ceil(h / 2), ceil(w / 2)) uint8: 255 where every second pixel is as dark as the patch near it.

    patch (h, w) : not 0 where shadow was found, near : within ``window`` such pixels. limit : grey levels by which a
    pixel differs at most from the background, made as dark as the patch is near it.
    """
    own, seen, there = patch[::2, ::2] > 0, image[::2, ::2], expected[::2, ::2]
    X, M = (_mean_around(np.where(own, each, np.float32(0)), window) for each in (seen, there))
    off = X / np.maximum(M, np.float32(1e-3)) * there - seen
    return np.where(np.abs(off) <= limit, np.uint8(255), np.uint8(0))


def _mean_around(values: Image | Floats, window: int) -> Floats:
    return np.asarray(cv2.boxFilter(values, cv2.CV_32F, (window, window)))


def _sum_around(values: Floats, size: tuple[int, int]) -> Floats:
    return np.asarray(cv2.boxFilter(values, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT))


def _products(detail: Floats, texture: Floats, counted: npt.NDArray[np.bool_]) -> Floats:
    left = detail - texture
    own = np.where(counted, np.float32(1), np.float32(0))
    return np.stack([own, left * left * own, detail * texture * own, texture * texture * own])
