"""Multi-view consistency of foreground: marks, for each camera, where the other cameras see a body.

Foreground without support, of things that were moved, doors and screens, can become background in its camera. The
capture volume and its surroundings are divided into blocks. A block supports foreground of a camera when as many of
the others show foreground as a hull needs (in the volume, where fewer see it: all that do), and no more than one shows
none. Near such blocks half of the others are enough, and everywhere while there are none: a person is supported while
fewer than half of the others miss a part of the body. A cell of the picture can be judged when at least two others see
the whole stretch of its rays inside the volume.
"""

from __future__ import annotations

from collections.abc import Container
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import Rig, Volume
from capture_rig.kernel import kernel
from capture_rig.stamps import StampThrottle
from mocap_packets.silhouette import BODY, NOBODY, OUTSIDE, SUPPORT_PERIOD_S, UNJUDGED, ForegroundSupport

from ..bitset import high_bytes, nonzero_bytes, popcount
from ..carving.pixel_boxes import SEEN, UNSEEN, block_boxes, count_in_box, summed_area
from ..grid import VoxelGrid
from ..views import Masks, RigViews, min_seeing
from . import EARLY

# Thresholds: ARM_M from the length of an arm; else judgement: no measurement beside the built rooms of
# test_hull_foreground_support.py, in which they hold.
CELL_PX = 8  # a word of pixels, a divisor of every canvas's width; the cells of the camera clients
LEAST_PX = 4  # foreground pixels that make a cell foreground: noise leaves fewer
BLOCK_M = 0.12  # about one cell at 4 m, and half a person's depth
SURROUNDINGS_M = 1.5  # beside the volume, where people wait
ARM_M = 0.5  # arm's length: a body may extend this far out of the volume; half-supported blocks this near count
MARGIN_M = 0.15  # around supported blocks: their size, contact shadows
POORLY_SEEN = 0.02  # tolerated share of a ray's blocks in the volume that too few others see: rounding at its faces
_EDGE, _COARSE_EDGE = 2, 8  # voxels along a block, and along a coarse one, which is tested first

Cells = npt.NDArray[np.uint8]
Tables = npt.NDArray[np.int32]


class SupportReporter:
    """Reports, a few times a second by the stamps, where each camera's foreground has support. One thread at a time."""

    def __init__(self, rig: Rig, views: RigViews, requested_seeing: int = 0) -> None:
        """``requested_seeing`` is the hull's setting ``min_seeing``."""
        self._views, self._requested_seeing = views, requested_seeing
        self._cells = _pooled_views(views)
        grid = VoxelGrid.covering(_surroundings(rig.volume), BLOCK_M / _EDGE)
        seen_table = summed_area(self._cells.seen)
        self._boxes, self._coarse = (block_boxes(self._cells, grid, e, seen_table) for e in (_EDGE, _COARSE_EDGE))
        self._space = _Space.of(grid, rig.volume)
        cells_per_m = (views.px_per_m(rig.volume) / CELL_PX).tolist()
        self._reaches = [(_disc(MARGIN_M * scale), _disc(ARM_M * scale)) for scale in cells_per_m]
        self._throttle = StampThrottle(SUPPORT_PERIOD_S, early_share=EARLY)
        self._trusted = 0  # bits of cameras that once agreed with others: others' empty views may be blind ones
        self._judged: tuple[int, Cells] = (0, np.zeros(self._cells.seen.shape, np.uint8))

    def update(self, masks: Masks, used: Container[str], stamp_ns: int) -> tuple[ForegroundSupport, ...]:
        """Judge one frame set's canvas masks (h, w) uint8 once a period; else return nothing.

        masks : with shadows resolved, above 127 foreground; only background denies a body. used : the cameras that
        vote; the others only get a report. InputError for an unknown camera or a wrong size.
        """
        if self._throttle.step_s(stamp_ns) <= 0.0:
            return ()
        present, names = self._views.present(masks), self._views.names
        sent, shown = np.zeros((2, *self._cells.seen.shape), np.uint8)
        for camera in present:
            words = np.ascontiguousarray(masks[names[camera]]).view(np.uint64)
            _pool(words, names[camera] in used, sent[camera], shown[camera])
        voters = sum(1 << int(camera) for camera in present if names[camera] in used)
        levels = self._levels(shown, summed_area(sent), voters)
        return tuple(self._report(int(camera), levels[camera], stamp_ns) for camera in present)

    def _levels(self, shown: Cells, sent: Tables, voters: int) -> Cells:
        """Return the level of every cell (N, h, w), from the cells that the voters (bits) show."""
        found = np.zeros_like(shown)
        # bodies in the volume, and half-supported blocks next to them
        sure, half, agreed = self._vote(shown, sent, voters, True)
        self._trusted |= agreed
        for camera, (margin, near) in enumerate(self._reaches):
            beside = cv2.dilate(sure[camera], near) if sure[camera].any() else np.full_like(sure[camera], 1)
            found[camera] = cv2.dilate(sure[camera] | (half[camera] & beside), margin) * np.uint8(BODY)
        # the rest of the pictures: things and people around the volume
        outside, _, _ = self._vote(np.where(found > 0, np.uint8(0), shown), sent, voters, False)
        found[(outside > 0) & (found == 0)] = OUTSIDE
        return np.where(found > 0, found, self._judgeable(voters & self._trusted))

    def _vote(self, shown: Cells, sent: Tables, voters: int, of_bodies: bool) -> tuple[Cells, Cells, int]:
        """Return the cells (N, h, w), 0 or 1, with certain support, with half support, and the agreeing cameras."""
        needed = min_seeing(int(popcount(np.uint64(voters))), self._requested_seeing) - 1
        votes = Votes(voters, self._trusted, needed, of_bodies)
        pictures, sure, half = Pictures(summed_area(shown), sent), np.zeros_like(shown), np.zeros_like(shown)
        agreed = mark_supported(self._boxes, self._coarse, pictures, votes, self._space, sure, half)
        return sure, half, int(agreed)

    def _judgeable(self, witnesses: int) -> Cells:
        """Return the level of every cell without support: NOBODY, UNJUDGED, or OUTSIDE the volume."""
        if self._judged[0] != witnesses:
            passed, poorly = (np.zeros(self._cells.seen.shape, np.int32) for _ in range(2))
            count_witnesses(self._boxes, witnesses, self._space, passed, poorly)
            levels = np.where(poorly <= POORLY_SEEN * passed, np.uint8(NOBODY), np.uint8(UNJUDGED))
            self._judged = witnesses, np.where(passed > 0, levels, np.uint8(OUTSIDE if witnesses else UNJUDGED))
        return self._judged[1]

    def _report(self, camera: int, levels: Cells, stamp_ns: int) -> ForegroundSupport:
        (width, height), canvas_width = self._cells.sizes[camera], int(self._views.sizes[camera, 0])
        own = np.ascontiguousarray(levels[:height, :width])
        return ForegroundSupport.of_canvas(stamp_ns, self._views.names[camera], own, canvas_width)


class _Space(NamedTuple):
    """The grid of blocks, in numbers along x, y and z, (3,).

    blocks, coarse : counts of both sizes. inner : from and to, (2, 3), of the capture volume. bodies : the same widened
    by an arm's length.
    """

    blocks: npt.NDArray[np.int64]
    coarse: npt.NDArray[np.int64]
    inner: npt.NDArray[np.int64]
    bodies: npt.NDArray[np.int64]

    @classmethod
    def of(cls, grid: VoxelGrid, volume: Volume) -> _Space:
        shape, reach = np.array(grid.shape, np.int64), round(ARM_M / BLOCK_M)
        inner = np.rint((np.array([volume.low, volume.high]) - grid.origin) / BLOCK_M).astype(np.int64)
        blocks = -(-shape // _EDGE)
        return cls(blocks, -(-shape // _COARSE_EDGE), inner, np.clip(inner + np.array([[-reach], [reach]]), 0, blocks))


class Votes(NamedTuple):
    """voters, trusted : bits of the cameras whose foreground counts, and of those whose empty view counts, too.
    needed : number of others that must show foreground, where as many see the block.
    of_bodies : whether they vote on blocks within an arm's length of the volume, or on those around."""

    voters: int
    trusted: int
    needed: int
    of_bodies: bool


class Pictures(NamedTuple):
    """Summed-area tables (N, h + 1, w + 1) of the cells that show a body, and of those that show anything at all."""

    shown: Tables
    sent: Tables


@kernel
def mark_supported(boxes, coarse_boxes, pictures, votes, space, sure, half):  # type: ignore[no-untyped-def]
    """Mark the cells (N, h, w) on which blocks lie that are supported for certain, and by half of the other cameras.

    Returns the bits of the cameras that agreed with others for certain.
    """
    agreed, ratio = 0, _COARSE_EDGE // _EDGE
    for at in range(space.coarse[0] * space.coarse[1] * space.coarse[2]):
        showing, _ = _count_votes(coarse_boxes, pictures, votes, at)
        if popcount(np.uint64(showing)) < 2:
            continue
        x0, y0 = at % space.coarse[0] * ratio, at // space.coarse[0] % space.coarse[1] * ratio
        z0 = at // (space.coarse[0] * space.coarse[1]) * ratio
        for z in range(z0, min(z0 + ratio, space.blocks[2])):
            for y in range(y0, min(y0 + ratio, space.blocks[1])):
                for x in range(x0, min(x0 + ratio, space.blocks[0])):
                    if _within(space.bodies, x, y, z) == votes.of_bodies:
                        block = (z * space.blocks[1] + y) * space.blocks[0] + x
                        showing, denying = _count_votes(boxes, pictures, votes, block)
                        if popcount(np.uint64(showing)) >= 2:
                            agreed |= _mark_block(boxes, block, (showing, denying), votes, sure, half)
    return agreed


@kernel
def _count_votes(boxes, pictures, votes, block):  # type: ignore[no-untyped-def]
    """Return the bits of the voters that show foreground in a block, and of those that see all of it without any."""
    showing, denying = 0, 0
    for camera in range(boxes.visibility.shape[0]):
        if votes.voters >> camera & 1:
            visibility, box = boxes.visibility[camera, block], boxes.pixels[camera, block]
            if visibility != UNSEEN:
                u0, v0, u1, v1 = int(box[0]), int(box[1]), int(box[2]), int(box[3])
                if count_in_box(pictures.shown, camera, u0, v0, u1, v1) > 0:
                    showing |= 1 << camera
                elif (
                    visibility == SEEN
                    and votes.trusted >> camera & 1
                    and count_in_box(pictures.sent, camera, u0, v0, u1, v1) == 0
                ):
                    denying |= 1 << camera
    return showing, denying


@kernel
def _mark_block(boxes, block, seen_by, votes, sure, half):  # type: ignore[no-untyped-def]
    """Mark a block in the pictures of the cameras whose others support it; return the bits of those that agree."""
    showing, denying = seen_by
    agreed = 0
    for camera in range(boxes.visibility.shape[0]):
        if boxes.visibility[camera, block] != UNSEEN:
            supporters = popcount(np.uint64(showing & ~(1 << camera)))
            deniers = popcount(np.uint64(denying & ~(1 << camera)))
            if supporters >= 2 and supporters >= deniers:
                box = boxes.pixels[camera, block]
                half[camera, box[1] : box[3], box[0] : box[2]] = 1
                looking = supporters + deniers if votes.of_bodies else votes.needed
                if deniers <= 1 and supporters >= min(votes.needed, looking):
                    agreed |= showing & 1 << camera
                    sure[camera, box[1] : box[3], box[0] : box[2]] = 1
    return agreed


@kernel
def _within(box, x, y, z):  # type: ignore[no-untyped-def]
    return box[0, 0] <= x < box[1, 0] and box[0, 1] <= y < box[1, 1] and box[0, 2] <= z < box[1, 2]


@kernel
def count_witnesses(boxes, witnesses, space, passed, poorly):  # type: ignore[no-untyped-def]
    """Count (N, h, w) the blocks of the volume on each cell, and those that fewer than two other witnesses see."""
    for z in range(space.inner[0, 2], space.inner[1, 2]):
        for y in range(space.inner[0, 1], space.inner[1, 1]):
            for x in range(space.inner[0, 0], space.inner[1, 0]):
                block, seeing = (z * space.blocks[1] + y) * space.blocks[0] + x, 0
                for camera in range(boxes.visibility.shape[0]):
                    if witnesses >> camera & 1 and boxes.visibility[camera, block] == SEEN:
                        seeing |= 1 << camera
                for camera in range(boxes.visibility.shape[0]):
                    poor = popcount(np.uint64(seeing & ~(1 << camera))) < 2
                    box = boxes.pixels[camera, block]
                    for row in range(box[1], box[3]):
                        for column in range(box[0], box[2]):
                            passed[camera, row, column] += 1
                            poorly[camera, row, column] += poor


def _surroundings(volume: Volume) -> Volume:
    """Return the volume with whole blocks beside and above it."""
    beside, above = (np.ceil(reach / BLOCK_M) * BLOCK_M for reach in (SURROUNDINGS_M, ARM_M))
    aside, up = beside * np.array([1.0, 1.0, 0.0]), above * np.array([0.0, 0.0, 1.0])
    return Volume(volume.low - aside, volume.high + aside + up)


def _pooled_views(views: RigViews) -> RigViews:
    """Return the views in cells: cell (r, c) holds the pixels from CELL_PX r, CELL_PX c on, and is seen if half is."""
    P = views.P.copy()
    P[:, :2] = (P[:, :2] + 0.5 * P[:, 2:]) / CELL_PX - 0.5 * P[:, 2:]
    n, height, width = views.seen.shape
    padded = np.zeros((n, -(-height // CELL_PX) * CELL_PX, width), np.uint8)
    padded[:, :height] = views.seen
    share = padded.reshape(n, -1, CELL_PX, width // CELL_PX, CELL_PX).mean(axis=(2, 4))
    return RigViews(views.names, P, -(-views.sizes // CELL_PX), np.where(share > 127, np.uint8(255), np.uint8(0)))


@kernel
def _pool(mask_words, is_used, sent, shown):  # type: ignore[no-untyped-def]
    """Write 255 to the cells (h, w) of ``sent`` with at least LEAST_PX pixels of a mask (H, W / 8) that are not
    background, and, if the camera is used, of ``shown`` with as many foreground pixels."""
    for row in range(sent.shape[0]):
        rows = mask_words[CELL_PX * row : CELL_PX * row + CELL_PX]
        for column in range(rows.shape[1]):
            any_, sure = 0, 0
            for v in range(rows.shape[0]):
                word = rows[v, column]
                if word != 0:
                    any_ += popcount(nonzero_bytes(word))
                    sure += popcount(high_bytes(word))
            sent[row, column] = 255 if any_ >= LEAST_PX else 0
            shown[row, column] = 255 if is_used and sure >= LEAST_PX else 0


def _disc(cells: float) -> Cells:
    """Return the kernel of a dilation by a radius in cells."""
    side = 2 * int(np.ceil(cells)) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)
