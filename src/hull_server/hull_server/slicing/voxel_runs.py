"""Packs bricks of voxels into rows of 64-bit words, finds runs of voxels in them, and joins the runs that touch.

Runs that touch in a slice are blobs; runs that touch in space are parts of the hull. Both are found with a union-find
forest of labels, in which the smallest label of a tree is its root.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit

from ..bitset import lowest_bit, transpose8

_U1 = np.uint64(1)


@njit(cache=True, nogil=True)
def brick_box(index, bricks_x, bricks_y):  # type: ignore[no-untyped-def]
    """Bound all bricks: low x, y, z and high x, y, z (exclusive); zeros for none."""
    if index.size == 0:
        return 0, 0, 0, 0, 0, 0
    low_x, low_y, low_z, high_x, high_y, high_z = bricks_x, bricks_y, 1 << 30, 0, 0, 0
    for brick in range(index.size):
        flat = np.int64(index[brick])
        x, y, z = flat % bricks_x, flat // bricks_x % bricks_y, flat // (bricks_x * bricks_y)
        low_x, high_x = min(low_x, x), max(high_x, x + 1)
        low_y, high_y = min(low_y, y), max(high_y, y + 1)
        low_z, high_z = min(low_z, z), max(high_z, z + 1)
    return low_x, low_y, low_z, high_x, high_y, high_z


@njit(cache=True, nogil=True)
def pack_rows(index, leaves, bricks_x, bricks_y, box):  # type: ignore[no-untyped-def]
    """Pack the voxels in a box of bricks into rows of bits along x (z, y, words) and along y (z, x, words).

    Bit b of word w is voxel 64 w + b along the row, counted from the box's low corner. A brick's rows are bytes of
    these words, written as such: machines are little-endian.
    """
    low_x, low_y, low_z, high_x, high_y, high_z = box
    nx, ny, nz = 8 * (high_x - low_x), 8 * (high_y - low_y), 8 * (high_z - low_z)
    along_x = np.zeros((nz, ny, (nx + 63) // 64), np.uint64)
    along_y = np.zeros((nz, nx, (ny + 63) // 64), np.uint64)
    bytes_x, bytes_y = along_x.view(np.uint8), along_y.view(np.uint8)
    for brick in range(index.size):
        flat = np.int64(index[brick])
        x, y = flat % bricks_x - low_x, flat // bricks_x % bricks_y - low_y
        z = 8 * (flat // (bricks_x * bricks_y) - low_z)
        for k in range(8):
            layer = leaves[brick, k]
            if layer == 0:
                continue
            turned = transpose8(layer)
            for row in range(8):
                bytes_x[z + k, 8 * y + row, x] = layer & np.uint64(255)
                bytes_y[z + k, 8 * x + row, y] = turned & np.uint64(255)
                layer >>= np.uint64(8)
                turned >>= np.uint64(8)
    return along_x, along_y


@njit(cache=True, nogil=True)
def erode(words, across_layers):  # type: ignore[no-untyped-def]
    """Erode rows (layers, rows, words) by the four neighbours of each voxel in its slice.

    The slice holds the neighbouring row of the same layer, or with ``across_layers`` the same row of the next layer.
    Beyond the box is empty.
    """
    eroded = np.zeros_like(words)
    layers, rows, width = words.shape
    layer_step, row_step = (1, 0) if across_layers else (0, 1)
    for s in range(layer_step, layers - layer_step):
        for r in range(row_step, rows - row_step):
            for w in range(width):
                if words[s, r, w] != 0:
                    before, after = words[s - layer_step, r - row_step, w], words[s + layer_step, r + row_step, w]
                    eroded[s, r, w] = sides(words, s, r, w) & before & after
    return eroded


@njit(cache=True, nogil=True, inline="always")
def sides(words, s, r, w):  # type: ignore[no-untyped-def]
    """Return the voxels of a word whose neighbours along the row are both occupied."""
    word = words[s, r, w]
    before = words[s, r, w - 1] >> np.uint64(63) if w > 0 else np.uint64(0)
    after = words[s, r, w + 1] << np.uint64(63) if w + 1 < words.shape[2] else np.uint64(0)
    return word & (word << _U1 | before) & (word >> _U1 | after)


@njit(cache=True, nogil=True)
def find_runs(words):  # type: ignore[no-untyped-def]
    """Find the runs of set bits of rows (layers, rows, words).

    Returns starts (m,), ends (m,) (exclusive), the first run of each row (layers * rows + 1,), and the rows that have
    any (f,), as numbers layer * rows + row.
    """
    layers, rows, width = words.shape
    starts, ends = np.empty(words.size * 32 + 1, np.int32), np.empty(words.size * 32 + 1, np.int32)  # at worst
    first, filled = np.empty(layers * rows + 1, np.int32), np.empty(layers * rows, np.int32)
    line, run, used = 0, 0, 0
    for s in range(layers):
        for r in range(rows):
            begin, inside = run, np.uint64(0)
            first[line] = run
            for w in range(width):
                word = words[s, r, w]
                changes = word ^ (word << np.uint64(1) | inside)
                while changes != 0:
                    position = 64 * w + lowest_bit(changes)
                    changes &= changes - np.uint64(1)
                    if inside:
                        ends[run] = position
                        run += 1
                    else:
                        starts[run] = position
                    inside ^= np.uint64(1)
            if inside:
                ends[run] = 64 * width
                run += 1
            if run > begin:
                filled[used] = line
                used += 1
            line += 1
    first[line] = run
    return starts[:run].copy(), ends[:run].copy(), first, filled[:used].copy()


@njit(cache=True, nogil=True)
def join_in_slices(runs, rows, across_layers):  # type: ignore[no-untyped-def]
    """Join the runs of :func:`find_runs` that touch in a slice: label (m,) of each run, and the forest (n,) of labels.

    Runs of one slice that touch in neighbouring rows, also diagonally, get labels of one tree. A slice is a layer, or
    with ``across_layers`` the rows of one number in all layers.
    """
    starts, ends, first, filled = runs
    labels, forest = np.full(starts.size, -1, np.int32), np.empty(starts.size, np.int32)
    count = 0
    for line in filled:
        above = line - rows if across_layers else line - 1
        if above >= 0 and (across_layers or line % rows > 0):
            run, other = first[line], first[above]
            last, last_other = first[line + 1], first[above + 1]
            while run < last and other < last_other:
                if starts[run] <= ends[other] and starts[other] <= ends[run]:
                    if labels[run] < 0:
                        labels[run] = labels[other]
                    elif labels[run] != labels[other]:
                        a, b = root_of(forest, labels[run]), root_of(forest, labels[other])
                        forest[max(a, b)] = min(a, b)
                if ends[run] < ends[other]:
                    run += 1
                else:
                    other += 1
        for run in range(first[line], first[line + 1]):
            if labels[run] < 0:
                labels[run] = forest[count] = count
                count += 1
    forest = forest[:count]
    flatten(forest)
    return labels, forest


@njit(cache=True, nogil=True)
def join_in_space(joined_z, joined_y):  # type: ignore[no-untyped-def]
    """Join runs that touch in space: the part (m,) of the hull of each run, numbered by their first runs.

    Blobs of the slices across z and across y that share a run are of one part. So voxels join that touch in such a
    slice by a face, an edge or a corner; two that touch only along an edge parallel to x, or only in a corner, do not.
    """
    (z_labels, z_forest), (y_labels, y_forest) = joined_z, joined_y
    offset = z_forest.size
    forest = np.empty(offset + y_forest.size, np.int32)
    forest[:offset] = z_forest
    forest[offset:] = y_forest + np.int32(offset)
    for run in range(z_labels.size):
        a, b = root_of(forest, z_labels[run]), root_of(forest, offset + y_labels[run])
        if a != b:
            forest[max(a, b)] = min(a, b)
    flatten(forest)
    number, count = np.empty(offset, np.int32), 0
    for label in range(offset):  # a root is the smallest label of its tree, so always one of z
        if forest[label] == label:
            number[label] = count
            count += 1
    part = np.empty(z_labels.size, np.int32)
    for run in range(part.size):
        part[run] = number[forest[z_labels[run]]]
    return part


@njit(cache=True, nogil=True, inline="always")
def root_of(forest, label):  # type: ignore[no-untyped-def]
    while forest[label] != label:
        forest[label] = forest[forest[label]]
        label = forest[label]
    return label


@njit(cache=True, nogil=True, inline="always")
def flatten(forest):  # type: ignore[no-untyped-def]
    """Put every label directly under its root; parents come before their children."""
    for label in range(forest.size):
        forest[label] = forest[forest[label]]


@njit(cache=True, nogil=True, inline="always")
def run_at(starts, ends, first, line, position):  # type: ignore[no-untyped-def]
    """Return the run of a row that holds a position, or -1."""
    for run in range(first[line], first[line + 1]):
        if starts[run] <= position < ends[run]:
            return run
    return -1
