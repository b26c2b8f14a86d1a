"""Runs of consecutive voxels along rows, and the runs that touch joined into blobs of slices and parts of the hull."""

from __future__ import annotations

import numpy as np
from numba import njit

from .bits import lowest_bit


@njit(cache=True, nogil=True)
def find_runs(words):  # type: ignore[no-untyped-def]
    """Runs of set bits of rows (layers, rows, words): starts (m,), ends (m,) (exclusive), the first run of each row
    (layers * rows + 1,), and the rows that have any (f,), as numbers layer * rows + row."""
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
    """Label (m,) of each of the runs that :func:`find_runs` gives, and the forest (n,) of the labels; each
    points at the smallest of its tree.

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
    """Part (m,) of the hull that each run belongs to, numbered by their first runs.

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
    """Put every label directly under its root: parents come before their children."""
    for label in range(forest.size):
        forest[label] = forest[forest[label]]


@njit(cache=True, nogil=True, inline="always")
def run_at(starts, ends, first, line, position):  # type: ignore[no-untyped-def]
    """The run of a row that holds a position, or -1."""
    for run in range(first[line], first[line + 1]):
        if starts[run] <= position < ends[run]:
            return run
    return -1
