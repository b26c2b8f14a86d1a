"""How much darker than the floor behind them the person's pixels are: what the hull server needs to doubt them."""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.mask_levels import (
    CANDIDATE_LEVELS,
    DARK_LEVELS,
    FLOOR_REACH_M,
    FOREGROUND,
    SHADOW_CANDIDATE,
    degree_of,
)
from capture_rig.rig import Volume

from .background_model import BackgroundModel
from .floor_shadow import floor_pixels
from .frame_source import Image, Mask
from .regions import Box

RATIO_SCALE = 200.0  # grey levels that stand for an unchanged brightness: steps of half a percent
ALIGNMENT_PX = 2


class Darkness:
    """Replaces what may be floor in shadow by its degree of darkness (``capture_rig.mask_levels``).

    A single camera cannot tell a dark sock from the shadow beside it. Several can: shadow lies on the floor, where all
    cameras see the same place equally dark. So every shadow candidate, and every pixel of the person whose ray meets
    the floor, tells how bright it is, as a share of what the background was, in few steps. Brightness is the mean
    of 2 x 2 pixels and of the channels: wider windows would mix legs with the shadow beside them.
    """

    def __init__(self, camera: CameraModel, background: BackgroundModel, volume: Volume | None = None) -> None:
        """``volume``: where floor matters; pixels whose ray meets it farther away are not doubted."""
        self._scale = np.float32(RATIO_SCALE) / np.maximum(_halved_grey(background.mean), np.float32(1.0))
        self._floor = floor_pixels(camera, volume, FLOOR_REACH_M)
        degrees = [degree_of(step / RATIO_SCALE) for step in range(256)]
        self._dark = np.array([FOREGROUND if d is None else DARK_LEVELS[d] for d in degrees], np.uint8)
        self._candidate = np.array(
            [SHADOW_CANDIDATE if d is None else CANDIDATE_LEVELS[d // 2] for d in degrees], np.uint8
        )

    def mark(self, image: Image, person: Mask, candidates: Mask, box: Box) -> Mask:
        """The levels (h, w) of ``person`` and ``candidates``, both 0 or 255, which cover ``box`` of ``image``.

        The box begins and ends at even pixels, or at the image's end. What is both is the person.
        """
        doubted = cv2.bitwise_and(person, self._floor[box.slices])
        levels = person.copy()
        inner = Box.around(cv2.bitwise_or(doubted, candidates))
        if inner.empty:
            return levels
        inner = inner.grown(2 * ALIGNMENT_PX, person.shape, ALIGNMENT_PX)
        part = inner.slices
        ratio = self._ratio(image, inner.outside(box))
        cv2.copyTo(_enlarged(cv2.LUT(ratio, self._candidate), levels[part].shape), candidates[part], levels[part])
        levels = cv2.max(levels, person)
        cv2.copyTo(_enlarged(cv2.LUT(ratio, self._dark), levels[part].shape), doubted[part], levels[part])
        return levels

    def _ratio(self, image: Image, at: Box) -> np.ndarray:
        """Brightness of halved pixels (uint8): RATIO_SCALE times what it was when the room was empty."""
        rows, columns = (slice(s.start // 2, -(-s.stop // 2)) for s in at.slices)
        return cv2.convertScaleAbs(cv2.multiply(_halved_grey(image[at.slices]), self._scale[rows, columns]))


def _enlarged(small: Mask, shape: tuple[int, ...]) -> Mask:
    """Each pixel repeated both ways, cut to ``shape``."""
    full = cv2.resize(small, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    return full[: shape[0], : shape[1]]


def _halved_grey(image: np.ndarray) -> np.ndarray:
    """(ceil(h / 2), ceil(w / 2)) float32: means of 2 x 2 pixels and of the channels; odd sides are continued."""
    down, right = image.shape[0] % 2, image.shape[1] % 2
    if down or right:
        image = cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_REPLICATE)
    half = cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
    if half.ndim == 3:
        half = cv2.transform(half, np.full((1, 3), 1 / 3, np.float32))
    return half.astype(np.float32)
