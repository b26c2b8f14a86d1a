"""Compiled sums over the pixels that may be shadow (numba); what they mean is said in :mod:`.shadows`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import njit

from ..background.kernels import OPTIONS

F32 = np.float32


class DarkenedRule(NamedTuple):
    """When a colour is that of the darkened background; see :class:`.shadows.ColourShadow`.

    tint : share of the light lost. chromaticity2 : squared distance in sigmas, at most, and at least that of grey
    clothes as bright. contrast2 : squared contrast with black at least. lightest : share of the brightness that is left
    at most.
    """

    tint: float
    chromaticity2: float
    contrast2: float
    lightest: float


@njit(**OPTIONS, crops=True)
def find_darkened(image, expected, mask, noise, codec_variance, darkest, rule):  # type: ignore[no-untyped-def]
    """Return (h, w) uint8: 255 where the colour of 2 x 2 pixels is that of the darkened background, else 0.

    image (2 h, 2 w, 3) uint8, expected (2 h, 2 w, 3) float32; mask (h, w) uint8 : not 0 at what is looked at. An odd
    side is continued. noise (2, 3) : read and slope, as of :class:`..background.noise.Noise`; codec_variance (h, w) :
    variance beyond it, or (0, 0). darkest (h, w) float32 : share of the brightness that is left at least.
    """
    bottom, right = image.shape[0] - 1, image.shape[1] - 1
    found = np.zeros(mask.shape, np.uint8)
    x, mu, variance = np.empty(3), np.empty(3), np.empty(3)
    for i in range(mask.shape[0]):
        for j in range(mask.shape[1]):
            if mask[i, j] == 0:
                continue
            more = codec_variance[i, j] if codec_variance.size else F32(0)
            power = shared = 0.0
            for c in range(3):
                y, v, z, w = 2 * i, 2 * j, min(2 * i + 1, bottom), min(2 * j + 1, right)
                x[c] = 0.25 * (F32(image[y, v, c]) + F32(image[y, w, c]) + F32(image[z, v, c]) + F32(image[z, w, c]))
                mu[c] = 0.25 * (expected[y, v, c] + expected[y, w, c] + expected[z, v, c] + expected[z, w, c])
                variance[c] = noise[0, c] + noise[1, c] * mu[c] + more
                power += mu[c] * mu[c] / variance[c]
                shared += x[c] * mu[c] / variance[c]
            factor = shared / max(power, 1e-9)
            if power < rule.contrast2 or factor < darkest[i, j] or factor > rule.lightest:
                continue
            distance2 = grey2 = 0.0
            mean = (mu[0] + mu[1] + mu[2]) / 3.0
            for c in range(3):
                tint, departure = rule.tint * (1.0 - factor) * mu[c], x[c] - factor * mu[c]
                distance2 += departure * departure / (variance[c] + tint * tint)
                departure = factor * (mean - mu[c])
                grey2 += departure * departure / (variance[c] + tint * tint)
            if distance2 <= rule.chromaticity2 < grey2:
                found[i, j] = 255
    return found


@njit(**OPTIONS, crops=True)
def lose_texture(image, expected, found, window, hidden, share, sums):  # type: ignore[no-untyped-def]
    """Write 0 into ``found`` (h, w) where 2 x 2 pixels lack the background's texture; means are over ``window`` such.

    image (2 h, 2 w) uint8, expected (2 h, 2 w) float32, an odd side is continued. A texture whose variance is no more
    than ``hidden`` is not seen, one of which the image has less than a ``share`` is lost. Windows are of what was found
    alone. sums (4, h, w) float32 : written where it stays: 1, and squares and products as of :func:`shadow_sums`.
    """
    (height, width), reach = found.shape, window // 2
    bottom, right = image.shape[0] - 1, image.shape[1] - 1
    own = np.zeros((5, height, width), np.float32)  # 1, x, mu, x mu, mu^2 of what was found, 0 elsewhere
    for i in range(height):
        for j in range(width):
            if found[i, j]:
                y, v, z, w = 2 * i, 2 * j, min(2 * i + 1, bottom), min(2 * j + 1, right)
                x = F32(0.25) * (F32(image[y, v]) + F32(image[y, w]) + F32(image[z, v]) + F32(image[z, w]))
                mu = F32(0.25) * (expected[y, v] + expected[y, w] + expected[z, v] + expected[z, w])
                own[0, i, j], own[1, i, j], own[2, i, j], own[3, i, j], own[4, i, j] = 1, x, mu, x * mu, mu * mu
    down, before = np.empty(width, np.float32), np.zeros((5, width + 1))  # sums of the window's rows; of what lies left
    for i in range(height):
        for k in range(5):
            down[:] = 0
            for row in range(max(i - reach, 0), min(i + reach + 1, height)):
                each = own[k, row]
                for j in range(width):
                    down[j] += each[j]
            for j in range(width):
                before[k, j + 1] = before[k, j] + down[j]
        for j in range(width):
            if found[i, j] == 0:
                continue
            low, high = max(j - reach, 0), min(j + reach + 1, width)
            count = before[0, high] - before[0, low]
            X, M = (before[1, high] - before[1, low]) / count, (before[2, high] - before[2, low]) / count
            darker = X / max(M, 1.0)
            shared = darker * ((before[3, high] - before[3, low]) / count - X * M)
            power = darker * darker * ((before[4, high] - before[4, low]) / count - M * M)
            if power > hidden and shared < share * power:
                found[i, j] = 0
                continue
            detail, texture = own[1, i, j] - X, darker * (own[2, i, j] - M)
            sums[0, i, j], sums[1, i, j] = 1, (detail - texture) * (detail - texture)
            sums[2, i, j], sums[3, i, j] = detail * texture, texture * texture


@njit(**OPTIONS, crops=True)
def shadow_sums(image, expected, mask, window, block, darkest, lightest):  # type: ignore[no-untyped-def]
    """Sum, block by block, how a mono image keeps the background's texture where it is darker.

    Of every second row and column, with x the image's level and mu the background's, X and M their means over
    ``window`` pixels, and a = X / M between ``darkest`` and ``lightest``: x - X and a (mu - M).
    image (h, w) uint8, expected (h, w) float32, mask (h, w) uint8 : not 0 at pixels that are looked at. Gives dark
    (ceil(h / 2), ceil(w / 2)) uint8, 255 where a pixel counts, and sums (4, blocks down, blocks across) float32 over
    the pixels that a block stands for: their number; (x - X - a (mu - M))^2; (x - X) a (mu - M); (a (mu - M))^2.
    """
    height, width = mask.shape
    reach, side = window // 2, block // 2
    dark = np.zeros(((height + 1) // 2, (width + 1) // 2), np.uint8)
    sums = np.zeros((4, -(-dark.shape[0] // side), -(-dark.shape[1] // side)), np.float32)
    own, other = np.empty(width, np.float32), np.empty(width, np.float32)  # sums over the window's rows
    each, area = F32(4), F32(window * window)
    for v in range(dark.shape[0]):
        y = 2 * v
        first, last = width, -1
        for u in range(dark.shape[1]):
            if mask[y, 2 * u]:
                first, last = min(first, 2 * u), 2 * u
        if last < 0:
            continue
        low, high = max(first - reach, 0), min(last + reach + 1, width)
        own[low:high] = F32(0)
        other[low:high] = F32(0)
        for step in range(-reach, reach + 1):
            row = _reflected(y + step, height)
            for x in range(low, high):
                own[x] += F32(image[row, x])
                other[x] += expected[row, x]
        for u in range(first // 2, last // 2 + 1):
            x = 2 * u
            if mask[y, x] == 0:
                continue
            X = M = F32(0)
            for step in range(-reach, reach + 1):
                near = _reflected(x + step, width)
                X += own[near]
                M += other[near]
            X /= area
            a = X / max(M / area, F32(1e-3))
            if a < darkest or a > lightest:
                continue
            dark[v, u] = 255
            detail, texture = F32(image[y, x]) - X, a * expected[y, x] - X
            i, j = v // side, u // side
            sums[0, i, j] += each
            sums[1, i, j] += each * (detail - texture) * (detail - texture)
            sums[2, i, j] += each * detail * texture
            sums[3, i, j] += each * texture * texture
    return dark, sums


@njit(**OPTIONS)
def blocks_that_fit(sums, limit, persistence, least_px, reach):  # type: ignore[no-untyped-def]
    """Return (h, w) uint8: 255 at blocks that fit the shadowed floor; see :class:`.shadows.FloorShadow`.

    sums (4, h, w) : of :func:`shadow_sums`. What is left, over the 3 x 3 blocks around (weights 1 2 1, both ways), is
    less than ``limit`` a pixel, and of the texture within ``reach`` blocks a share of ``persistence`` is seen.
    least_px : of the block's pixels.
    """
    _, height, width = sums.shape
    fits = np.zeros((height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            if sums[0, y, x] < least_px:
                continue
            count = left = shared = power = F32(0)
            for v in range(max(y - 1, 0), min(y + 2, height)):
                for u in range(max(x - 1, 0), min(x + 2, width)):
                    weight = F32((2 - abs(v - y)) * (2 - abs(u - x)))
                    count += weight * sums[0, v, u]
                    left += weight * sums[1, v, u]
            if left > count * limit:
                continue
            for v in range(max(y - reach, 0), min(y + reach + 1, height)):
                for u in range(max(x - reach, 0), min(x + reach + 1, width)):
                    shared += sums[2, v, u]
                    power += sums[3, v, u]
            if shared >= persistence * power:
                fits[y, x] = 255
    return fits


@njit(**OPTIONS)
def sum_by_label(labels, values, sums):  # type: ignore[no-untyped-def]
    """Add up four kinds of ``values`` (4, h, w) float32 over the places of each label (h, w) int32: sums, 4 x (n,)."""
    a, b, c, d = sums
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            k = labels[y, x]
            a[k] += values[0, y, x]
            b[k] += values[1, y, x]
            c[k] += values[2, y, x]
            d[k] += values[3, y, x]


@njit(**OPTIONS, crops=True)
def find_rims(image, expected, patch, beside, window, limit, fits):  # type: ignore[no-untyped-def]
    """Write 255 into ``fits`` (h, w), else 0, where most pixels around one are as dark as the patch near them.

    image (h, w) uint8, expected (h, w) float32; patch (h, w) uint8 : not 0 where shadow was found; beside (h, w)
    uint8 : not 0 at the pixels that are looked at. window : side of what is near, in pixels of half the resolution.
    limit : grey levels by which a pixel differs at most from the background, made as dark as the patch is near it.
    """
    near = _as_dark_as_near(image, expected, patch, beside, window, limit)
    _most_neighbours(near, fits)


@njit(**OPTIONS)
def _as_dark_as_near(image, expected, patch, beside, window, limit):  # type: ignore[no-untyped-def]
    """Return (h, w) uint8: 1 where a pixel ``beside`` is as dark as the mean of the patch in the window around it."""
    height, width = patch.shape
    down, across, reach = (height + 1) // 2, (width + 1) // 2, window // 2
    seen, there = np.zeros((down, across)), np.zeros((down, across))  # of the patch, every second pixel
    for v in range(down):
        for u in range(across):
            if patch[2 * v, 2 * u]:
                seen[v, u], there[v, u] = image[2 * v, 2 * u], expected[2 * v, 2 * u]
    near = np.zeros((height, width), np.uint8)
    own, other = np.empty(across), np.empty(across)  # sums over the window's rows
    X, M = np.zeros(across + 1 + 2 * reach), np.zeros(across + 1 + 2 * reach)  # ... and over what lies left of a place
    scale = 1.0 / (window * window)
    for v in range(down):
        first, last = across, -1
        for y in range(2 * v, min(2 * v + 2, height)):
            row = beside[y]
            for x in range(width):
                if row[x]:
                    first, last = min(first, x // 2), max(last, x // 2)
        if last < 0:
            continue
        low, high = max(first - reach, 0), min(last + reach + 1, across)
        own[:], other[:] = 0.0, 0.0
        for step in range(-reach, reach + 1):
            at = _reflected(v + step, down)
            seen_row, there_row, own_part, other_part = seen[at][low:high], there[at][low:high], own[low:], other[low:]
            for u in range(len(seen_row)):
                own_part[u] += seen_row[u]
                other_part[u] += there_row[u]
        for u in range(first - reach, last + reach + 1):
            at, k = _reflected(u, across), u + reach
            X[k + 1], M[k + 1] = X[k] + own[at], M[k] + other[at]
        for u in range(first, last + 1):
            sums = X[u + window] - X[u], M[u + window] - M[u]
            darker = F32(sums[0] * scale) / max(F32(sums[1] * scale), F32(1e-3))
            for y in range(2 * v, min(2 * v + 2, height)):
                for x in range(2 * u, min(2 * u + 2, width)):
                    if beside[y, x] and abs(darker * expected[y, x] - F32(image[y, x])) <= limit:
                        near[y, x] = 1
    return near


@njit(**OPTIONS)
def _most_neighbours(near, fits):  # type: ignore[no-untyped-def]
    """Write 255 into ``fits`` where at least 5 of the 3 x 3 pixels around one are ``near`` (mirrored at the border)."""
    height, width = near.shape
    sums_of_rows = np.zeros((height, width), np.uint8)  # of three in a row
    for y in range(height):
        row, to = near[y], sums_of_rows[y]
        to[0], to[-1] = row[0] + 2 * row[min(1, width - 1)], row[-1] + 2 * row[max(width - 2, 0)]
        left, middle, right, inner = row[:-2], row[1:-1], row[2:], to[1:-1]
        for x in range(len(inner)):
            inner[x] = left[x] + middle[x] + right[x]
    for y in range(height):
        above, own_row, below = (
            sums_of_rows[_reflected(y - 1, height)],
            sums_of_rows[y],
            sums_of_rows[_reflected(y + 1, height)],
        )
        to = fits[y]
        for x in range(width):
            to[x] = np.uint8(255) if above[x] + own_row[x] + below[x] >= 5 else np.uint8(0)


@njit(**OPTIONS)
def _reflected(place, size):  # type: ignore[no-untyped-def]
    """Return a place beyond the border mirrored at the last pixel."""
    if place < 0:
        place = -place
    if place >= size:
        place = 2 * size - 2 - place
    return min(max(place, 0), size - 1)
