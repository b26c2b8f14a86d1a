"""Compiled loops of :mod:`.silhouette_residuals`: which foreground do the voxels explain that most cameras agree on?

A voxel is *shared* when at most one voter vetoes it. Shared voxels are projected back into every image: which
foreground do they explain with a camera's veto, and which only without it? In words of bits, bit s is the camera
``cameras[s]``; the voters come first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel
from capture_rig.mask_levels import UNCERTAIN

from ..bitset import lowest_bit, popcount
from ..carving.carve_blocks import ALL_BITS, at_least, count_up, find_pixels, inside_word
from ..carving.pixel_boxes import SEEN, UNSEEN, BlockBoxes, count_in_box, project
from ..carving.silhouette_tables import SURE, UNSURE

UNSEEN_CELL, BACKGROUND_CELL = -1, 0  # labels of cells; foreground cells are numbered from 1
COARSE_EDGE, FINE_EDGE = 16, 4
TOO_MANY = -1
NEEDED_BY = 2  # cameras whose foreground stays unexplained without a voxel: one may show a thing, or noise


class CoarseViews(NamedTuple):
    """Tables of the calibration. Cells are the pixels of every ``stride``-th row and column.

    projections (N, 3, 4) : voxel index to cell, such that the cell is floor(u / w), floor(v / w). voxel_steps (N, 3,
    64) : what each voxel of a block of 4^3 adds to the homogeneous cell of the first. sizes (N, 2) : cells across and
    down. stride : cells in a row of the labels. shape (3,) : the coarse grid. floor_layers : its layers near the floor,
    where shadows lie. coarse, fine : the cells of blocks of 16^3 and 4^3 voxels. reach (N,) : half the size of a voxel
    in the image, in cells times depth.
    """

    projections: npt.NDArray[np.float64]
    voxel_steps: npt.NDArray[np.float64]
    sizes: npt.NDArray[np.int64]
    stride: int
    shape: npt.NDArray[np.int64]
    floor_layers: int
    coarse: BlockBoxes
    fine: BlockBoxes
    reach: npt.NDArray[np.float64]


class Work(NamedTuple):
    """Scratch memory of :func:`find_shared_voxels`: pixels (64,) of a block, and as bits those vetoed (N,)."""

    pixels: npt.NDArray[np.int32]
    vetoed: npt.NDArray[np.uint64]


class VotingSet(NamedTuple):
    """``cameras`` (n,), the first ``voters`` of which can veto; how many must see a voxel that no camera vetoes
    (``needed``), and one that a single camera vetoes (``needed_without``)."""

    cameras: npt.NDArray[np.int64]
    voters: int
    needed: int
    needed_without: int


@kernel
def number_cells(mask, mask_words, stride, cells, box):  # type: ignore[no-untyped-def]
    """Number the foreground cells of one camera's mask (H, W), and sum them up: SURE a cell, UNSURE an uncertain one.

    mask_words (H, W / 8) : the same, eight pixels to a word. cells : seen (h, w), nonzero where the camera sees;
    unshown (h, w), labels where nothing is shown; labels (h, w) and table (h + 1, w + 1), which are written. box (4,) :
    rows and columns from and to that hold all foreground cells of the mask before; then of this one. Returns the number
    of foreground cells.
    """
    seen, unshown, labels, table = cells
    for row in range(box[0], box[1]):
        _copy(unshown[row, box[2] : box[3]], labels[row, box[2] : box[3]])
    found, first, width, shown = 0, stride // 2, labels.shape[1], 0
    box[0], box[1], box[2], box[3] = labels.shape[0], 0, width, 0
    for row in range(labels.shape[0]):
        v, before = first + row * stride, shown
        if _any(mask_words[v]):
            above, areas = table[row], table[row + 1]
            for column in range(width):
                level = mask[v, first + column * stride] & seen[row, column]
                if level:
                    if level == UNCERTAIN:
                        labels[row, column] = UNSEEN_CELL
                    else:
                        found += 1
                        labels[row, column] = found
                    shown += UNSURE if level == UNCERTAIN else SURE
                    box[2], box[3] = min(box[2], column), max(box[3], column + 1)
                areas[column + 1] = above[column + 1] + shown - before
        else:
            _copy(table[row], table[row + 1])
        if shown > before:
            box[0], box[1] = min(box[0], row), row + 1
    return found


@kernel
def _any(words):  # type: ignore[no-untyped-def]
    filled = np.uint64(0)
    for word in range(words.size):
        filled |= words[word]
    return filled != 0


@kernel
def _copy(source, target):  # type: ignore[no-untyped-def]
    for n in range(source.size):
        target[n] = source[n]


@kernel
def find_shared_voxels(views, labels, tables, voting, voxels, vetoes, work):  # type: ignore[no-untyped-def]
    """Write the shared voxels (M, 3) and the bits of who vetoes each (M,); return their number.

    labels (N, cells) : flat, the last one UNSEEN_CELL for all that is outside. work : pixels (64,) and vetoed (N,),
    scratch memory. Returns TOO_MANY when ``voxels`` cannot hold them: much of the volume is foreground for nearly
    everyone.
    """
    coarse, fine = _blocks(views.shape, COARSE_EDGE), _blocks(views.shape, FINE_EDGE)
    ratio, found = COARSE_EDGE // FINE_EDGE, 0
    for block in range(coarse[0] * coarse[1] * coarse[2]):
        votes = _classify_block(views.coarse, tables, voting, block, ((1 << voting.cameras.size) - 1, 0, 0))
        if not _may_be_shared(voting, votes):
            continue
        corner = (
            block % coarse[0] * ratio,
            block // coarse[0] % coarse[1] * ratio,
            block // (coarse[0] * coarse[1]) * ratio,
        )
        for z in range(corner[2], min(corner[2] + ratio, fine[2])):
            for y in range(corner[1], min(corner[1] + ratio, fine[1])):
                for x in range(corner[0], min(corner[0] + ratio, fine[0])):
                    closer = _classify_block(views.fine, tables, voting, (z * fine[1] + y) * fine[0] + x, votes)
                    if _may_be_shared(voting, closer):
                        low = (x * FINE_EDGE, y * FINE_EDGE, z * FINE_EDGE)
                        found = _append_voxels(views, labels, voting, low, closer, voxels, vetoes, found, work)
                        if found == TOO_MANY:
                            return TOO_MANY
    return found


@kernel
def _blocks(shape, edge):  # type: ignore[no-untyped-def]
    """Return the number of blocks along each axis."""
    return (shape[0] + edge - 1) // edge, (shape[1] + edge - 1) // edge, (shape[2] + edge - 1) // edge


@kernel
def _classify_block(boxes, tables, voting, block, votes):  # type: ignore[no-untyped-def]
    """Return the bits of the cameras that are undecided about a block, see foreground all over it, or veto all of it.

    ``votes`` are those of the block around it.
    """
    undecided, filled, vetoed = votes
    for slot in range(voting.cameras.size):
        if undecided >> slot & 1:
            camera, bit = voting.cameras[slot], 1 << slot
            visibility, box = boxes.visibility[camera, block], boxes.pixels[camera, block]
            u0, v0, u1, v1 = int(box[0]), int(box[1]), int(box[2]), int(box[3])
            if visibility == UNSEEN:
                undecided &= ~bit
            elif visibility == SEEN:
                area = count_in_box(tables, camera, u0, v0, u1, v1)
                if area == 0:
                    undecided, vetoed = undecided & ~bit, vetoed | bit
                elif area == SURE * (u1 - u0) * (v1 - v0):
                    undecided, filled = undecided & ~bit, filled | bit
    return undecided, filled, vetoed


@kernel
def _may_be_shared(voting, votes):  # type: ignore[no-untyped-def]
    """Check by the votes on a block whether it may hold shared voxels."""
    undecided, filled, vetoed = votes
    return _count_voters(voting, vetoed) <= 1 and _count_voters(voting, undecided | filled) >= voting.needed_without


@kernel
def _count_voters(voting, bits):  # type: ignore[no-untyped-def]
    return popcount(np.uint64(bits & (1 << voting.voters) - 1))


@kernel
def _append_voxels(views, labels, voting, low, votes, voxels, vetoes, found, work):  # type: ignore[no-untyped-def]
    """Append the shared voxels of the block of 4^3 at ``low``; return the number found so far, or TOO_MANY."""
    left = _classify_voxels(views, labels, voting, low, votes, work) & inside_word(low, views.shape)
    while left:
        bit = lowest_bit(left)
        left &= left - np.uint64(1)
        if found == vetoes.size:
            return TOO_MANY
        voxels[found, 0], voxels[found, 1] = low[0] + (bit & 3), low[1] + (bit >> 2 & 3)
        voxels[found, 2] = low[2] + (bit >> 4)
        vetoes[found] = 0
        for slot in range(voting.cameras.size if voxels[found, 2] >= views.floor_layers else 0):
            vetoes[found] |= np.int64(work.vetoed[slot] >> np.uint64(bit) & np.uint64(1)) << slot
        found += 1
    return found


@kernel
def _classify_voxels(views, labels, voting, low, votes, work):  # type: ignore[no-untyped-def]
    """Return the shared voxels of a block of 4^3 as bits; next to the floor, only those that no voter vetoes.

    Writes those that each camera vetoes to work.vetoed (N,).
    """
    undecided, filled, vetoed = votes
    once, twice = np.uint64(0), np.uint64(0)
    ones, twos, fours, eights, more = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
    for slot in range(voting.cameras.size):
        shown = ALL_BITS if filled >> slot & 1 else np.uint64(0)
        work.vetoed[slot] = ALL_BITS if vetoed >> slot & 1 else np.uint64(0)
        if undecided >> slot & 1:
            camera = voting.cameras[slot]
            find_pixels(views, labels.shape[1] - 1, camera, low, work.pixels)
            background = np.uint64(0)
            for voxel in range(63, -1, -1):
                label = labels[camera, np.uint32(work.pixels[voxel])]
                shown += shown + np.uint64(label > BACKGROUND_CELL)
                background += background + np.uint64(label == BACKGROUND_CELL)
            work.vetoed[slot] = background
        if slot < voting.voters:
            twice |= once & work.vetoed[slot]
            once |= work.vetoed[slot]
            ones, twos, fours, eights, more = count_up(shown, ones, twos, fours, eights, more)
    agreed = ~once & at_least(voting.needed, ones, twos, fours, eights, more)
    alone = once & ~twice & at_least(voting.needed_without, ones, twos, fours, eights, more)
    for z in range(max(min(views.floor_layers - low[2], 4), 0)):
        alone &= ~(np.uint64(0xFFFF) << np.uint64(16 * z))
    return agreed | alone


@kernel
def _footprint(views, camera, voxel):  # type: ignore[no-untyped-def]
    """Return the cells that a voxel (3,) covers in an image: first and last (exclusive) row and column."""
    u, v, w = project(views.projections, camera, voxel[0], voxel[1], voxel[2])
    if w <= 0:
        return 0, 0, 0, 0
    reach, width, height = views.reach[camera] / w, views.sizes[camera, 0], views.sizes[camera, 1]
    top, bottom = int(max(v - reach, 0.0)), int(min(v + reach + 1.0, height))
    return top, bottom, int(max(u - reach, 0.0)), int(min(u + reach + 1.0, width))


@kernel
def mark_explained(views, labels, voting, voxels, vetoes, with_veto, without_veto):  # type: ignore[no-untyped-def]
    """Mark in every camera's foreground cells which hulls lie behind them.

    with_veto, without_veto (n, M) : bit s of a cell is set for the voters' hull with and without the veto of camera s.
    """
    everyone, by_voters = (1 << voting.cameras.size) - 1, (1 << voting.voters) - 1
    for found in range(vetoes.size):
        against = vetoes[found] & by_voters
        kept = everyone & ~vetoes[found] if against == 0 else 0
        reached = everyone if against == 0 else against
        for slot in range(voting.cameras.size):
            camera = voting.cameras[slot]
            top, bottom, left, right = _footprint(views, camera, voxels[found])
            for row in range(top, bottom):
                for column in range(left, right):
                    label = labels[camera, row, column]
                    if label > BACKGROUND_CELL:
                        with_veto[slot, label - 1] |= kept
                        without_veto[slot, label - 1] |= reached


@kernel
def mark_denied(views, labels, voting, slot, voxels, vetoes, with_veto, denied):  # type: ignore[no-untyped-def]
    """Mark the background cells (H, W) of a camera that alone vetoes a voxel which two others' foreground needs."""
    mine, by_others = 1 << slot, ((1 << voting.voters) - 1) & ~(1 << slot)
    for found in range(vetoes.size):
        if vetoes[found] & mine == 0 or vetoes[found] & by_others:
            continue
        needed_by = 0
        for other in range(voting.cameras.size):
            camera = voting.cameras[other]
            u, v, _ = project(views.projections, camera, voxels[found, 0], voxels[found, 1], voxels[found, 2])
            if other != slot and u >= 0 and v >= 0 and u < views.sizes[camera, 0] and v < views.sizes[camera, 1]:
                label = labels[camera, int(v), int(u)]
                needed_by += label > BACKGROUND_CELL and with_veto[other, label - 1] & mine == 0
        if needed_by >= NEEDED_BY:
            top, bottom, left, right = _footprint(views, voting.cameras[slot], voxels[found])
            for row in range(top, bottom):
                for column in range(left, right):
                    denied[row, column] |= labels[voting.cameras[slot], row, column] == BACKGROUND_CELL


@kernel
def count_explained(cells, with_veto, without_veto, explained, vetoed):  # type: ignore[no-untyped-def]
    """Count foreground cells (n, n) [image, camera whose veto is ignored].

    explained : by the hull without that camera's veto. vetoed : of these, those that the hull with its veto leaves.
    """
    for image in range(cells.size):
        for cell in range(cells[image]):
            reached, kept = without_veto[image, cell], with_veto[image, cell]
            for slot in range(cells.size):
                explained[image, slot] += reached >> slot & 1
                vetoed[image, slot] += (reached & ~kept) >> slot & 1
