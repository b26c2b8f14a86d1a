"""Compiled passes over the picture, and over samples of it (numba); a colour image is (H, W, 3), a mono one (H, W, 1).

The whole picture is looked at in samples, every STEP_PX-th row and column, that lie in planes (C, h, w).
"""

from __future__ import annotations

from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit
from capture_rig.small_matrices import robust_weight

from ..sources.frame_checks import WHITE_LEVEL

OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
SCALE = 4.0  # steps of the squared distance's uint8 image: a quarter of a variance, so that 255 is 8 sigmas
HIGHEST = float(np.iinfo(np.uint8).max)
STEP_PX = 2  # the whole picture is looked at in every second row and column, all of it where somebody may be
BLOCK_PX = 8  # side of the blocks that foreground is counted in
WHITE, BLACK = 1, 2  # kinds of a background that is clipped
F32 = np.float32

# Thresholds: WITHIN_NOISE, BEYOND_NOISE from the normal distribution; else measured by python bench/rooms.py.
WITHIN_NOISE = 3.0  # standard deviations, of means and typical residuals: what noise explains
BEYOND_NOISE = 4.0  # standard deviations: 1 in 16000 by noise alone, as few pixels as a picture may lose
DOUBTED = 0.02  # weight of samples that were foreground a frame ago
USUAL_S = 1.0  # time constant of what is usual: noise, outliers, flicker, edges' misfit, a picture at rest
BINS = 256
BIN_SIGMAS = 0.125  # of the histogram that a median is read from
REACH = 2.5  # of a robust fit; sigmas
HALF_MEDIAN = 1 / NormalDist().inv_cdf(0.75)  # normal standard deviations in a median absolute deviation


class Learned(NamedTuple):
    """What an empty room looks like in the light that it was learned in, float32, (H, W C) or samples (C, h, w).

    mean : grey levels. excess : variance beyond the noise's. steepness2 : squared gradient, grey levels^2 / px^2.
    """

    mean: npt.NDArray[np.float32]
    excess: npt.NDArray[np.float32]
    steepness2: npt.NDArray[np.float32]


class Bounds(NamedTuple):
    """Clipped backgrounds are as expected from level ``white`` on, and up to ``black``. rho : correlation of any two
    channels' noise, whose covariance has the inverse (1 - common) / (1 - rho), common = rho / (1 + 2 rho) in every
    place of the matrix."""

    white: float
    black: float
    rho: float


class Today(NamedTuple):
    """The light and the noise of now, float32.

    field (cells down, cells across, C) : of the light. noise (4, C) : read, slope, geometry and light: variance = read
    + slope level + geometry steepness2 + light level^2 + excess. light (2, C) : gain and offset.
    """

    field: npt.NDArray[np.float32]
    noise: npt.NDArray[np.float32]
    light: npt.NDArray[np.float32]
    bounds: Bounds


@njit(**OPTIONS)
def refresh_samples(learned, today, first, end, expected, inverse_sigma):  # type: ignore[no-untyped-def]
    """Write the level, without gain and offset, and 1 / sigma of samples, both (C, h, w): of the rows ``first`` to
    ``end``. learned (C, h, w)."""
    channels, height, width = expected.shape
    field = np.empty((len(today.field), width), np.float32)
    for c in range(channels):
        read, slope, geometry, light = today.noise[0, c], today.noise[1, c], today.noise[2, c], today.noise[3, c]
        _field_across(today.field[:, :, c : c + 1], width, 0, field)
        for y in range(first, end):
            above, below, share = _between_rows(field, y, height)
            row, more, steep = learned.mean[c, y], learned.excess[c, y], learned.steepness2[c, y]
            to, sure = expected[c, y], inverse_sigma[c, y]
            for i in range(len(to)):
                to[i] = row[i] * (above[i] + share * (below[i] - above[i]))
            for i in range(len(to)):
                level = to[i]
                sure[i] = F32(1) / np.sqrt(read + slope * level + light * level * level + geometry * steep[i] + more[i])


@njit(**OPTIONS)
def _field_across(field, width, first, out):  # type: ignore[no-untyped-def]
    """Write the light's field along the middle rows of its cells, at columns from ``first`` on: out (down, n C).

    field (cells down, cells across, C); width : of the whole picture.
    """
    down, across, channels = field.shape
    for x in range(out.shape[1] // channels):
        at = min(max((first + x + 0.5) * across / width - 0.5, 0.0), across - 1.0)
        cell = min(int(at), across - 2)
        share = F32(at - cell)
        for row in range(down):
            for c in range(channels):
                left = field[row, cell, c]
                out[row, channels * x + c] = left + share * (field[row, cell + 1, c] - left)


@njit(**OPTIONS)
def _between_rows(field, y, height):  # type: ignore[no-untyped-def]
    """Return the rows of cells (down, n) above and below row ``y`` of the picture, and the share of the lower one."""
    at = min(max((y + 0.5) * len(field) / height - 0.5, 0.0), len(field) - 1.0)
    cell = min(int(at), len(field) - 2)
    return field[cell], field[cell + 1], F32(at - cell)


@njit(**OPTIONS)
def distance_of_samples(samples, expected, inverse_sigma, today, clipped, out):  # type: ignore[no-untyped-def]
    """Write min(255, SCALE z^2) of every sample, z its distance from what is expected, of colours Mahalanobis's.

    What would be brighter than white is white, whatever the light. samples (C, h, w) uint8; expected, inverse_sigma
    (C, h, w) : of :func:`refresh_samples`; clipped (h, w) : WHITE, BLACK or 0; out (h, w) uint8.
    """
    gain, offset, bounds, (height, width) = today.light[0], today.light[1], today.bounds, out.shape
    rest = np.empty((len(samples), width), np.float32)
    for y in range(height):
        for c in range(len(samples)):
            _deviations(samples[c, y], expected[c, y], inverse_sigma[c, y], gain[c], offset[c], rest[c])
        if len(samples) == 1:
            _write_squares(rest[0], out[y])
        else:
            _write_squares_of_planes(rest[0], rest[1], rest[2], bounds.rho, out[y])
        for x in range(width):
            if clipped[y, x] != 0 and _is_clipped(samples[:, y, x], clipped[y, x], bounds):
                out[y, x] = 0


# Loops over rows that read and write few arrays each, so that the compiler does eight pixels at a time.


@njit(**OPTIONS)
def _deviations(seen, expected, inverse_sigma, gain, offset, out):  # type: ignore[no-untyped-def]
    for i in range(len(out)):
        out[i] = (F32(seen[i]) - min(gain * expected[i] + offset, F32(HIGHEST))) * inverse_sigma[i]


@njit(**OPTIONS)
def _write_squares(rest, out):  # type: ignore[no-untyped-def]
    for i in range(len(out)):
        out[i] = np.uint8(min(rest[i] * rest[i] * F32(SCALE), F32(HIGHEST)))


@njit(**OPTIONS)
def _write_squares_of_planes(r0, r1, r2, rho, out):  # type: ignore[no-untyped-def]
    scale, common = F32(SCALE / (1.0 - rho)), F32(rho / (1.0 + 2.0 * rho))
    for i in range(len(out)):
        out[i] = _squared(r0[i], r1[i], r2[i], scale, common)


@njit(**OPTIONS)
def _write_squares_of_pixels(rest, rho, out):  # type: ignore[no-untyped-def]
    scale, common = F32(SCALE / (1.0 - rho)), F32(rho / (1.0 + 2.0 * rho))
    for i in range(len(out)):
        out[i] = _squared(rest[3 * i], rest[3 * i + 1], rest[3 * i + 2], scale, common)


@njit(**OPTIONS)
def _squared(r0, r1, r2, scale, common):  # type: ignore[no-untyped-def]
    whole = r0 + r1 + r2
    total = r0 * r0 + r1 * r1 + r2 * r2 - common * whole * whole
    return np.uint8(min(total * scale, F32(HIGHEST)))


@njit(**OPTIONS)
def _is_clipped(pixel, kind, bounds):  # type: ignore[no-untyped-def]
    """Whether a pixel (C,) looks as a clipped background of a ``kind`` may."""
    least = most = pixel[0]
    for level in pixel[1:]:
        least, most = min(least, level), max(most, level)
    return least >= bounds.white if kind == WHITE else most <= bounds.black


@njit(**OPTIONS)
def compare_box(image, learned, today, clipped, at, rows, expected, found):  # type: ignore[no-untyped-def]
    """Write what is expected in a part of the picture, and how far the picture is from it.

    image (H, W C) uint8, learned (H, W C), clipped (H, W) uint8 : of the whole picture. at : top and left of the part;
    rows (h, 2) : of each of its rows, the first and last column but one that are looked at; beside them the picture is
    as expected. expected (h, w C) float32 : written, grey levels. found (2, h, w) uint8 : written: min(255, SCALE z^2),
    and whole grey levels in the channel that differs most. See :func:`distance_of_samples`.
    """
    (top, left), (_, height, width) = at, found.shape
    channels = expected.shape[1] // width
    n = width * channels
    field, noise, light = np.empty((len(today.field), n), F32), np.empty((4, n), F32), np.empty((2, n), F32)
    _field_across(today.field, clipped.shape[1], left, field)
    for i in range(n):
        for k in range(4):
            noise[k, i] = today.noise[k, i % channels]
        for k in range(2):
            light[k, i] = today.light[k, i % channels]
    rest = np.empty(n, F32)
    for y in range(height):
        v, first, end = top + y, rows[y, 0], rows[y, 1]
        seen, to = image[v][left * channels :][:n], expected[y]
        found[0, y] = 0
        found[1, y] = 0
        above, below, share = _between_rows(field, v, len(image))
        a, b, begin = channels * first, channels * end, channels * left
        to[:a] = seen[:a]
        to[b:] = seen[b:]
        read, slope, geometry, unevenness = noise[0][a:b], noise[1][a:b], noise[2][a:b], noise[3][a:b]
        mean, steep = learned.mean[v][begin + a : begin + b], learned.steepness2[v][begin + a : begin + b]
        excess, gain, offset = learned.excess[v][begin + a : begin + b], light[0][a:b], light[1][a:b]
        above, below, own, to = above[a:b], below[a:b], seen[a:b], to[a:b]
        for i in range(len(to)):
            level = mean[i] * (above[i] + share * (below[i] - above[i]))
            variance = read[i] + slope[i] * level + unevenness[i] * level * level + geometry[i] * steep[i] + excess[i]
            level = min(max(gain[i] * level + offset[i], F32(0)), F32(HIGHEST))
            to[i] = level
            rest[i] = (F32(own[i]) - level) / np.sqrt(variance)
        out, change, kind = found[0, y][first:end], found[1, y][first:end], clipped[v][left + first : left + end]
        if channels == 1:
            _write_squares(rest, out)
        else:
            _write_squares_of_pixels(rest, today.bounds.rho, out)
        _write_largest(own, to, change)
        for x in range(len(out)):
            if kind[x] != 0 and _is_clipped(own[channels * x : channels * (x + 1)], kind[x], today.bounds):
                out[x] = 0


@njit(**OPTIONS)
def _write_largest(seen, level, out):  # type: ignore[no-untyped-def]
    """Write by how many whole grey levels a row (n C) and what is expected differ in the channel that differs most."""
    if len(seen) == len(out):
        for x in range(len(out)):
            out[x] = np.uint8(abs(F32(seen[x]) - level[x]) + F32(0.5))
        return
    for x in range(len(out)):
        most = abs(F32(seen[3 * x]) - level[3 * x])
        most = max(most, abs(F32(seen[3 * x + 1]) - level[3 * x + 1]))
        out[x] = np.uint8(max(most, abs(F32(seen[3 * x + 2]) - level[3 * x + 2])) + F32(0.5))


@njit(**OPTIONS)
def clear_absorbed(image, mean, replaced, limit, now, box, values):  # type: ignore[no-untyped-def]
    """Write 0 into ``values``, of every step_px-th row and column, where the image looks as it was absorbed.

    image (H, W, C) uint8; mean (H, W, C) float32 : as it was absorbed, where ``replaced`` (H, W) is not 0. limit (H, W)
    uint8 : grey levels by which a channel differs at most. now : brightness, step_px, and row and column of the first
    of the values. box : top, left, bottom, right of what is looked at.
    """
    brightness, step_px, top, left = now
    for y in range(-(-(box[0] - top) // step_px), -(-(box[2] - top) // step_px)):
        for x in range(-(-(box[1] - left) // step_px), -(-(box[3] - left) // step_px)):
            v, u = top + step_px * y, left + step_px * x
            if replaced[v, u] == 0 or values[y, x] == 0:
                continue
            most = F32(0)
            for c in range(image.shape[2]):
                most = max(most, abs(F32(image[v, u, c]) - min(F32(brightness) * mean[v, u, c], F32(HIGHEST))))
            if most <= limit[v, u]:
                values[y, x] = 0


@njit(**OPTIONS)
def median_of(values, used, unit):  # type: ignore[no-untyped-def]
    """Return the median of the ``values`` >= 0 with ``used`` > 0, read from a histogram of steps of ``unit``."""
    counts = np.zeros(BINS, np.int64)
    total = 0
    for i in range(len(values)):
        if used[i] > 0:
            counts[min(int(values[i] / unit), BINS - 1)] += 1
            total += 1
    if total == 0:
        return 0.0
    below, half = 0, 0.5 * total
    for k in range(BINS):
        if below + counts[k] >= half:
            return unit * (k + (half - below) / max(counts[k], 1))
        below += counts[k]
    return unit * BINS


@njit(**OPTIONS)
def robust_weights(distance, trust, unit, out):  # type: ignore[no-untyped-def]
    """Write the weights (n,) of a step of iteratively reweighted least squares (Geman and McClure).

    distance (n,) float32 : the residuals, standard deviations of the noise; they may all be larger by the same factor.
    trust (n,) float32 : 0 for samples that say nothing, less than 1 for doubtful ones. unit : see :func:`median_of`.
    """
    reach = REACH * max(HALF_MEDIAN * median_of(distance, trust, unit), 1.0)
    for i in range(len(distance)):
        out[i] = robust_weight(trust[i], (distance[i] / reach) ** 2)


@njit(**OPTIONS)
def gather_samples(samples, expected, inverse_sigma, at, doubted, out, trust):  # type: ignore[no-untyped-def]
    """Collect what the light is fitted to, at some of the picture's samples.

    samples (C, m) uint8, expected, inverse_sigma (C, m) : of :func:`refresh_samples`; at (2, n) : index of each, and of
    its block in ``doubted`` (blocks,) uint8. out (3, C, n) float32 : written: seen, expected, inverse_sigma^2. trust
    (n,) float32 : written: DOUBTED where the block is doubted, else 1.
    """
    for i in range(at.shape[1]):
        k = at[0, i]
        for c in range(len(samples)):
            out[0, c, i], out[1, c, i] = samples[c, k], expected[c, k]
            out[2, c, i] = inverse_sigma[c, k] * inverse_sigma[c, k]
        trust[i] = F32(DOUBTED) if doubted[at[1, i]] else F32(1)


@njit(**OPTIONS)
def gather_residuals(picture, mean, excess, field, at, doubted, now, out, trust):  # type: ignore[no-untyped-def]
    """Collect what the displacement is fitted to, at some places of the picture.

    picture (H W, C) uint8, mean, excess (H W, C) float32; field (n, C) : of the light there; at (2, n) : index of each
    place, and of its block in ``doubted`` (blocks,) uint8. now (4, C) : gain and offset of the light, read and slope of
    the noise. out (2, n, C) float32 : written: picture - gain field mean - offset, and the variance of that. trust (n,)
    float32 : written: DOUBTED where the block is doubted, 0 from WHITE_LEVEL on, else 1.
    """
    for i in range(at.shape[1]):
        k = at[0, i]
        trust[i] = F32(DOUBTED) if doubted[at[1, i]] else F32(1)
        for c in range(picture.shape[1]):
            level = F32(now[0, c]) * field[i, c] * mean[k, c]
            out[0, i, c] = picture[k, c] - level - F32(now[1, c])
            out[1, i, c] = now[2, c] + now[3, c] * level + excess[k, c]
            if picture[k, c] >= WHITE_LEVEL:
                trust[i] = F32(0)
