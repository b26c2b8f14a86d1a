"""Compiled passes over the picture, and over samples of it (numba); a colour image is (H, W, 3), a mono one (H, W, 1).

The whole picture is looked at in samples, every STEP_PX-th row and column, that lie in planes (C, h, w).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit
from capture_rig.small_matrices import solve_positive

OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
SCALE = 4.0  # steps of the squared distance's uint8 image: a quarter of a variance, so that 255 is 8 sigmas
HIGHEST = 255.0
STEP_PX = 2  # the whole picture is looked at in every second row and column, all of it where somebody may be
WHITE, BLACK = 1, 2  # kinds of a background that is clipped
F32 = np.float32

# Thresholds: measured by python bench/rooms.py.
DOUBTED = 0.02  # weight of samples that were foreground a frame ago
CLIPPED = 250.0  # grey levels from which a sample tells nothing of noise and displacement
BINS = 256
BIN_SIGMAS = 0.125  # of the histogram that a median is read from
LEVER_PX = 200.0  # how far from the middle a roll shows: about half of a picture
HALF_MEDIAN = 1.4826  # standard deviations of a normal distribution in a median absolute deviation


class Learned(NamedTuple):
    """What an empty room looks like in the light that it was learned in, float32, (H, W C) or samples (C, h, w).

    mean : grey levels. excess : variance beyond the noise's. steepness2 : squared gradient, grey levels^2 / px^2.
    """

    mean: npt.NDArray[np.float32]
    excess: npt.NDArray[np.float32]
    steepness2: npt.NDArray[np.float32]


class Today(NamedTuple):
    """The light and the noise over a part of the picture, float32.

    field (cells down, ...) : of the light, along the middle rows of its cells. down (h,) : where each row lies between
    those, in cells. noise (4, ...) : read, slope, geometry and light: variance = read + slope level + geometry
    steepness2 + light level^2 + excess. light (2, ...) : gain and offset.
    """

    field: npt.NDArray[np.float32]
    down: npt.NDArray[np.float32]
    noise: npt.NDArray[np.float32]
    light: npt.NDArray[np.float32]


class Bounds(NamedTuple):
    """Clipped backgrounds are as expected from level ``white`` on, and up to ``black``. rho : correlation of any two
    channels' noise, whose covariance has the inverse (1 - common) / (1 - rho), common = rho / (1 + 2 rho) in every
    place of the matrix."""

    white: float
    black: float
    rho: float


@njit(**OPTIONS)
def thin_out(image, out):  # type: ignore[no-untyped-def]
    """Write every STEP_PX-th row and column of an image (H, W, C) into planes (C, h, w) uint8."""
    for y in range(out.shape[1]):
        row = image[STEP_PX * y]
        for c in range(len(out)):
            to = out[c, y]
            for x in range(len(to)):
                to[x] = row[STEP_PX * x, c]


@njit(**OPTIONS)
def refresh_samples(learned, today, first, end, expected, inverse_sigma):  # type: ignore[no-untyped-def]
    """Write the level, without gain and offset, and 1 / sigma of samples, both (C, h, w): of the rows ``first`` to
    ``end``. learned (C, h, w); today : field (C, cells down, w), noise (4, C)."""
    last = today.field.shape[1] - 1
    for c in range(len(expected)):
        read, slope, geometry, light = today.noise[0, c], today.noise[1, c], today.noise[2, c], today.noise[3, c]
        for y in range(first, end):
            cell = min(int(today.down[y]), last)
            share, above, below = today.down[y] - F32(cell), today.field[c, cell], today.field[c, min(cell + 1, last)]
            row, more, steep = learned.mean[c, y], learned.excess[c, y], learned.steepness2[c, y]
            to, sure = expected[c, y], inverse_sigma[c, y]
            _lit(row, above, below, share, to)
            for i in range(len(to)):
                level = to[i]
                sure[i] = F32(1) / np.sqrt(read + slope * level + light * level * level + geometry * steep[i] + more[i])


@njit(**OPTIONS)
def distance_of_samples(samples, expected, inverse_sigma, light, bounds, clipped, out):  # type: ignore[no-untyped-def]
    """Write min(255, SCALE z^2) of every sample, z its distance from what is expected, of colours Mahalanobis's.

    What would be brighter than white is white, whatever the light. samples (C, h, w) uint8; expected, inverse_sigma
    (C, h, w) : of :func:`refresh_samples`; light (2, C); clipped (h, w) : WHITE, BLACK or 0; out (h, w) uint8.
    """
    gain, offset, (height, width) = light[0], light[1], out.shape
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
def _lit(row, above, below, share, out):  # type: ignore[no-untyped-def]
    for i in range(len(out)):
        out[i] = row[i] * (above[i] + share * (below[i] - above[i]))


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
def look_closely(image, learned, today, bounds, clipped, box, expected, distance):  # type: ignore[no-untyped-def]
    """Write what is expected in a box of the picture, and how far the picture is from it: min(255, SCALE z^2).

    image (H, W C) uint8, learned and today (.., W C), clipped (H, W) uint8 : of the whole picture. box : top, left,
    bottom, right. expected (h, w C) float32 : written, grey levels; distance (H, W) uint8 : written within the box. See
    :func:`distance_of_samples`.
    """
    top, left, bottom, right = box
    channels, last = image.shape[1] // distance.shape[1], len(today.field) - 1
    begin, end = left * channels, right * channels
    read, slope = today.noise[0][begin:end], today.noise[1][begin:end]
    geometry, unevenness = today.noise[2][begin:end], today.noise[3][begin:end]
    gain, offset = today.light[0][begin:end], today.light[1][begin:end]
    rest = np.empty(end - begin, np.float32)
    for v in range(top, bottom):
        cell = min(int(today.down[v]), last)
        above, below = today.field[cell][begin:end], today.field[min(cell + 1, last)][begin:end]
        share, row = today.down[v] - F32(cell), learned.mean[v][begin:end]
        steep, more = learned.steepness2[v][begin:end], learned.excess[v][begin:end]
        seen, to, out = image[v][begin:end], expected[v - top], distance[v][left:right]
        for i in range(len(to)):
            level = row[i] * (above[i] + share * (below[i] - above[i]))
            variance = read[i] + slope[i] * level + unevenness[i] * level * level
            variance += geometry[i] * steep[i] + more[i]
            level = min(max(gain[i] * level + offset[i], F32(0)), F32(HIGHEST))
            to[i] = level
            rest[i] = (F32(seen[i]) - level) / np.sqrt(variance)
        if channels == 1:
            _write_squares(rest, out)
        else:
            _write_squares_of_pixels(rest, bounds.rho, out)
        kind = clipped[v][left:right]
        for x in range(len(out)):
            if kind[x] != 0 and _is_clipped(seen[channels * x : channels * (x + 1)], kind[x], bounds):
                out[x] = 0


@njit(**OPTIONS)
def follow_running(samples, running, limit, share, differs):  # type: ignore[no-untyped-def]
    """Write 255 into ``differs`` (h, w), else 0, where samples (C, h, w) uint8 differ by more than ``limit`` (h, w)
    from a running mean (C, h, w) float32; move that by a ``share`` towards them."""
    for y in range(len(differs)):
        to, most = differs[y], limit[y]
        to[:] = 0
        for c in range(len(samples)):
            row, mean = samples[c, y], running[c, y]
            for x in range(len(to)):
                rest = F32(row[x]) - mean[x]
                to[x] |= np.uint8(255) if abs(rest) > most[x] else np.uint8(0)
                mean[x] += F32(share) * rest


@njit(**OPTIONS)
def clear_absorbed(image, mean, replaced, limit, brightness, step_px, box, values):  # type: ignore[no-untyped-def]
    """Write 0 into ``values``, of every step_px-th row and column, where the image looks as it was absorbed.

    image (H, W, C) uint8; mean (H, W, C) float32 : as it was absorbed, where ``replaced`` (H, W) is not 0. limit (H, W)
    uint8 : grey levels by which a channel differs at most. box : top, left, bottom, right of what is looked at.
    """
    for y in range(-(-box[0] // step_px), -(-box[2] // step_px)):
        for x in range(-(-box[1] // step_px), -(-box[3] // step_px)):
            v, u = step_px * y, step_px * x
            if replaced[v, u] == 0 or values[y, x] == 0:
                continue
            most = F32(0)
            for c in range(image.shape[2]):
                most = max(most, abs(F32(image[v, u, c]) - min(F32(brightness) * mean[v, u, c], F32(HIGHEST))))
            if most <= limit[v, u]:
                values[y, x] = 0


@njit(**OPTIONS)
def median(values):  # type: ignore[no-untyped-def]
    """Return the median of values (n,) float32, as numpy's: it takes ten times as long for a thousand."""
    own, n = values.copy(), len(values)
    upper, low, high = n // 2, 0, n - 1
    while low < high:  # Hoare's selection
        pivot, i, j = own[(low + high) // 2], low, high
        while i <= j:
            while own[i] < pivot:
                i += 1
            while own[j] > pivot:
                j -= 1
            if i <= j:
                own[i], own[j] = own[j], own[i]
                i, j = i + 1, j - 1
        if upper <= j:
            high = j
        elif upper >= i:
            low = i
        else:
            break
    if n % 2:
        return own[upper]
    most = own[0]
    for k in range(1, upper):
        most = max(most, own[k])
    return F32(0.5) * (most + own[upper])


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
def robust_gain(seen, expected, precision, trust, start, prior, steps, reach, weight):  # type: ignore[no-untyped-def]
    """Fit seen = gain expected + offset by iteratively reweighted least squares (Geman and McClure).

    seen, expected, precision, trust (n,) float32; trust : 0 for samples that say nothing, less than 1 for doubtful
    ones. start (2,) : gain and offset to begin with. prior : share of the samples' weight that holds the offset
    at 0, in grey levels^-2. weight (n,) is written: each sample's at the end. Gives gain, offset and the scale of the
    residuals in sigmas (1: as the noise says).
    """
    gain, offset, scale = start[0], start[1], 1.0
    distance = np.empty(len(seen), np.float32)
    for step in range(steps + 1):
        for i in range(len(seen)):
            rest = seen[i] - (gain * expected[i] + offset)
            distance[i] = abs(rest) * np.sqrt(precision[i])
        scale = max(HALF_MEDIAN * median_of(distance, trust, BIN_SIGMAS * (1.0 if step else 4.0)), 1.0)
        see = sxe = sx = se = sw = 0.0
        for i in range(len(seen)):
            share = distance[i] / (reach * scale)
            down = 1.0 / (1.0 + share * share)
            w = trust[i] * down * down * precision[i]
            weight[i] = w
            sw += w
            se += w * expected[i]
            see += w * expected[i] * expected[i]
            sx += w * seen[i]
            sxe += w * seen[i] * expected[i]
        if step == steps:
            break
        held = sw * (1.0 + prior)
        det = see * held - se * se
        if sw <= 0.0 or det <= 1e-9 * see * held:
            break
        gain, offset = (sxe * held - sx * se) / det, (see * sx - se * sxe) / det
    return gain, offset, scale


@njit(**OPTIONS)
def take_samples(samples, expected, inverse_sigma, at, doubted, out, trust):  # type: ignore[no-untyped-def]
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
def take_residuals(picture, mean, excess, field, at, doubted, now, out, trust):  # type: ignore[no-untyped-def]
    """Collect what the displacement is fitted to, at some places of the picture.

    picture (H W, C) uint8, mean, excess (H W, C) float32; field (n, C) : of the light there; at (2, n) : index of each
    place, and of its block in ``doubted`` (blocks,) uint8. now (4, C) : gain and offset of the light, read and slope of
    the noise. out (2, n, C) float32 : written: picture - gain field mean - offset, and the variance of that. trust (n,)
    float32 : written: DOUBTED where the block is doubted, 0 from the level CLIPPED on, else 1.
    """
    for i in range(at.shape[1]):
        k = at[0, i]
        trust[i] = F32(DOUBTED) if doubted[at[1, i]] else F32(1)
        for c in range(picture.shape[1]):
            level = F32(now[0, c]) * field[i, c] * mean[k, c]
            out[0, i, c] = picture[k, c] - level - F32(now[1, c])
            out[1, i, c] = now[2, c] + now[3, c] * level + excess[k, c]
            if picture[k, c] >= CLIPPED:
                trust[i] = F32(0)


@njit(**OPTIONS)
def weigh_samples(samples, trust, gain, offset, least, near2, usable):  # type: ignore[no-untyped-def]
    """Write each sample's weight ``usable`` (C, n) float32 for the fit of the light; see ``LightEstimator.update``.

    samples (3, C, n) : of :func:`take_samples`. trust (n,). least : weight at least of what lies within the squared
    distance ``near2`` of the light until now, gain and offset (C,).
    """
    seen, expected, precision = samples[0], samples[1], samples[2]
    for i in range(len(trust)):
        most = F32(0)
        for c in range(len(seen)):
            rest = seen[c, i] - gain[c] * expected[c, i] - offset[c]
            most = max(most, rest * rest * precision[c, i])
        share = max(trust[i], F32(least)) if most < near2 else trust[i]
        for c in range(len(seen)):
            bounded = seen[c, i] < 250 and 3 < expected[c, i] < 245
            usable[c, i] = share if bounded else F32(0)


@njit(**OPTIONS)
def leave_residuals(samples, usable, gain, offset, far2, rest):  # type: ignore[no-untyped-def]
    """Write seen - gain expected - offset (C, n); return the share of samples that differ by more than ``far2``.

    Only samples of full weight ``usable`` (C, n) differ. samples (3, C, n) : of :func:`take_samples`.
    """
    seen, expected, precision = samples[0], samples[1], samples[2]
    beyond = 0
    for i in range(seen.shape[1]):
        most = F32(0)
        for c in range(len(seen)):
            left = seen[c, i] - gain[c] * expected[c, i] - offset[c]
            rest[c, i] = left
            if usable[c, i] >= 1:
                most = max(most, left * left * precision[c, i])
        beyond += most > far2
    return beyond / seen.shape[1]


@njit(**OPTIONS)
def sum_by_cell(cell, weight, expected, gain, rest, change, known):  # type: ignore[no-untyped-def]
    """Add up, cell by cell, what the samples say of the light's field: change and known (C, cells), zeros before.

    cell (n,) : of each sample. weight, expected, rest (C, n); gain (C,).
    """
    for c in range(len(rest)):
        for i in range(len(cell)):
            level = gain[c] * expected[c, i]
            power = weight[c, i] * level
            change[c, cell[i]] += power * rest[c, i]
            known[c, cell[i]] += power * level


@njit(**OPTIONS)
def follow_cells(field, change, known, prior, share, out):  # type: ignore[no-untyped-def]
    """Move cells of the light's field (down, across, C) by a ``share`` towards what their samples say, or the mean of 3
    x 3 cells around them.

    change, known (C, cells) : of :func:`sum_by_cell`. prior : weight of the neighbours, as a share of the median of
    ``known``. out (down, across, C) float32 : written.
    """
    down, across, channels = field.shape
    for c in range(channels):
        held = prior * np.median(known[c]) + 1e-9
        for y in range(down):
            for x in range(across):
                around = 0.0
                for v in range(y - 1, y + 2):
                    for u in range(x - 1, x + 2):
                        around += field[min(max(v, 0), down - 1), min(max(u, 0), across - 1), c]
                own, k = field[y, x, c], y * across + x
                found = (own * change[c, k] + held * (around / 9.0 - own)) / (known[c, k] + held)
                out[y, x, c] = own + share * found


@njit(**OPTIONS)
def robust_shift(rest, right, down, turned, variance, trust, steps, reach, hold):  # type: ignore[no-untyped-def]
    """Fit rest = -right dx - down dy - turned roll: by how much the picture moved.

    rest, right, down, turned, variance (n, C) float32: residuals, their change for a pixel to the right, downwards, and
    a radian clockwise about the middle, the noise's variance. trust (n,) float32. hold : information, px^-2, that keeps
    the displacement at 0. Gives dx, dy, roll, and the displacement that is left, a robust standard deviation in pixels.
    """
    n, channels = rest.shape
    x, factor = np.zeros(3), np.zeros((3, 3))
    distance, J = np.empty(n, np.float32), np.empty(3)
    for step in range(steps + 1):
        for i in range(n):
            total = 0.0
            for c in range(channels):
                left = rest[i, c] + right[i, c] * x[0] + down[i, c] * x[1] + turned[i, c] * x[2]
                total += left * left / variance[i, c]
            distance[i] = np.sqrt(total / channels)
        if step == steps:
            break
        scale = max(HALF_MEDIAN * median_of(distance, trust, BIN_SIGMAS), 1.0)
        A, b = np.zeros((3, 3)), np.zeros(3)
        A[0, 0] = A[1, 1] = hold
        A[2, 2] = hold * LEVER_PX * LEVER_PX
        for i in range(n):
            share = distance[i] / (reach * scale)
            bounded = 1.0 / (1.0 + share * share)
            for c in range(channels):
                w = trust[i] * bounded * bounded / variance[i, c]
                J[0], J[1], J[2] = right[i, c], down[i, c], turned[i, c]
                for j in range(3):
                    b[j] -= w * J[j] * rest[i, c]
                    for k in range(j + 1):
                        A[j, k] += w * J[j] * J[k]
        if not solve_positive(A, b, factor, x):
            x[:] = 0.0
            break
    # the displacement along each place's steepest channel, and the part of it that noise explains
    apparent, noise, clear = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32)
    for i in range(n):
        most, steepest = 0.0, 0
        for c in range(channels):
            steep2 = right[i, c] * right[i, c] + down[i, c] * down[i, c]
            if steep2 > most:
                most, steepest = steep2, c
        if trust[i] >= 1.0 and most > 0.0:
            c = steepest
            left = rest[i, c] + right[i, c] * x[0] + down[i, c] * x[1] + turned[i, c] * x[2]
            apparent[i], noise[i], clear[i] = abs(left) / np.sqrt(most), np.sqrt(variance[i, c] / most), 1.0
    left_px, noise_px = HALF_MEDIAN * median_of(apparent, clear, 0.01), median_of(noise, clear, 0.01)
    return x[0], x[1], x[2], np.sqrt(max(left_px * left_px - noise_px * noise_px, 0.0))
