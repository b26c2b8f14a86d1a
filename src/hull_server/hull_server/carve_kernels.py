"""The exact carve on the CPU: blocks of 32, 8 and 4 voxels judged by summed-area tables, voxels only where mixed.

For a camera and a block there are three outcomes: it sees every voxel of the block and none is foreground (the block
is empty); it sees every voxel and all are foreground, or it sees none at all (settled: no need to look again inside
the block); anything else (undecided: look again, closer). A camera settled as foreground counts as seeing.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .boxes import SEEN, UNSEEN, BlockBoxes, judge_sight, project_block
from .carve_scene import Scene
from .carve_votes import count_votes, inside_word, store_block

COARSE_EDGE, BRICK_EDGE = 32, 8
EMPTY = -1


@njit(cache=True, nogil=True)
def carve(scene: Scene, coarse: BlockBoxes, bricks: BlockBoxes, index, leaves):  # type: ignore[no-untyped-def]
    """Write the occupied bricks to ``index`` (k,) and ``leaves`` (k, 8), in no particular order; return k."""
    shape = scene.shape
    nx, ny, nz = (shape[0] + 31) // 32, (shape[1] + 31) // 32, (shape[2] + 31) // 32
    everyone = (1 << scene.present.size) - 1
    pixels = np.empty(64, np.int32)
    found = 0
    for block in range(nx * ny * nz):
        settled, undecided, _ = _judge(scene, coarse, block, 0, everyone)
        if settled != EMPTY:
            corner = (block % nx * 4, block // nx % ny * 4, block // (nx * ny) * 4)
            found = _carve_coarse_block(scene, bricks, corner, settled, undecided, index, leaves, found, pixels)
    return found


@njit(cache=True, nogil=True)
def _carve_coarse_block(scene, bricks, corner, settled, undecided, index, leaves, found, pixels):  # type: ignore[no-untyped-def]
    """Carve the up to 4 x 4 x 4 bricks from brick ``corner``; return the number of bricks found so far."""
    nx, ny, nz = (scene.shape[0] + 7) // 8, (scene.shape[1] + 7) // 8, (scene.shape[2] + 7) // 8
    for z in range(corner[2], min(corner[2] + 4, nz)):
        for y in range(corner[1], min(corner[1] + 4, ny)):
            for x in range(corner[0], min(corner[0] + 4, nx)):
                brick = (z * ny + y) * nx + x
                verdict = _judge(scene, bricks, brick, settled, undecided)
                if verdict[0] != EMPTY and _carve_brick(scene, (x * 8, y * 8, z * 8), verdict, leaves[found], pixels):
                    index[found] = brick
                    found += 1
    return found


@njit(cache=True, nogil=True)
def _judge(scene, boxes, block, settled, undecided):  # type: ignore[no-untyped-def]
    """Judge a block by the cameras still undecided about the block around it.

    Returns the number of cameras settled as foreground (or EMPTY), the bits of those undecided, and the bits of those
    that may be blind to some of its voxels.
    """
    possible, partly_blind = settled, 0
    for slot in range(scene.present.size):
        if undecided >> slot & 1:
            camera, bit = scene.present[slot], 1 << slot
            sight = boxes.sight[block, camera]
            u0, v0 = boxes.pixels[block, camera, 0], boxes.pixels[block, camera, 1]
            u1, v1 = boxes.pixels[block, camera, 2], boxes.pixels[block, camera, 3]
            filled = _foreground_in(scene.foreground_box, scene.foreground_table, camera, u0, v0, u1, v1)
            if sight == SEEN and filled == 0:
                return EMPTY, 0, 0
            possible += filled > 0
            all_foreground = sight == SEEN and filled == (int(u1) - u0) * (int(v1) - v0)
            settled += all_foreground
            undecided &= ~(bit * (all_foreground or sight == UNSEEN))
            partly_blind |= bit * (sight != SEEN)
    if possible < scene.min_seeing:
        return EMPTY, 0, 0
    return settled, undecided, partly_blind


@njit(cache=True, nogil=True)
def _judge_fine(scene, low, high, verdict):  # type: ignore[no-untyped-def]
    """As _judge, for the few voxels from ``low`` to ``high`` (inclusive), whose boxes are computed on the spot.

    ``verdict`` is that of the brick around them: what it sees whole, it sees whole here.
    """
    settled, undecided, partly_blind = verdict
    possible = settled
    for slot in range(scene.present.size):
        if undecided >> slot & 1:
            camera, bit = scene.present[slot], 1 << slot
            u0, v0, u1, v1, inside = project_block(scene.projections, camera, low, high, scene.sizes)
            sight = SEEN
            if partly_blind & bit:
                sight = judge_sight(scene.seen_table, camera, u0, v0, u1, v1, inside)
            filled = _foreground_in(scene.foreground_box, scene.foreground_table, camera, u0, v0, u1, v1)
            if sight == SEEN and filled == 0:
                return EMPTY, 0
            possible += filled > 0
            all_foreground = sight == SEEN and filled == (u1 - u0) * (v1 - v0)
            settled += all_foreground
            undecided &= ~(bit * (all_foreground or sight == UNSEEN))
    if possible < scene.min_seeing:
        return EMPTY, 0
    return settled, undecided


@njit(cache=True, nogil=True)
def _foreground_in(boxes, tables, camera, u0, v0, u1, v1):  # type: ignore[no-untyped-def]
    """Foreground pixels of a camera in a pixel box."""
    left, top = boxes[camera, 0], boxes[camera, 1]
    a0, b0 = max(u0, left) - left, max(v0, top) - top
    a1, b1 = min(u1, boxes[camera, 2]) - left, min(v1, boxes[camera, 3]) - top
    if a1 <= a0 or b1 <= b0:
        return 0
    return tables[camera, b1, a1] - tables[camera, b0, a1] - tables[camera, b1, a0] + tables[camera, b0, a0]


@njit(cache=True, nogil=True)
def _carve_brick(scene, corner, verdict, leaf, pixels):  # type: ignore[no-untyped-def]
    """Carve the brick at voxel ``corner`` into its eight words; return whether any voxel is occupied."""
    leaf[:] = 0
    occupied = False
    for octant in range(8):
        di, dj, dk = (octant & 1) * 4, (octant >> 1 & 1) * 4, (octant >> 2) * 4
        low = (corner[0] + di, corner[1] + dj, corner[2] + dk)
        high = (min(low[0] + 4, scene.shape[0]) - 1, min(low[1] + 4, scene.shape[1]) - 1,
                min(low[2] + 4, scene.shape[2]) - 1)  # fmt: skip
        if high[0] < low[0] or high[1] < low[1] or high[2] < low[2]:
            continue
        settled, undecided, _ = verdict
        if undecided != 0:
            settled, undecided = _judge_fine(scene, low, high, verdict)
        if settled != EMPTY:
            word = inside_word(low, high)
            if undecided != 0:
                word = count_votes(scene, low, word, settled, undecided, pixels)
            occupied |= word != 0
            store_block(word, di, dj, dk, leaf)
    return occupied
