"""Where to begin when a picture does not lie where it was: every shift and roll on a coarse grid is tried."""

from __future__ import annotations

import numpy as np

from .camera_moved_points import Array, Picture, Points

SHIFTS = 10  # pixels of the coarsest level, to each side: one is about a degree
ROLLS_DEG = (0.0, -2.5, 2.5, -5.0, 5.0)
MOST_POINTS = 140
WORST = 2.0  # residuals, in steepnesses of an edge, from which a place is just elsewhere
GUESSES = 3


def coarse_guesses(points: Points, view: Picture, focal_px: float) -> list[Array]:
    """The rotation vectors (3,), radians, in the camera's frame, with the best fits on the coarsest level.

    To each place the picture is compared where a roll about the middle, and a shift by whole pixels, put it.
    """
    points = points.only(np.arange(0, len(points.value), -(-len(points.value) // MOST_POINTS)))
    focal = focal_px / points.scale
    place, middle = points.rays[:, :2] / points.rays[:, 2:] * focal, (np.array(view.shape[::-1]) - 1) / 2
    shifts = np.arange(-SHIFTS, SHIFTS + 1)
    costs = np.stack([_costs(points, view, place @ _roll(np.radians(deg)).T + middle, shifts) for deg in ROLLS_DEG])
    found = []
    for _ in range(GUESSES):
        roll, down, right = np.unravel_index(np.argmin(costs), costs.shape)
        found.append(np.array([-shifts[down] / focal, shifts[right] / focal, np.radians(ROLLS_DEG[roll])]))
        costs[:, max(down - 1, 0) : down + 2, max(right - 1, 0) : right + 2] = np.inf  # the next one lies elsewhere
    return found


def _costs(points: Points, view: Picture, place: Array, shifts: np.ndarray) -> Array:
    """(down, right) mean residual after each shift, in steepnesses, bounded; out of view counts as the worst."""
    column, row = np.rint(place).astype(np.int64).T
    columns, rows = column[None, None] + shifts[None, :, None], row[None, None] + shifts[:, None, None]
    within = (columns >= 0) & (columns < view.shape[1]) & (rows >= 0) & (rows < view.shape[0])
    value = view[rows.clip(0, view.shape[0] - 1), columns.clip(0, view.shape[1] - 1)]
    residual = np.abs(value - points.value) / points.steepness
    return np.where(within, np.minimum(residual, WORST), WORST).mean(axis=2)


def _roll(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])
