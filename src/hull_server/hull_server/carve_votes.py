"""The rule itself, for blocks of 4 x 4 x 4 voxels at once: one word of 64 bits, bit = 16 z + 4 y + x."""

from __future__ import annotations

import numpy as np
from numba import njit

BLOCK_EDGE = 4
ROW_BITS, ALL_BITS = np.uint64(0xF), np.uint64(0xFFFFFFFFFFFFFFFF)


@njit(cache=True, nogil=True)
def inside_word(low, high):  # type: ignore[no-untyped-def]
    """The bits of a block of 4^3 voxels (bit = 16 z + 4 y + x) from ``low`` to ``high``, which may cut it short."""
    row = (np.uint64(1) << np.uint64(high[0] - low[0] + 1)) - np.uint64(1)
    word = np.uint64(0)
    for z in range(high[2] - low[2] + 1):
        for y in range(high[1] - low[1] + 1):
            word |= row << np.uint64(16 * z + 4 * y)
    return word


@njit(cache=True, nogil=True)
def store_block(word, di, dj, dk, leaf):  # type: ignore[no-untyped-def]
    """Write a block of 4^3 voxels into its brick, whose words are layers with bit = 8 y + x."""
    for z in range(4):
        for y in range(4):
            row = word >> np.uint64(16 * z + 4 * y) & ROW_BITS
            leaf[dk + z] |= row << np.uint64(8 * (dj + y) + di)


@njit(cache=True, nogil=True)
def count_votes(scene, low, candidates, settled, undecided, pixels):  # type: ignore[no-untyped-def]
    """The rule itself: the candidates that no undecided camera vetoes and that enough cameras see.

    Votes are counted for all 64 voxels at once, in binary: the bits of a voxel's count are its bits in ``ones``,
    ``twos``, ``fours`` and so on.
    """
    ones, twos, fours, eights, more = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
    for slot in range(scene.present.size):
        if undecided >> slot & 1:
            camera = scene.present[slot]
            _pixels_of_block(scene.projections, camera, low, scene.sizes, scene.stride, scene.labels, pixels)
            foreground, blind = _look(scene.labels, camera, pixels)
            candidates &= foreground | blind
            if candidates == 0:
                return candidates
            carry, ones = ones & foreground, ones ^ foreground
            carry, twos = twos & carry, twos ^ carry
            carry, fours = fours & carry, fours ^ carry
            carry, eights = eights & carry, eights ^ carry
            more |= carry
    return candidates & _at_least(scene.min_seeing - settled, ones, twos, fours, eights, more)


@njit(cache=True, nogil=True)
def _at_least(wanted, ones, twos, fours, eights, more):  # type: ignore[no-untyped-def]
    """The voxels whose binary count is at least ``wanted``."""
    above, equal = more, ALL_BITS
    if wanted <= 0:
        return ALL_BITS
    if wanted > 15:
        return above
    for weight, plane in ((8, eights), (4, fours), (2, twos), (1, ones)):
        if wanted & weight:
            equal &= plane
        else:
            above |= equal & plane
    return above | equal


@njit(cache=True, nogil=True, error_model="numpy")
def _pixels_of_block(projections, camera, low, sizes, stride, labels, pixels):  # type: ignore[no-untyped-def]
    """The flat pixel (64,) on which each voxel of a block of 4^3 lies; the last, blind one where there is none."""
    p00, p01, p02 = projections[camera, 0, 0], projections[camera, 0, 1], projections[camera, 0, 2]
    p10, p11, p12 = projections[camera, 1, 0], projections[camera, 1, 1], projections[camera, 1, 2]
    p20, p21, p22 = projections[camera, 2, 0], projections[camera, 2, 1], projections[camera, 2, 2]
    p03, p13, p23 = projections[camera, 0, 3], projections[camera, 1, 3], projections[camera, 2, 3]
    width, height = float(sizes[camera, 0]), float(sizes[camera, 1])
    row_length, outside = np.int32(stride), np.int32(labels.shape[1] - 1)
    x0, y0, z0 = float(low[0]), float(low[1]), float(low[2])
    for voxel in range(64):  # no branch inside: the compiler does eight voxels at a time
        x, y, z = x0 + float(voxel & 3), y0 + float(voxel >> 2 & 3), z0 + float(voxel >> 4)
        w = p20 * x + p21 * y + p22 * z + p23
        inverse = 1.0 / w
        u, v = (p00 * x + p01 * y + p02 * z + p03) * inverse, (p10 * x + p11 * y + p12 * z + p13) * inverse
        on_canvas = (w > 0) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
        pixels[voxel] = np.int32(np.int32(v) * row_length + np.int32(u)) if on_canvas else outside


@njit(cache=True, nogil=True)
def _look(labels, camera, pixels):  # type: ignore[no-untyped-def]
    """What a camera says of 64 voxels: (bits with foreground, bits to which it is blind)."""
    foreground, blind = np.uint64(0), np.uint64(0)
    for voxel in range(64):
        label = np.uint64(labels[camera, np.uint32(pixels[voxel])])
        foreground |= (label & np.uint64(1)) << np.uint64(voxel)
        blind |= (label >> np.uint64(1)) << np.uint64(voxel)
    return foreground, blind
