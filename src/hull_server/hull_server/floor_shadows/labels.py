"""Labels of the pixels found to be shadow or body, and their vote over the neighbours (rule 3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.mask_levels import FOREGROUND, UNCERTAIN

from ..silhouette_batch import Mask
from ..views import Box
from .scene import ATTENUATED, CANDIDATE

# Thresholds: chosen with shadow_resolution.py among the benches of commit d6079d2.
STRIDE = 3  # every third row and column is tested
LEAST_SHARE = 0.6  # of the neighbours must agree
YES = 1


class PixelLabels(NamedTuple):
    """What is found; one element (h, w) uint8 for every third pixel both ways of a box, 0 before.

    foreground : YES for sure and attenuated pixels. shadow : YES for attenuated pixels that are floor. candidate : YES
    for candidates. body : YES for candidates that are the person. undecided : YES for candidates where the others see a
    body, whether or not they see the floor behind it in shadow. applied : YES where :func:`apply_labels` was.
    """

    foreground: Mask
    shadow: Mask
    candidate: Mask
    body: Mask
    undecided: Mask
    applied: Mask

    @classmethod
    def zeros(cls, box: Box) -> PixelLabels:
        """Labels for a box."""
        left, top, right, bottom = box
        return cls(*np.zeros((len(cls._fields), -(-(bottom - top) // STRIDE), -(-(right - left) // STRIDE)), np.uint8))


@njit(cache=True, nogil=True, error_model="numpy")
def apply_labels(kinds, levels, box, labels, mask):
    """Apply the labels that most neighbours share (rule 3) to ``mask`` (h, w) of 0 and 255, whose levels are
    ``levels``; candidates that are undecided are UNCERTAIN."""
    rows, columns = labels.foreground.shape
    for row in range(rows):
        for column in range(columns):
            if labels.shadow[row, column] | labels.undecided[row, column] == 0:
                continue
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    if labels.applied[r, c]:
                        continue
                    labels.applied[r, c] = YES
                    shadow = _most(labels.shadow, labels.foreground, r, c)
                    body = _most(labels.body, labels.candidate, r, c)
                    undecided = labels.undecided[r, c] != 0
                    _write(kinds, levels, box, (r, c), (shadow, body, undecided), mask)


@kernel
def _write(kinds, levels, box, place, label, mask):
    """Write one label (shadow, body, undecided) to the square of pixels that it stands for."""
    (left, top, right, bottom), (row, column), (shadow, body, undecided) = box, place, label
    for v in range(top + STRIDE * row, min(top + STRIDE * (row + 1), bottom)):
        for u in range(left + STRIDE * column, min(left + STRIDE * (column + 1), right)):
            kind = kinds[levels[v, u]]
            if shadow and kind == ATTENUATED:
                mask[v, u] = 0
            elif body and kind == CANDIDATE:
                mask[v, u] = FOREGROUND
            elif undecided and kind == CANDIDATE:
                mask[v, u] = UNCERTAIN


@kernel
def _most(found, among, row, column):
    """Check that LEAST_SHARE of the 3 x 3 neighbours that are ``among`` are ``found``."""
    yes, total = 0, 0
    for r in range(max(row - 1, 0), min(row + 2, found.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, found.shape[1])):
            yes += found[r, c]
            total += among[r, c]
    return yes > LEAST_SHARE * total
