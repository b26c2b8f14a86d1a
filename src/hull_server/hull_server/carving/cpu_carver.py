"""Carves on the CPU: the exact hierarchical carve in float64. Needs no graphics hardware or driver.

Blocks of 32, 8 and 4 voxels are classified by summed-area tables, and single voxels only where a block is mixed. For a
camera and a block there are three outcomes: the camera sees every voxel of the block and none is foreground (the block
is empty); it sees every voxel and all are foreground, or it sees none (settled: inside the block the camera is not
tested again); anything else (undecided: tested again, closer). A camera settled as foreground counts as seeing.

Sets of cameras are words whose bit s stands for camera ``scene.present[s]``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel

from ..grid import BrickVolume, VoxelGrid
from ..silhouette_batch import SilhouetteBatch, SummedSquares
from ..views import Boxes, Masks, RigViews
from .carve_blocks import (
    EVERY_OCTANT,
    classify_octants,
    count_votes,
    inside_word,
    octant_steps,
    octants_inside,
    store_block,
    voxel_steps,
)
from .pixel_boxes import SEEN, UNSEEN, BlockBoxes, block_boxes, foreground_in, pixel_projections, summed_area

COARSE_EDGE, BRICK_EDGE = 32, 8
EMPTY = -1


class CpuCarver:
    """Carves on one core; tables of the calibration are computed once. One thread at a time."""

    name = "cpu"
    device = "one CPU core"

    def __init__(self, views: RigViews, grid: VoxelGrid) -> None:
        self.views, self.grid = views, grid
        projections, seen_table = pixel_projections(views, grid), summed_area(views.seen)
        self._coarse = block_boxes(views, grid, COARSE_EDGE, seen_table)
        self._bricks = block_boxes(views, grid, BRICK_EDGE, seen_table)
        self._batch, self._squares = SilhouetteBatch(views.seen, outside=8), SummedSquares(views.seen)
        self._scene = CarveInputs(
            projections=projections,
            voxel_steps=voxel_steps(projections),
            octant_steps=octant_steps(projections),
            sizes=views.sizes,
            seen_table=seen_table,
            levels=self._batch.flat,
            stride=views.seen.shape[2],
            foreground_box=self._batch.box,
            foreground_table=self._squares.table,
            present=np.empty(0, np.int64),
            min_seeing=0,
            vetoes=0,
            shape=np.array(grid.shape, np.int64),
        )
        self._index = np.empty(grid.brick_count, np.uint32)
        self._leaves = np.empty((grid.brick_count, BRICK_EDGE), np.uint64)
        self._work = Work.make(len(views.names), self._coarse.visibility.shape[1])

    def carve(self, masks: Masks, min_seeing: int, boxes: Boxes | None = None, vetoes: int = 0) -> BrickVolume:
        """Carve the silhouettes of one frame set, by the rule of :mod:`hull_server.views`.

        masks : one canvas mask (h, w) uint8 a camera; absent cameras do not count. vetoes : how many cameras may veto a
        voxel that is occupied nevertheless, 0 or 1.
        Raises InputError for an unknown camera or a mask of another size.
        """
        present, filled = self.views.present(masks), []
        for camera in present:
            name = self.views.names[camera]
            self._batch.load(camera, masks[name], (boxes or {}).get(name))
            filled.append(self._squares.fill(camera, self._batch.words[camera], self._batch.box[camera]))
        cameras = present[np.argsort(filled, kind="stable")]  # those with little foreground empty most blocks
        scene = self._scene._replace(present=cameras, min_seeing=min_seeing, vetoes=vetoes)
        found = carve(scene, self._coarse, self._bricks, self._index, self._leaves, self._work)
        return BrickVolume(self.grid, self._index[:found].copy(), self._leaves[:found].copy())

    def close(self) -> None:
        """Nothing to release."""


class CarveInputs(NamedTuple):
    """The calibration (fixed) and the silhouettes of one frame set.

    projections (N, 3, 4): voxel index to pixel. sizes (N, 2): canvases. seen_table (N, H + 1, W + 1).
    voxel_steps (N, 3, 64), octant_steps (N, 3, 64): see :mod:`.carve_blocks`.
    levels (N, H * W + 8): the level of every pixel, and BLIND for all that lies outside.
    stride: W. foreground_box (N, 4): u, v from and to of a box that holds all foreground pixels.
    foreground_table: the summed areas inside that box, of :class:`SummedSquares`.
    present (n,): cameras of this frame set, in the order in which they are tested; the result does not depend on it.
    min_seeing: cameras that must see a voxel. vetoes: how many may veto it nevertheless, 0 or 1. shape (3,): the grid.
    """

    projections: npt.NDArray[np.float64]
    voxel_steps: npt.NDArray[np.float64]
    octant_steps: npt.NDArray[np.float32]
    sizes: npt.NDArray[np.int64]
    seen_table: npt.NDArray[np.int32]
    levels: npt.NDArray[np.uint8]
    stride: int
    foreground_box: npt.NDArray[np.int64]
    foreground_table: npt.NDArray[np.int32]
    present: npt.NDArray[np.int64]
    min_seeing: int
    vetoes: int
    shape: npt.NDArray[np.int64]


class Work(NamedTuple):
    """Scratch memory.

    states (coarse blocks, 2): how many cameras are settled about a block (or EMPTY), and the set of the undecided.
    corners (128,), octant_box (40,), pixels (64,): see :mod:`.carve_blocks`.
    possible, settled (8,): of each octant of a brick, how many cameras may be, and are, settled as foreground.
    mixed (N,): the octants about which a camera is undecided, as bits.
    """

    states: npt.NDArray[np.int64]
    corners: npt.NDArray[np.float32]
    octant_box: npt.NDArray[np.int32]
    pixels: npt.NDArray[np.int32]
    possible: npt.NDArray[np.int64]
    settled: npt.NDArray[np.int64]
    mixed: npt.NDArray[np.int64]

    @classmethod
    def make(cls, cameras: int, coarse_blocks: int) -> Work:
        return cls(
            states=np.empty((coarse_blocks, 2), np.int64),
            corners=np.empty(128, np.float32),
            octant_box=np.empty(40, np.int32),
            pixels=np.empty(64, np.int32),
            possible=np.empty(8, np.int64),
            settled=np.empty(8, np.int64),
            mixed=np.empty(cameras, np.int64),
        )


@kernel
def carve(scene: CarveInputs, coarse: BlockBoxes, bricks: BlockBoxes, index, leaves, work: Work):  # type: ignore[no-untyped-def]
    """Write the occupied bricks to ``index`` (k,), ascending, and ``leaves`` (k, 8); return k."""
    everyone = (1 << scene.present.size) - 1
    for block in range(work.states.shape[0]):
        work.states[block, 0], work.states[block, 1], _ = _classify(scene, coarse, block, 0, everyone)
    found = 0
    for z in range((scene.shape[2] + 7) // 8):
        for y in range((scene.shape[1] + 7) // 8):
            found = _carve_row(scene, bricks, y, z, index, leaves, found, work)
    return found


@kernel
def _carve_row(scene, bricks, y, z, index, leaves, found, work):  # type: ignore[no-untyped-def]
    """Carve a row of bricks along x; return the number of bricks found so far."""
    nx, ny = (scene.shape[0] + 7) // 8, (scene.shape[1] + 7) // 8
    coarse_nx, coarse_ny = (nx + 3) // 4, (ny + 3) // 4
    for coarse_x in range(coarse_nx):
        block = (z // 4 * coarse_ny + y // 4) * coarse_nx + coarse_x
        settled, undecided = work.states[block, 0], work.states[block, 1]
        if settled == EMPTY:
            continue
        for x in range(4 * coarse_x, min(4 * coarse_x + 4, nx)):
            brick = (z * ny + y) * nx + x
            state = _classify(scene, bricks, brick, settled, undecided)
            if state[0] != EMPTY and _carve_brick(scene, (8 * x, 8 * y, 8 * z), state, leaves[found], work):
                index[found] = brick
                found += 1
    return found


@kernel
def _classify(scene, boxes, block, settled, undecided):  # type: ignore[no-untyped-def]
    """Classify a block by the cameras still undecided about the block around it.

    Returns the number of cameras settled as foreground (or EMPTY), the bits of those undecided, and the bits of those
    that may be blind to some of its voxels.
    """
    possible, partly_blind, vetoes = settled, 0, 0
    for slot in range(scene.present.size):
        if undecided >> slot & 1:
            camera, bit = scene.present[slot], 1 << slot
            visibility = boxes.visibility[camera, block]
            u0, v0 = np.int64(boxes.pixels[camera, block, 0]), np.int64(boxes.pixels[camera, block, 1])
            u1, v1 = np.int64(boxes.pixels[camera, block, 2]), np.int64(boxes.pixels[camera, block, 3])
            some, whole = foreground_in(scene.foreground_box, scene.foreground_table, camera, u0, v0, u1, v1)
            vetoes += visibility == SEEN and not some
            if vetoes > scene.vetoes:
                return EMPTY, 0, 0
            possible += some
            all_foreground = visibility == SEEN and whole
            settled += all_foreground
            undecided &= ~(bit * (all_foreground or visibility == UNSEEN))
            partly_blind |= bit * (visibility != SEEN)
    if possible < scene.min_seeing:
        return EMPTY, 0, 0
    return settled, undecided, partly_blind


@kernel
def _carve_brick(scene, corner, state, leaf, work):  # type: ignore[no-untyped-def]
    """Carve the brick at voxel ``corner`` into its eight words; return whether any voxel is occupied."""
    octants = octants_inside(corner, scene.shape) & _classify_octants(scene, corner, state, work)
    leaf[:] = 0
    occupied = False
    for octant in range(8):
        if octants >> octant & 1 and work.possible[octant] >= scene.min_seeing:
            low = (corner[0] + (octant & 1) * 4, corner[1] + (octant >> 1 & 1) * 4, corner[2] + (octant >> 2) * 4)
            inside, settled = inside_word(low, scene.shape), work.settled[octant]
            word = count_votes(scene, low, octant, inside, settled, work.mixed, work)
            occupied |= word != 0
            store_block(word, octant, leaf)
    return occupied


@kernel
def _classify_octants(scene, corner, state, work):  # type: ignore[no-untyped-def]
    """Classify the octants of a brick by the cameras undecided about it; return the bits of those that are not empty.

    Writes for each octant the number of cameras settled as foreground and of those that may be, and for each camera
    the octants about which it remains undecided.
    """
    settled, undecided, partly_blind = state
    work.possible[:] = settled
    work.settled[:] = settled
    left, once = EVERY_OCTANT, 0 if scene.vetoes else EVERY_OCTANT  # that one more veto empties
    for slot in range(scene.present.size):
        work.mixed[slot] = 0
        if undecided >> slot & 1:
            some, whole, seen, unseen = classify_octants(
                scene, scene.present[slot], corner, not partly_blind >> slot & 1, work
            )
            left &= ~(seen & ~some & once)
            once |= seen & ~some
            if left == 0:
                return left
            for octant in range(8):
                work.possible[octant] += some >> octant & 1
                work.settled[octant] += whole >> octant & 1
            work.mixed[slot] = EVERY_OCTANT & ~(whole | unseen)
    return left
