"""Packets between camera client and hull server: the silhouette of one image, and its support by other cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from capture_rig.mask_levels import BACKGROUND, FOREGROUND, SHADOW_CANDIDATE

Mask = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Silhouette:
    """The silhouette of one image. Only ``mask`` is sent, as a PNG of few levels.

    mask : (h, w) uint8 on the padded undistorted canvas: 255 person, 0 not, 47 uncertain, up to 127 most likely a
        shadow, between them person or shadow (see `capture_rig.mask_levels`).
    image_mask : (H, W) the same levels in the camera's own pixels.
    foreground_fraction, candidate_fraction : the shares of the image that are the person, and shadow candidates.
    flags : may hold "empty" or "full": such a mask is as observed, and probably not a person.
    """

    mask: Mask
    image_mask: Mask
    foreground_fraction: float
    flags: tuple[str, ...]
    candidate_fraction: float = 0.0

    @property
    def person(self) -> Mask:
        """The binary mask, 0 or 255; candidates count as shadow."""
        return np.where(self.mask > SHADOW_CANDIDATE, np.uint8(FOREGROUND), np.uint8(BACKGROUND))


Cells = npt.NDArray[np.uint8]

UNJUDGED, BODY, OUTSIDE, NOBODY = 0, 85, 170, 255
"""Levels of a cell of the multi-view consistency mask: too few other cameras see the place; they show a body there or
next to it; they show none in the capture volume, but perhaps something outside it; they show none."""
LEVELS = (UNJUDGED, BODY, OUTSIDE, NOBODY)
SUPPORT_PERIOD_S = 0.25
"""Period of `ForegroundSupport`: it serves to judge moved things, which takes seconds."""


@dataclass(frozen=True, eq=False)
class ForegroundSupport:
    """Support of one camera's foreground by the other cameras, at the capture stamp of a frame set.

    cells (h, w) uint8 : :data:`LEVELS` of squares of ``cell_px`` pixels of the undistorted canvas, from its first pixel
    on. They are computed from the other cameras' silhouettes alone.
    """

    stamp_ns: int
    camera: str
    cell_px: int
    cells: Cells

    @classmethod
    def of_canvas(
        cls, stamp_ns: int, camera: str, cells: npt.NDArray[np.uint8], canvas_width: int
    ) -> ForegroundSupport:
        """Return the packet whose cells (h, w) cover a canvas of that width. ValueError where they do not."""
        cell_px, rest = divmod(canvas_width, cells.shape[1]) if cells.ndim == 2 and cells.size else (0, 1)
        if rest or cell_px < 1:
            raise ValueError(f"cells of shape {cells.shape} do not cover a canvas {canvas_width} pixels wide")
        return cls(stamp_ns, camera, cell_px, cells)
