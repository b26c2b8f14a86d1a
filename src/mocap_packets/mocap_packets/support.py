"""What the hull server tells each camera client: where its foreground can be a body, as far as the others see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Cells = npt.NDArray[np.uint8]

UNJUDGED, BODY, OUTSIDE, NOBODY = 0, 85, 170, 255
"""Levels of a cell: too few others look there; they see a body there, or next to it; no body in the capture volume, but
maybe something outside it; nobody."""
LEVELS = (UNJUDGED, BODY, OUTSIDE, NOBODY)


@dataclass(frozen=True, eq=False)
class ForegroundSupport:
    """What the other cameras say of one camera's view, at the capture stamp of a frame set.

    cells (h, w) uint8 : :data:`LEVELS` of squares of ``cell_px`` pixels of the undistorted canvas, from its first pixel
    on. They follow from the other cameras' silhouettes alone, whatever this camera shows.
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
