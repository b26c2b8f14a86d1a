"""The rule itself, for blocks of 4 x 4 x 4 voxels at once: one word of 64 bits, bit = 16 z + 4 y + x."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ..kernel import kernel
from .carve_scene import BLIND, FOREGROUND

ALL_BITS = np.uint64(0xFFFFFFFFFFFFFFFF)


def voxel_steps(projections: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(N, 3, 64) what each voxel of a block adds to the homogeneous pixel of the block's first voxel."""
    bit = np.arange(64)
    return np.ascontiguousarray(projections[:, :, :3] @ np.stack([bit & 3, bit >> 2 & 3, bit >> 4]).astype(float))


@kernel
def inside_word(low, shape):  # type: ignore[no-untyped-def]
    """The bits of the block of 4^3 voxels at voxel ``low`` that lie inside the grid."""
    nx, ny, nz = min(shape[0] - low[0], 4), min(shape[1] - low[1], 4), min(shape[2] - low[2], 4)
    if nx == 4 and ny == 4 and nz == 4:
        return ALL_BITS
    row = (np.uint64(1) << np.uint64(nx)) - np.uint64(1)
    word = np.uint64(0)
    for z in range(nz):
        for y in range(ny):
            word |= row << np.uint64(16 * z + 4 * y)
    return word


@kernel
def store_block(word, octant, leaf):  # type: ignore[no-untyped-def]
    """Write a block of 4^3 voxels into its octant of a brick, whose words are layers with bit = 8 y + x."""
    shift = np.uint64((octant & 1) * 4 + (octant >> 1 & 1) * 32)
    for z in range(4):
        rows = word >> np.uint64(16 * z) & np.uint64(0xFFFF)
        rows = (rows | rows << np.uint64(8)) & np.uint64(0x00FF00FF)
        rows = (rows | rows << np.uint64(4)) & np.uint64(0x0F0F0F0F)
        leaf[(octant >> 2) * 4 + z] |= rows << shift


@kernel
def count_votes(scene, low, octant, candidates, settled, mixed, partly_blind, work):  # type: ignore[no-untyped-def]
    """The rule itself: the candidates that no undecided camera vetoes and that enough cameras see.

    The block is the given octant of a brick, at voxel ``low``. Undecided are the cameras with the octant's bit in
    ``mixed`` (n,). Votes are counted for all 64 voxels at once, in binary: the bits of a voxel's count are its bits
    in ``ones``, ``twos``, ``fours`` and so on.
    """
    ones, twos, fours, eights, more = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
    for slot in range(scene.present.size):
        if mixed[slot] >> octant & 1:
            camera = scene.present[slot]
            _find_pixels(scene, camera, low, work.pixels)
            foreground, blind = _look(scene.labels, camera, work.pixels, FOREGROUND), np.uint64(0)
            if partly_blind >> slot & 1:
                blind = _look(scene.labels, camera, work.pixels, BLIND)
            candidates &= foreground | blind
            if candidates == 0:
                break
            carry, ones = ones & foreground, ones ^ foreground
            carry, twos = twos & carry, twos ^ carry
            carry, fours = fours & carry, fours ^ carry
            carry, eights = eights & carry, eights ^ carry
            more |= carry
    return candidates & _at_least(scene.min_seeing - settled, ones, twos, fours, eights, more)


@kernel
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


@kernel
def _find_pixels(scene, camera, low, pixels):  # type: ignore[no-untyped-def]
    """The flat pixel (64,) on which each voxel of a block of 4^3 lies; one beyond the canvas where there is none."""
    P, steps = scene.projections[camera], scene.voxel_steps[camera]
    x, y, z = float(low[0]), float(low[1]), float(low[2])
    u0 = P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]
    v0 = P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]
    w0 = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
    width, height = float(scene.sizes[camera, 0]), float(scene.sizes[camera, 1])
    stride, outside = float(scene.stride), np.int32(scene.labels.shape[1] - 1)
    for voxel in range(64):  # no branch inside: the compiler does several voxels at a time
        w = w0 + steps[2, voxel]
        inverse = 1.0 / w
        u, v = (u0 + steps[0, voxel]) * inverse, (v0 + steps[1, voxel]) * inverse
        on_canvas = (w > 0) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
        pixels[voxel] = np.int32(math.floor(v) * stride + math.floor(u)) if on_canvas else outside


@kernel
def _look(labels, camera, pixels, label):  # type: ignore[no-untyped-def]
    """The voxels (one word) whose pixel has a label."""
    word = np.uint64(0)
    for voxel in range(63, -1, -1):
        word += word + ((labels[camera, np.uint32(pixels[voxel])] >> np.uint64(label >> 1)) & np.uint64(1))
    return word
