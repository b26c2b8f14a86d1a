"""What the people in the room look like: a histogram of their colours, and where the background looks like them.

A pixel that is as the background was is evidence of background only as far as nobody here could look the same. To the
segmentation the foreground is anything; but whoever has been seen for a while is known. Where their colours explain the
picture better than the background does, though it is too near to the background to be called foreground, the camera is
uncertain: a dark shirt before a dark screen is no hole in the body (Stoll et al., "Fast articulated motion tracking
using a sums of Gaussians body model", ICCV 2011, find people by such colours alone). Mono cameras have grey levels.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import convolve1d

from capture_rig.kernel import kernel, njit
from capture_rig.mask_levels import BACKGROUND, FOREGROUND, UNCERTAIN
from capture_rig.stamps import StampThrottle

from ..background.expected_image import Samples
from ..background.kernels import BLOCK_PX, OPTIONS, SCALE, STEP_PX, USUAL_S
from ..frame_source import REPORT_PERIOD_S, Image, Mask
from .masks import CROSS, Box, enlarged

BITS_MONO, BITS_COLOUR = 6, 5  # of each channel, in the histogram
# Thresholds: DARK from a sensor's shot and read noise; else judgement.
DARK = 16.0  # grey levels: noise has the variance a (level + DARK), about; bins are equally many sigmas wide
MEMORY_S = 10.0  # time constant: people come and go, and clouds pass
UNKNOWN = 0.3  # share of a person's pixels whose colour may be any: another side, another person
FEWEST = 8  # background pixels of a block that is judged by itself; its neighbours decide for one with fewer


class PeopleColours:
    """Learns the colours of the people in one camera's view, and finds where the background could be they.

    Frames come on one thread, in the order of their stamps.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        """``shape`` : of the images, (H, W) or (H, W, 3)."""
        self._channels = 1 if len(shape) == 2 else shape[2]
        self._bits = BITS_MONO if self._channels == 1 else BITS_COLOUR
        bins = 1 << self._bits * self._channels
        self._table, self._volume = noise_bins(self._bits, self._channels)
        self._counts, self._ratio = np.zeros(bins, np.float32), np.zeros(bins, np.float32)
        self._throttle, self._learned_s = StampThrottle(REPORT_PERIOD_S), 0.0
        blocks = -(-shape[0] // BLOCK_PX), -(-shape[1] // BLOCK_PX)
        self._judged, self._nowhere = np.zeros((2, *blocks), np.uint8)

    @property
    def known(self) -> bool:
        """Whether people have been seen for long enough: until colours are usual, nothing is known."""
        return self._learned_s >= USUAL_S

    def learn(self, image: Image, person: Mask, box: Box, nobody: npt.NDArray[np.bool_] | None, stamp_ns: int) -> None:
        """Learn from a frame (H, W[, 3]); person (h, w) : 255 where a box of it certainly shows people.

        nobody (H / BLOCK_PX, W / BLOCK_PX) : blocks in which the other cameras see nobody, where that is known.
        """
        step_s = self._throttle.step_s(stamp_ns)
        if step_s <= 0.0:
            return
        found = np.zeros_like(self._counts)
        pixels = image.reshape(*image.shape[:2], self._channels)
        ignored = self._nowhere if nobody is None else nobody.view(np.uint8)
        count_colours(pixels, person, box, ignored, self._table, self._bits, found)
        total = float(found.sum())
        if total == 0.0:
            return
        self._learned_s += step_s
        share = max(1.0 - math.exp(-step_s / MEMORY_S), step_s / self._learned_s)  # a plain mean at first
        self._counts += np.float32(share) * (found / total - self._counts)
        # p(colour | person) over p(colour | anything), its logarithm: neighbouring colours are as likely
        smooth = _smoothed(self._counts.reshape((1 << self._bits,) * self._channels)).reshape(-1)
        self._ratio = np.log(UNKNOWN + (1 - UNKNOWN) * smooth / self._volume).astype(np.float32)

    def mark_uncertain(self, samples: Samples, distance: Mask, levels: Mask, least: float, most: float) -> Box:
        """Write UNCERTAIN into the background of ``levels`` (H, W) where the people's colours explain it better.

        samples (C, h, w) : of the image; distance (h, w) : SCALE z^2, their squared distance from the background.
        least : z^2 / 2 at which background and a foreground of any colour are equally likely; most : what a pixel
        counts at most. Returns a box around the marks.
        """
        if not self.known:
            return Box(0, 0, 0, 0)
        judge_blocks(samples, distance, levels, self._ratio, self._table, self._bits, (least, most), self._judged)
        return mark_blocks(self._judged, levels)


def noise_bins(bits: int, channels: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """Return the bin of each grey level (256,), and the share of all colours that each bin (bins,) holds.

    Bins of equal grey levels would hold all dark clothes, and dark furniture, in the same few.
    """
    level = np.sqrt(np.arange(257) + DARK) - np.sqrt(DARK)
    table = (level[:256] / level[256] * (1 << bits)).astype(np.uint8)
    share = np.bincount(table, minlength=1 << bits) / 256.0
    volume = share
    for _ in range(channels - 1):
        volume = np.multiply.outer(volume, share)
    return table, np.maximum(volume.reshape(-1), 1e-12).astype(np.float32)


def _smoothed(histogram: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the mean of each bin and its neighbours, weights 1, 2, 1 along every axis."""
    for axis in range(histogram.ndim):
        histogram = convolve1d(histogram, (0.25, 0.5, 0.25), axis=axis, mode="nearest")
    return histogram


@njit(**OPTIONS, crops=True)
def count_colours(pixels, person, box, nobody, table, bits, found):  # type: ignore[no-untyped-def]
    """Add up the colours of a person's inner pixels into ``found`` (bins,): every STEP_PX-th row and column.

    pixels (H, W, C) uint8; person (h, w) : of the box (top, left, bottom, right). nobody : blocks that do not count.
    table (256,) : the bin of each grey level, of ``bits`` bits a channel.
    """
    top, left = box[0], box[1]
    for y in range(STEP_PX, person.shape[0] - STEP_PX, STEP_PX):
        for x in range(STEP_PX, person.shape[1] - STEP_PX, STEP_PX):
            inner = person[y, x] & person[y - STEP_PX, x] & person[y + STEP_PX, x]
            if inner & person[y, x - STEP_PX] & person[y, x + STEP_PX] == FOREGROUND:
                v, u = top + y, left + x
                if nobody[v // BLOCK_PX, u // BLOCK_PX] == 0:
                    found[_bin(pixels[v, u], table, bits)] += np.float32(1)


@kernel
def _bin(colour, table, bits):  # type: ignore[no-untyped-def]
    number = np.int64(0)
    for channel in range(colour.size):
        number = number << bits | np.int64(table[colour[channel]])
    return number


@njit(**OPTIONS)
def judge_blocks(samples, distance, levels, ratio, table, bits, limits, judged):  # type: ignore[no-untyped-def]
    """Write into ``judged`` (blocks) 0 where the background of a block is background, 1 where there is too little of
    it to tell, 2 where it rather shows people: by the mean log-likelihood ratio of its background pixels.

    samples (C, h, w), distance (h, w), levels (H, W) uint8; ratio (bins,) : log of how much likelier people have a
    colour than anything else; see :meth:`PeopleColours.mark_uncertain`.
    """
    (height, width), side = distance.shape, BLOCK_PX // STEP_PX
    least, most = limits
    limit, scale, likeliest = np.int64(2 * SCALE * most), 0.5 / SCALE, ratio.max()
    for row in range(judged.shape[0]):
        for column in range(judged.shape[1]):
            bottom, right = min((row + 1) * side, height), min((column + 1) * side, width)
            total, count = 0.0, 0
            for y in range(row * side, bottom):
                for x in range(column * side, right):
                    if levels[STEP_PX * y, STEP_PX * x] == BACKGROUND:
                        total += scale * min(np.int64(distance[y, x]), limit) - least + likeliest
                        count += 1
            if count < FEWEST or total <= 0.0:  # whatever the colours are
                judged[row, column] = 1 if count < FEWEST else 0
                continue
            total = 0.0
            for y in range(row * side, bottom):
                for x in range(column * side, right):
                    if levels[STEP_PX * y, STEP_PX * x] == BACKGROUND:
                        own = scale * min(np.int64(distance[y, x]), limit)
                        total += own - least + ratio[_bin(samples[:, y, x], table, bits)]
            judged[row, column] = 2 if total > 0.0 else 0


def mark_blocks(judged: Mask, levels: Mask) -> Box:
    """Write UNCERTAIN into the background of the blocks judged 2, and of those judged 1 beside one of them; return a
    box around them."""
    sure = np.equal(judged, 2).view(np.uint8)
    uncertain = sure | (judged & cv2.dilate(sure, CROSS))
    blocks = Box.around(uncertain)
    box = Box(*(BLOCK_PX * side for side in blocks)).grown(0, levels.shape)
    part = levels[box.slices]
    part[(enlarged(uncertain[blocks.slices], BLOCK_PX, part.shape) > 0) & (part == BACKGROUND)] = UNCERTAIN
    return box
