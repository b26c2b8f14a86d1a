"""Carves the eight blocks of 4 x 4 x 4 voxels of a brick: first classified all at once, then voxel by voxel.

Octants are the blocks of a brick: octant = 4 z + 2 y + x. The voxels of a block are one word of 64 bits: bit = 16 z + 4
y + x.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel

from .pixel_boxes import count_in_box, foreground_in

EVERY_OCTANT, ALL_BITS = 255, np.uint64(0xFFFFFFFFFFFFFFFF)
# Thresholds: from the rounding of single precision; python bench/hull.py --quick counts differences from float64.
DEPTH_RATIO = 4.0  # a brick whose far end is farther than this many times its near end is carved voxel by voxel
MARGIN = np.float32(1e-5)  # of the coordinates: rounding in single precision, at such depths, is a third of it at most


def octant_steps(projections: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Return the offsets (N, 3, 64) of an octant's corner voxels (8 corner + octant) in the brick's homogeneous
    pixels."""
    lane = np.arange(64)
    offsets = [4 * (lane >> axis & 1) + 3 * (lane >> 3 + axis & 1) for axis in range(3)]
    return np.ascontiguousarray(projections[:, :, :3] @ np.stack(offsets).astype(float)).astype(np.float32)


@kernel
def octants_inside(corner, shape):  # type: ignore[no-untyped-def]
    """Return the bits of the octants of the brick at voxel ``corner`` that begin inside the grid."""
    inside = EVERY_OCTANT
    if corner[0] + 4 >= shape[0]:
        inside &= 0b01010101
    if corner[1] + 4 >= shape[1]:
        inside &= 0b00110011
    if corner[2] + 4 >= shape[2]:
        inside &= 0b00001111
    return inside


@kernel
def classify_octants(scene, camera, corner, sees_all, work):  # type: ignore[no-untyped-def]
    """Classify the octants of the brick at voxel ``corner`` in one camera: four words of eight bits.

    Returns the octants that may hold foreground; those that are all foreground and seen; those seen whole;
    those not seen at all. ``sees_all``: the camera is known to see the whole brick.
    """
    if not _project_corners(scene, camera, corner, work.corners):
        return EVERY_OCTANT, 0, 0, 0
    box = work.octant_box
    _enclose_octants(scene.sizes, camera, work.corners, box)
    some, whole, seen, unseen = 0, 0, EVERY_OCTANT, 0
    for octant in range(8):
        u0, v0, u1, v1 = box[octant], box[8 + octant], box[16 + octant], box[24 + octant]
        any_, all_ = foreground_in(scene.foreground_box, scene.foreground_table, camera, u0, v0, u1, v1)
        some |= any_ << octant
        whole |= all_ << octant
    if not sees_all:
        for octant in range(8):
            u0, v0, u1, v1 = box[octant], box[8 + octant], box[16 + octant], box[24 + octant]
            visible = count_in_box(scene.seen_table, camera, u0, v0, u1, v1)
            unseen |= (visible == 0) << octant
            seen &= ~((box[32 + octant] == 0 or visible != (u1 - u0) * (v1 - v0)) << octant)
    return some, whole & seen, seen, unseen


@kernel
def _project_corners(scene, camera, corner, corners):  # type: ignore[no-untyped-def]
    """Write u (64,) and v (64,) of the octants' corner voxels to ``corners``; False when their depths are too unlike.

    Value 8 corner + octant; the first is that of the brick's own first voxel.
    """
    P, steps = scene.projections[camera], scene.octant_steps[camera]
    x, y, z = float(corner[0]), float(corner[1]), float(corner[2])
    w = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
    nearest = w + 7.0 * (min(P[2, 0], 0.0) + min(P[2, 1], 0.0) + min(P[2, 2], 0.0))
    farthest = w + 7.0 * (max(P[2, 0], 0.0) + max(P[2, 1], 0.0) + max(P[2, 2], 0.0))
    if DEPTH_RATIO * nearest <= farthest:
        return False
    u0 = np.float32(P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3])
    v0 = np.float32(P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3])
    w0 = np.float32(w)
    for lane in range(64):  # no branch inside: the compiler does eight corners at a time
        inverse = np.float32(1) / (w0 + steps[2, lane])
        corners[lane] = (u0 + steps[0, lane]) * inverse
        corners[64 + lane] = (v0 + steps[1, lane]) * inverse
    return True


@kernel
def _enclose_octants(sizes, camera, corners, box):  # type: ignore[no-untyped-def]
    """Write the octants' pixel boxes on the canvas to ``box``: five times eight values.

    These are u and v from (inclusive), u and v to (exclusive), and whether nothing was cut off.
    """
    width, height, zero, one = np.float32(sizes[camera, 0]), np.float32(sizes[camera, 1]), np.float32(0), np.float32(1)
    margin = MARGIN * (max(width, height) + abs(corners[0]) + abs(corners[64]))
    for octant in range(
        box.size // 5
    ):  # eight; as a constant, the compiler would unroll the loop instead of vectorising it
        low_u, low_v = _least(corners, octant) - margin, _least(corners, 64 + octant) - margin
        high_u, high_v = _greatest(corners, octant) + margin, _greatest(corners, 64 + octant) + margin
        box[32 + octant] = (low_u >= zero) & (low_v >= zero) & (high_u < width) & (high_v < height)
        box[octant] = np.int32(_smaller(_larger(low_u, zero), width))
        box[8 + octant] = np.int32(_smaller(_larger(low_v, zero), height))
        box[16 + octant] = np.int32(_smaller(_larger(high_u + one, zero), width))
        box[24 + octant] = np.int32(_smaller(_larger(high_v + one, zero), height))


@kernel
def _least(values, first):  # type: ignore[no-untyped-def]
    """Return the least of eight values, eight places apart."""
    least = values[first]
    for place in range(8, 64, 8):
        least = _smaller(least, values[first + place])
    return least


@kernel
def _greatest(values, first):  # type: ignore[no-untyped-def]
    """Return the greatest of eight values, eight places apart."""
    greatest = values[first]
    for place in range(8, 64, 8):
        greatest = _larger(greatest, values[first + place])
    return greatest


@kernel
def _smaller(a, b):  # type: ignore[no-untyped-def]
    return a if a < b else b


@kernel
def _larger(a, b):  # type: ignore[no-untyped-def]
    return a if a > b else b


def voxel_steps(projections: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the offset (N, 3, 64) of each voxel of a block from the homogeneous pixel of the block's first voxel."""
    bit = np.arange(64)
    return np.ascontiguousarray(projections[:, :, :3] @ np.stack([bit & 3, bit >> 2 & 3, bit >> 4]).astype(float))


@kernel
def inside_word(low, shape):  # type: ignore[no-untyped-def]
    """Return the bits of the block of 4^3 voxels at voxel ``low`` that lie inside the grid."""
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
def count_votes(scene, low, octant, candidates, settled, mixed, work):  # type: ignore[no-untyped-def]
    """Apply the rule: return the candidates that too few undecided cameras veto and enough cameras see.

    The block is the given octant of a brick, at voxel ``low``. Undecided are the cameras with the octant's bit in
    ``mixed`` (n,). Votes are counted for all 64 voxels at once, in binary: the bits of a voxel's count are its bits
    in ``ones``, ``twos``, ``fours`` and so on.
    """
    ones, twos, fours, eights, more = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
    once = np.uint64(0) if scene.vetoes else ALL_BITS  # that one more veto empties
    for slot in range(scene.present.size):
        if mixed[slot] >> octant & 1:
            camera = scene.present[slot]
            find_pixels(scene, scene.levels.shape[1] - 1, camera, low, work.pixels)
            foreground, allowed = _read_levels(scene.levels, camera, work.pixels)
            candidates &= allowed | ~once
            once |= ~allowed
            if candidates == 0:
                break
            ones, twos, fours, eights, more = count_up(foreground, ones, twos, fours, eights, more)
    return candidates & at_least(scene.min_seeing - settled, ones, twos, fours, eights, more)


@kernel
def count_up(word, ones, twos, fours, eights, more):  # type: ignore[no-untyped-def]
    """Add 1 to the binary counts of the voxels of a word."""
    carry, ones = ones & word, ones ^ word
    carry, twos = twos & carry, twos ^ carry
    carry, fours = fours & carry, fours ^ carry
    carry, eights = eights & carry, eights ^ carry
    return ones, twos, fours, eights, more | carry


@kernel
def at_least(wanted, ones, twos, fours, eights, more):  # type: ignore[no-untyped-def]
    """Return the voxels whose binary count is at least ``wanted``."""
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
def find_pixels(scene, outside, camera, low, pixels):  # type: ignore[no-untyped-def]
    """Write the flat pixel (64,) of each voxel of a block of 4^3; ``outside`` where it is beyond the canvas."""
    P, steps = scene.projections[camera], scene.voxel_steps[camera]
    x, y, z = float(low[0]), float(low[1]), float(low[2])
    u0 = P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]
    v0 = P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]
    w0 = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
    width, height = float(scene.sizes[camera, 0]), float(scene.sizes[camera, 1])
    stride, outside = float(scene.stride), np.int32(outside)
    for voxel in range(64):  # no branch inside: the compiler does several voxels at a time
        w = w0 + steps[2, voxel]
        inverse = 1.0 / w
        u, v = (u0 + steps[0, voxel]) * inverse, (v0 + steps[1, voxel]) * inverse
        on_canvas = (w > 0) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
        pixels[voxel] = np.int32(math.floor(v) * stride + math.floor(u)) if on_canvas else outside


@kernel
def _read_levels(levels, camera, pixels):  # type: ignore[no-untyped-def]
    """Return the voxels (one word each) whose pixel is foreground, and those whose pixel is not background."""
    foreground, allowed = np.uint64(0), np.uint64(0)
    for voxel in range(63, -1, -1):
        level = np.uint64(levels[camera, np.uint32(pixels[voxel])])
        foreground += foreground + (level >> np.uint64(7))
        allowed += allowed + (level + np.uint64(255) >> np.uint64(8))
    return foreground, allowed
