"""How blurred a board's edges are in an image: out of focus, or moved during the exposure."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .detection import as_grey
from .grid import steps
from .sighting import Sighting
from .specification import MAX_CORNERS
from .x_corner import fit_x_corners

Array = npt.NDArray[np.float64]

CLEAR_OF_MARKERS = 0.12  # of a white field's side: a sighting does not say whether its board has markers


def blur_px(image: npt.NDArray[np.uint8], sighting: Sighting) -> float:
    """Standard deviation of the blur across the board's edges, px: median over the corners, the worse of the two
    directions (motion blurs the edges that it crosses). About 0.3 for a sharp image; NaN when no corner can be fitted.

    ``image`` (H, W) or (H, W, 3): the one in which the sighting was made.
    """
    along, down = neighbour_steps(sighting)
    known = np.all(np.isfinite(np.hstack([along, down])), axis=1)
    places, steps_known = sighting.pixels[known], (along[known], down[known])
    corners = fit_x_corners(as_grey(image), places, *steps_known, marker_margin=CLEAR_OF_MARKERS)
    fitted = corners.fit > 0.5
    return float(np.median(corners.blur_px[fitted], axis=0).max()) if fitted.any() else float("nan")


def neighbour_steps(sighting: Sighting) -> tuple[Array, Array]:
    """For each corner of a sighting the way to the next in its row and to the next row, (n, 2) each, NaN where no
    neighbour was seen."""
    columns = _columns(sighting)
    row, column = np.divmod(sighting.ids, columns)
    grid = np.full((row.max() + 1, columns, 2), np.nan)
    grid[row, column] = sighting.pixels
    along, down = steps(grid)
    return along[row, column], down[row, column]


def _columns(sighting: Sighting) -> int:
    """Corners in a row of the board: the number with which the ids, laid out in rows, look like a flat board most.

    A sighting does not say of which board it is.
    """
    errors = {}
    for columns in range(2, MAX_CORNERS + 1):
        row, column = np.divmod(sighting.ids, columns)
        if np.ptp(row) and np.ptp(column):
            flat = np.column_stack([column, row, column * row, np.ones(len(row))]).astype(float)
            solution = np.linalg.lstsq(flat, sighting.pixels, rcond=None)[0]
            errors[columns] = float(np.mean((flat @ solution - sighting.pixels) ** 2))
    return min(errors, key=lambda columns: errors[columns], default=MAX_CORNERS)
