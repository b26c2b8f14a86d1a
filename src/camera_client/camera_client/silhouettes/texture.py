"""How much of the background's texture a picture still shows where it is darker: a shadow keeps it, a body hides it."""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit

from ..background.kernels import F32, OPTIONS


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
def _reflected(place, size):  # type: ignore[no-untyped-def]
    """Return a place beyond the border mirrored at the last pixel."""
    if place < 0:
        place = -place
    if place >= size:
        place = 2 * size - 2 - place
    return min(max(place, 0), size - 1)


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
