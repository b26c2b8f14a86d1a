"""What every camera says of what the others agree on, counted on a coarse grid in a few passes.

A voxel is *shared* when at most one camera of the panel vetoes it. Shared voxels are projected back into every picture:
which foreground do they explain with a camera's veto obeyed, and which only with it ignored? In the words of bits here,
bit s is the camera ``cameras[s]``; the panel, whose vetoes count, comes first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from ..carving.pixel_boxes import SEEN, UNSEEN, BlockBoxes

UNSEEN_CELL, BACKGROUND_CELL = -1, 0  # labels of cells; foreground cells are numbered from 1
COARSE_EDGE, FINE_EDGE = 16, 4
TOO_MANY = -1


class Room(NamedTuple):
    """What depends on the calibration only. Cells are the pixels of every ``stride``-th row and column.

    projections (N, 3, 4) : voxel index to cell, such that the cell is floor(u / w), floor(v / w).
    sizes (N, 2) : cells across and down.
    shape (3,) : the coarse grid. low_layers : its layers next to the floor, where shadows lie.
    coarse, fine : the cells of blocks of 16^3 and 4^3 voxels. reach (N,) : cells, times the depth, by which a voxel's
    picture reaches beyond its centre's.
    """

    projections: npt.NDArray[np.float64]
    sizes: npt.NDArray[np.int64]
    shape: npt.NDArray[np.int64]
    low_layers: int
    coarse: BlockBoxes
    fine: BlockBoxes
    reach: npt.NDArray[np.float64]


class Question(NamedTuple):
    """What one hearing asks: ``cameras`` (n,), the first ``panel`` of which have a veto, and how many must see a voxel
    that nobody, or only one camera, vetoes."""

    cameras: npt.NDArray[np.int64]
    panel: int
    needed: int
    needed_without: int


@njit(cache=True, nogil=True)
def number_cells(shown, box, labels, table):  # type: ignore[no-untyped-def]
    """Number the foreground cells of one camera, and sum up their areas.

    shown (h, w) : nonzero is foreground, all of it inside ``box``: u and v from and to. labels (h, w) : as they are
    where nothing is shown. table (h + 1, w + 1). Returns the number of cells, and a number that changes when they do.
    """
    left, top, right, bottom = box
    found, fingerprint = 0, 0
    table[: top + 1] = 0
    for row in range(top, bottom):
        in_row = 0
        table[row + 1, : left + 1] = 0
        for column in range(left, right):
            if shown[row, column] != 0:
                found += 1
                in_row += 1
                labels[row, column] = found
                fingerprint = fingerprint * 31 + row * 4096 + column
            table[row + 1, column + 1] = table[row, column + 1] + in_row
        table[row + 1, right + 1 :] = table[row + 1, right]
    for row in range(bottom, shown.shape[0]):
        table[row + 1] = table[row]
    return found, fingerprint


@njit(cache=True, nogil=True)
def find_shared(room, labels, tables, question, voxels, vetoes):  # type: ignore[no-untyped-def]
    """Write the shared voxels (M, 3) and the bits of who vetoes each (M,); return their number.

    Returns TOO_MANY when ``voxels`` cannot hold them: much of the volume is foreground for nearly everyone.
    """
    coarse, fine = (room.shape + COARSE_EDGE - 1) // COARSE_EDGE, (room.shape + FINE_EDGE - 1) // FINE_EDGE
    ratio, found = COARSE_EDGE // FINE_EDGE, 0
    for block in range(coarse[0] * coarse[1] * coarse[2]):
        opinion = _judge(room.coarse, tables, question, block, ((1 << question.cameras.size) - 1, 0, 0))
        if not _may_be_shared(question, opinion):
            continue
        corner = (
            block % coarse[0] * ratio,
            block // coarse[0] % coarse[1] * ratio,
            block // (coarse[0] * coarse[1]) * ratio,
        )
        for z in range(corner[2], min(corner[2] + ratio, fine[2])):
            for y in range(corner[1], min(corner[1] + ratio, fine[1])):
                for x in range(corner[0], min(corner[0] + ratio, fine[0])):
                    closer = _judge(room.fine, tables, question, (z * fine[1] + y) * fine[0] + x, opinion)
                    if _may_be_shared(question, closer):
                        low = (x * FINE_EDGE, y * FINE_EDGE, z * FINE_EDGE)
                        found = _ask_voxels(room, labels, question, low, closer, voxels, vetoes, found)
                        if found == TOO_MANY:
                            return TOO_MANY
    return found


@njit(cache=True, nogil=True)
def _judge(boxes, tables, question, block, opinion):  # type: ignore[no-untyped-def]
    """Bits of the cameras that are undecided about a block, that have foreground all over it, and that veto it whole,
    from those for the block around it."""
    undecided, filled, vetoed = opinion
    for slot in range(question.cameras.size):
        if undecided >> slot & 1:
            camera, bit = question.cameras[slot], 1 << slot
            sight, box, table = boxes.sight[camera, block], boxes.pixels[camera, block], tables[camera]
            u0, v0, u1, v1 = box[0], box[1], box[2], box[3]
            if sight == UNSEEN:
                undecided &= ~bit
            elif sight == SEEN:
                area = table[v1, u1] - table[v0, u1] - table[v1, u0] + table[v0, u0]
                if area == 0:
                    undecided, vetoed = undecided & ~bit, vetoed | bit
                elif area == (int(u1) - u0) * (int(v1) - v0):
                    undecided, filled = undecided & ~bit, filled | bit
    return undecided, filled, vetoed


@njit(cache=True, nogil=True)
def _may_be_shared(question, opinion):  # type: ignore[no-untyped-def]
    undecided, filled, vetoed = opinion
    on_panel = (1 << question.panel) - 1
    return _bits(vetoed & on_panel) <= 1 and _bits((undecided | filled) & on_panel) >= question.needed_without


@njit(cache=True, nogil=True)
def _bits(word):  # type: ignore[no-untyped-def]
    """How many bits are set."""
    count = 0
    while word:
        word &= word - 1
        count += 1
    return count


@njit(cache=True, nogil=True)
def _ask_voxels(room, labels, question, low, opinion, voxels, vetoes, found):  # type: ignore[no-untyped-def]
    """Append the shared voxels of the block of 4^3 at ``low``; return the number found so far, or TOO_MANY."""
    for z in range(low[2], min(low[2] + FINE_EDGE, room.shape[2])):
        for y in range(low[1], min(low[1] + FINE_EDGE, room.shape[1])):
            for x in range(low[0], min(low[0] + FINE_EDGE, room.shape[0])):
                shared, vetoed = _ask(room, labels, question, opinion, x, y, z)
                if shared:
                    if found == vetoes.size:
                        return TOO_MANY
                    voxels[found, 0], voxels[found, 1], voxels[found, 2] = x, y, z
                    vetoes[found] = vetoed
                    found += 1
    return found


@njit(cache=True, nogil=True)
def _ask(room, labels, question, opinion, x, y, z):  # type: ignore[no-untyped-def]
    """Whether a voxel is shared, and the bits of the cameras that veto it. Next to the floor nobody's veto counts."""
    undecided, filled, vetoed = opinion
    on_panel = (1 << question.panel) - 1
    against = _bits(vetoed & on_panel)
    for slot in range(question.cameras.size):
        if undecided >> slot & 1:
            camera = question.cameras[slot]
            u, v, _ = project(room.projections, camera, x, y, z)
            if u >= 0 and v >= 0 and u < room.sizes[camera, 0] and v < room.sizes[camera, 1]:
                label = labels[camera, int(v), int(u)]
                if label > BACKGROUND_CELL:
                    filled |= 1 << slot
                elif label == BACKGROUND_CELL:
                    vetoed |= 1 << slot
                    against += slot < question.panel
                    if against > 1:
                        return False, 0
    votes = _bits(filled & on_panel)
    if z < room.low_layers:
        return against == 0 and votes >= question.needed, 0
    return votes >= (question.needed if against == 0 else question.needed_without), vetoed


@njit(cache=True, nogil=True)
def project(P, camera, x, y, z):  # type: ignore[no-untyped-def]
    """The cell coordinates of a voxel's centre and its depth; beyond any canvas when it is behind the camera."""
    w = P[camera, 2, 0] * x + P[camera, 2, 1] * y + P[camera, 2, 2] * z + P[camera, 2, 3]
    if w <= 0:
        return -1.0, -1.0, w
    u = (P[camera, 0, 0] * x + P[camera, 0, 1] * y + P[camera, 0, 2] * z + P[camera, 0, 3]) / w
    v = (P[camera, 1, 0] * x + P[camera, 1, 1] * y + P[camera, 1, 2] * z + P[camera, 1, 3]) / w
    return u, v, w


@njit(cache=True, nogil=True)
def explain(room, labels, question, voxels, vetoes, obeyed, ignored):  # type: ignore[no-untyped-def]
    """Mark, in the cells of every camera's foreground, the hulls that reach them.

    obeyed, ignored (n, M) : bit s of a cell is set when the panel's hull with (obeyed) or without (ignored) the veto of
    camera s lies behind it.
    """
    everyone, on_panel = (1 << question.cameras.size) - 1, (1 << question.panel) - 1
    for found in range(vetoes.size):
        x, y, z = voxels[found, 0], voxels[found, 1], voxels[found, 2]
        against = vetoes[found] & on_panel
        with_veto = everyone & ~vetoes[found] if against == 0 else 0
        without_veto = everyone if against == 0 else against
        for slot in range(question.cameras.size):
            camera = question.cameras[slot]
            u, v, w = project(room.projections, camera, x, y, z)
            if w <= 0:
                continue
            reach, width, height = room.reach[camera] / w, room.sizes[camera, 0], room.sizes[camera, 1]
            for row in range(int(max(v - reach, 0.0)), int(min(v + reach + 1.0, height))):
                for column in range(int(max(u - reach, 0.0)), int(min(u + reach + 1.0, width))):
                    label = labels[camera, row, column]
                    if label > BACKGROUND_CELL:
                        obeyed[slot, label - 1] |= with_veto
                        ignored[slot, label - 1] |= without_veto


@njit(cache=True, nogil=True)
def count_cells(cells, obeyed, ignored, explained, denied):  # type: ignore[no-untyped-def]
    """Count foreground cells (n, n) [in whose picture, whose veto ignored]: those that the hull without a camera's veto
    explains, and among them those that the veto takes away: denied."""
    for picture in range(cells.size):
        for cell in range(cells[picture]):
            reached, kept = ignored[picture, cell], obeyed[picture, cell]
            for slot in range(cells.size):
                explained[picture, slot] += reached >> slot & 1
                denied[picture, slot] += (reached & ~kept) >> slot & 1
