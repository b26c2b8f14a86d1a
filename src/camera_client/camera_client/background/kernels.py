"""Compiled passes over whole images and over the sampled pixels of the background (numba).

All functions compute on the arrays that they are given. A colour image is (H, W, 3), a mono one (H, W, 1).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import solve_positive

OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
SCALE = 4.0  # steps of the squared distance's uint8 image: a quarter of a variance, so that 255 is 8 sigmas
HIGHEST = 255.0
F32 = np.float32

# Thresholds: measured by python bench/rooms.py.
DOUBTED = 0.02  # weight of samples that were foreground a frame ago
CLIPPED = 250.0  # grey levels from which a sample tells nothing of noise and displacement
BINS = 256
BIN_SIGMAS = 0.125  # of the histogram that a median is read from
LEVER_PX = 200.0  # how far from the middle a roll shows: about half of a picture
HALF_MEDIAN = 1.4826  # standard deviations of a normal distribution in a median absolute deviation


@njit(**OPTIONS)
def squared_distance(image, expected, inverse_sigma, gain, offset, out):  # type: ignore[no-untyped-def]
    """Write min(255, SCALE z^2) of every pixel of a mono image, z = (image - gain expected - offset) inverse_sigma.

    What would be brighter than white is white, whatever the light.
    image (n,) uint8; expected, inverse_sigma (n,) float32; gain, offset (1,) float32; out (n,) uint8.
    """
    g, b = gain[0], offset[0]
    for i in range(len(out)):
        rest = (F32(image[i]) - min(g * expected[i] + b, F32(HIGHEST))) * inverse_sigma[i]
        out[i] = np.uint8(min(rest * rest * F32(SCALE), F32(HIGHEST)))


@njit(**OPTIONS)
def squared_distance_of_colours(image, expected, inverse_sigma, gain, offset, rho, out):  # type: ignore[no-untyped-def]
    """Write min(255, SCALE z^2) of every pixel of a colour image, z the Mahalanobis distance.

    What would be brighter than white is white, whatever the light.
    image (3 n,) uint8; expected, inverse_sigma (3 n,) float32; gain, offset (3,) float32; rho : correlation of any two
    channels' noise, whose covariance has the inverse (1 - common) / (1 - rho), with common = rho / (1 + 2 rho) in every
    place of the matrix; out (n,) uint8.
    """
    scale, common = F32(SCALE / (1.0 - rho)), F32(rho / (1.0 + 2.0 * rho))
    g0, g1, g2, b0, b1, b2 = gain[0], gain[1], gain[2], offset[0], offset[1], offset[2]
    for i in range(len(out)):
        k = 3 * i
        r0 = (F32(image[k]) - min(g0 * expected[k] + b0, F32(HIGHEST))) * inverse_sigma[k]
        r1 = (F32(image[k + 1]) - min(g1 * expected[k + 1] + b1, F32(HIGHEST))) * inverse_sigma[k + 1]
        r2 = (F32(image[k + 2]) - min(g2 * expected[k + 2] + b2, F32(HIGHEST))) * inverse_sigma[k + 2]
        whole = r0 + r1 + r2
        total = r0 * r0 + r1 * r1 + r2 * r2 - common * whole * whole
        out[i] = np.uint8(min(total * scale, F32(HIGHEST)))


@njit(**OPTIONS)
def refresh_rows(mean, excess, steepness2, field, down, noise, expected, inverse_sigma):  # type: ignore[no-untyped-def]
    """Write the expected image and 1 / sigma of some rows; n is width times channels.

    mean (rows, n) float32 : the background under the light that it was learned in. excess (rows, n) float32 : variance
    of each pixel beyond the noise's. steepness2 (rows, n) float32 : squared gradient, grey levels^2 / px^2. field
    (cells down, n) float32 : the light's field along the middle rows of its cells. down (rows,) float32 : where each
    row lies between those, in cells. noise (4, n) float32 : read, slope, geometry and light of each channel: variance =
    read + slope level + geometry steepness2 + light level^2 + excess. expected, inverse_sigma (rows, n) float32
    : written.
    """
    rows, n = mean.shape
    last = len(field) - 1
    read, slope, geometry, light = noise[0], noise[1], noise[2], noise[3]
    for y in range(rows):
        top = min(int(down[y]), last)
        below, share = min(top + 1, last), down[y] - F32(top)
        above_row, below_row, row = field[top], field[below], mean[y]
        more, steep, to, sure = excess[y], steepness2[y], expected[y], inverse_sigma[y]
        for i in range(n):
            level = row[i] * (above_row[i] + share * (below_row[i] - above_row[i]))
            to[i] = level
            sure[i] = F32(1) / np.sqrt(
                read[i] + slope[i] * level + light[i] * level * level + geometry[i] * steep[i] + more[i]
            )


@njit(**OPTIONS)
def current_levels(expected, gain, offset, out):  # type: ignore[no-untyped-def]
    """Write gain expected + offset, between 0 and 255: expected, out (rows, n), gain, offset (n,) float32."""
    for y in range(len(out)):
        row, to = expected[y], out[y]
        for i in range(len(to)):
            to[i] = min(max(gain[i] * row[i] + offset[i], F32(0)), F32(255))


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
def take_samples(picture, levels, inverse_sigma, at, doubted, out, trust):  # type: ignore[no-untyped-def]
    """Collect what the light is fitted to, at some places of the picture.

    picture (H W, C) uint8, levels, inverse_sigma (H W, C) float32; at (2, n) : index of each sample, and of its block
    in ``doubted`` (blocks,) uint8. out (3, C, n) float32 : written: seen, levels, inverse_sigma^2. trust (n,) float32
    : written: DOUBTED where the block is doubted, else 1.
    """
    for i in range(at.shape[1]):
        k = at[0, i]
        for c in range(picture.shape[1]):
            out[0, c, i], out[1, c, i] = picture[k, c], levels[k, c]
            out[2, c, i] = inverse_sigma[k, c] * inverse_sigma[k, c]
        trust[i] = F32(DOUBTED) if doubted[at[1, i]] else F32(1)


@njit(**OPTIONS)
def take_residuals(picture, levels, excess, at, doubted, now, out, trust):  # type: ignore[no-untyped-def]
    """Collect what the displacement is fitted to, at some places of the picture.

    picture (H W, C) uint8, levels, excess (H W, C) float32; at (2, n) : index of each place, and of its block in
    ``doubted`` (blocks,) uint8. now (4, C) : gain and offset of the light, read and slope of the noise. out (2, n, C)
    float32 : written: picture - gain level - offset, and the variance of that. trust (n,) float32 : written: DOUBTED
    where the block is doubted, 0 from the level CLIPPED on, else 1.
    """
    for i in range(at.shape[1]):
        k = at[0, i]
        trust[i] = F32(DOUBTED) if doubted[at[1, i]] else F32(1)
        for c in range(picture.shape[1]):
            level = F32(now[0, c]) * levels[k, c]
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
