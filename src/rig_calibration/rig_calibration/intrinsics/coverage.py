"""What the views of a board cover: the image, the four directions of tilt, distances; and what to show next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.lens import Array

from ..boards.board import TargetDetection

CELLS_ACROSS = 8
# Thresholds: measured by python bench/calibration.py (rendered video).
TILT_WANTED_DEG = 25.0
SIZES_WANTED = 1.6  # largest board in the image over the smallest
IMAGE_WANTED = 0.85
SIDES = ("left", "right", "top", "bottom")
NINTHS = (
    ("upper left corner", "upper edge", "upper right corner"),
    ("left edge", "centre", "right edge"),
    ("lower left corner", "lower edge", "lower right corner"),
)


@dataclass(frozen=True, eq=False)
class BoardPlacement:
    """How the board is seen: centre (2,) px; size: side of its area, as a share of the image's; lean_rad (2,) how much
    its edges at the image's right (+, left -) and bottom (+, top -) lean towards the camera."""

    centre_px: Array
    size: float
    lean_rad: Array


def placement_of(T_camera_board: Array, detection: TargetDetection) -> BoardPlacement:
    """Tell what a pose of the board means to the person who holds it; its origin may lie anywhere on the board."""
    normal, t = T_camera_board[:3, 2], T_camera_board[:3, 3]
    x, y, z = normal if normal @ t < 0 else -normal  # towards the camera
    angle = np.arctan2(np.hypot(x, y), -z)
    direction = -np.array([x, y]) / max(np.hypot(x, y), 1e-12)  # facing left (-x) means: its right edge is nearer
    width, height = detection.image_size
    area = cv2.contourArea(cv2.convexHull(detection.pixels.astype(np.float32)))
    return BoardPlacement(detection.pixels.mean(axis=0), float(np.sqrt(area / (width * height))), angle * direction)


@dataclass(frozen=True, eq=False)
class Coverage:
    """cells (rows, columns): which parts of the image the board has been in. tilt_deg: by side of the board as the
    image shows it, the strongest lean of that side towards the camera. sizes: largest over smallest."""

    cells: npt.NDArray[np.bool_]
    tilt_deg: dict[str, float]
    sizes: float

    @property
    def image(self) -> float:
        """Share of the image."""
        return float(self.cells.mean())

    def progress(self) -> dict[str, float]:
        """Return each goal's name and how far it is reached, 0 to 1."""
        tilts = {f"tilt {side}": min(self.tilt_deg[side] / TILT_WANTED_DEG, 1.0) for side in SIDES}
        sizes = min(np.log(self.sizes) / np.log(SIZES_WANTED), 1.0)
        return {"image": min(self.image / IMAGE_WANTED, 1.0), **tilts, "distance": float(sizes)}

    @property
    def complete(self) -> bool:
        return min(self.progress().values()) >= 1.0

    def advice(self) -> str:
        """Return what to show next; "" when nothing is missing."""
        progress = self.progress()
        goal = min(progress, key=lambda name: progress[name])
        if progress[goal] >= 1.0:
            return ""
        if goal == "image":
            return f"bring the board into the {self.emptiest()} of the image"
        if goal == "distance":
            return "show the board nearer to the camera, or farther away"
        side = goal.removeprefix("tilt ")
        return f"tilt the board by 30 to 45 degrees, its {side} edge towards the camera"

    def emptiest(self) -> str:
        """Return the ninth of the image that lacks most, in words."""
        rows = np.array_split(self.cells, 3, axis=0)
        filled = np.array([[part.mean() for part in np.array_split(row, 3, axis=1)] for row in rows])
        row, column = np.unravel_index(int(np.argmin(filled)), filled.shape)
        return NINTHS[row][column]


def coverage_of(pixels: Sequence[Array], placements: Sequence[BoardPlacement], image_size: tuple[int, int]) -> Coverage:
    """Summarise the corners (n, 2) of each view, and how each shows the board."""
    width, height = image_size
    cells = np.zeros((max(round(CELLS_ACROSS * height / width), 2), CELLS_ACROSS), bool)
    for corners in pixels:
        cells |= covered_cells(corners, image_size, cells.shape)
    leans = np.rad2deg(np.array([placement.lean_rad for placement in placements]).reshape(-1, 2))
    x, y = leans.T
    tilt = {side: lean.max(initial=0.0) for side, lean in zip(SIDES, (-x, x, -y, y), strict=True)}
    sizes = [max(placement.size, 1e-6) for placement in placements] or [1.0]
    return Coverage(cells, {side: float(lean) for side, lean in tilt.items()}, max(sizes) / min(sizes))


def covered_cells(pixels: Array, image_size: tuple[int, int], shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    """Mark (rows, columns) the cells that hold a corner, or whose middle lies among the corners."""
    cell = np.array(image_size) / (shape[1], shape[0])
    column, row = np.clip(((pixels + 0.5) / cell).astype(int), 0, (shape[1] - 1, shape[0] - 1)).T
    cells = np.zeros(shape, bool)
    cells[row, column] = True
    hull = cv2.convexHull(pixels.astype(np.float32))
    for i, j in np.ndindex(*shape):
        middle = (np.array([j, i]) + 0.5) * cell
        cells[i, j] |= cv2.pointPolygonTest(hull, (float(middle[0]), float(middle[1])), False) >= 0
    return cells
