"""Chooses the views to calibrate from: sharp, still, unlike each other, and informative about the lens.

Views are offered one by one, from a video or live, and each is accepted or refused at once. Collecting ends when all
goals are covered by enough views; the calibration's verdict judges how well they determine the lens.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array

from ..boards.board import Board, TargetDetection
from ..boards.detector import find_board
from ..bundle.problem import poses_of, target_shape
from .lens_model import REFERENCE_WIDTH_PX, SIMPLE, LensModel

# --- What the views of a board cover: the image, the four directions of tilt, distances.

# Thresholds here and below: measured by python bench/calibration.py (rendered video).
CELLS_ACROSS = 8
TILT_WANTED_DEG = 25.0
SIZES_WANTED = 1.6  # largest board in the image over the smallest
IMAGE_WANTED = 0.85
SIDES = ("left", "right", "top", "bottom")


@dataclass(frozen=True, eq=False)
class BoardView:
    """A detection and the board's pose in it: centre (2,) px; size: side of its area, as a share of the image's;
    lean_rad (2,) lean of its edges at the image's right (+, left -) and bottom (+, top -) towards the camera; roll_rad
    in the image."""

    detection: TargetDetection
    centre_px: Array
    size: float
    lean_rad: Array
    roll_rad: float

    def unlike(self, other: BoardView) -> float:
        """1 and more: another view; less: the same again."""
        roll = np.rad2deg(np.angle(np.exp(1j * (self.roll_rad - other.roll_rad))))
        differences = (
            np.hypot(*(self.centre_px - other.centre_px)) / (ALIKE_PLACE * self.detection.image_size[0]),
            np.log(self.size / other.size) / ALIKE_SIZE,
            np.rad2deg(np.hypot(*(self.lean_rad - other.lean_rad))) / ALIKE_LEAN_DEG,
            roll / ALIKE_ROLL_DEG,
        )
        return float(np.linalg.norm(differences))


def view_of(detection: TargetDetection, board: Board, lens: CameraModel) -> BoardView | None:
    """Describe a detection for the person who holds the board, by a rough lens; None when the pose is unknown."""
    pixels, shape = detection.pixels, target_shape("", board.corners_board)
    poses = poses_of(detection.ids, lens.ideal_points(pixels), lens, shape)
    if poses is None:
        return None
    normal = poses.R[0, :, 2]  # of a plane's two solutions the one that fits better
    x, y, z = normal if normal @ poses.t[0] < 0 else -normal  # towards the camera
    angle = np.arctan2(np.hypot(x, y), -z)
    direction = -np.array([x, y]) / max(np.hypot(x, y), 1e-12)  # facing left (-x) means: its right edge is nearer
    area = cv2.contourArea(cv2.convexHull(pixels.astype(np.float32)))
    along = pixels[-1] - pixels[0]  # the board's long way through its corners
    return BoardView(
        detection,
        centre_px=pixels.mean(axis=0),
        size=float(np.sqrt(area / np.prod(detection.image_size))),
        lean_rad=angle * direction,
        roll_rad=float(np.arctan2(along[1], along[0])),
    )


@dataclass(frozen=True, eq=False)
class Coverage:
    """cells (rows, columns): which parts of the image the board has been in. tilt_deg: by side of the board as the
    image shows it, the strongest lean of that side towards the camera. sizes: largest over smallest."""

    cells: npt.NDArray[np.bool_]
    tilt_deg: dict[str, float]
    sizes: float

    def progress(self) -> dict[str, float]:
        """Return each goal's name and its progress, 0 to 1."""
        tilts = {f"tilt {side}": min(self.tilt_deg[side] / TILT_WANTED_DEG, 1.0) for side in SIDES}
        sizes = min(np.log(self.sizes) / np.log(SIZES_WANTED), 1.0)
        return {"image": min(float(self.cells.mean()) / IMAGE_WANTED, 1.0), **tilts, "distance": float(sizes)}

    @property
    def complete(self) -> bool:
        return min(self.progress().values()) >= 1.0

    def advice(self) -> str:
        """Return what to show next; "" when nothing is missing."""
        progress = self.progress()
        goal = min(progress, key=lambda name: progress[name])
        if progress[goal] >= 1.0:
            return ""
        if goal == "image":  # the ninth of it that lacks most
            rows = np.array_split(self.cells, 3, axis=0)
            filled = np.array([[part.mean() for part in np.array_split(row, 3, axis=1)] for row in rows])
            row, column = divmod(int(np.argmin(filled)), 3)
            place = f"{('upper', 'middle', 'lower')[row]} {('left', 'middle', 'right')[column]}"
            return f"bring the board into the {place} of the image"
        if goal == "distance":
            return "show the board nearer to the camera, or farther away"
        side = goal.removeprefix("tilt ")
        return f"tilt the board by 30 to 45 degrees, its {side} edge towards the camera"


def coverage_of(views: Sequence[BoardView]) -> Coverage:
    """Summarise the views."""
    size = views[0].detection.image_size if views else (4, 3)
    cells = np.zeros((max(round(CELLS_ACROSS * size[1] / size[0]), 2), CELLS_ACROSS), bool)
    for view in views:
        cells |= covered_cells(view.detection.pixels, size, cells.shape)
    x, y = np.rad2deg(np.array([view.lean_rad for view in views]).reshape(-1, 2)).T
    tilt = {side: float(lean.max(initial=0.0)) for side, lean in zip(SIDES, (-x, x, -y, y), strict=True)}
    sizes = [view.size for view in views] or [1.0]
    return Coverage(cells, tilt, max(sizes) / min(sizes))


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


# --- The views.

BLUR_PX, BLUR_FACTOR = 2.0, 2.0  # refused above: at 640 pixels of width, and of the sharpest views so far
ALIKE_PLACE, ALIKE_SIZE, ALIKE_LEAN_DEG, ALIKE_ROLL_DEG = 0.1, 0.2, 10.0, 25.0  # of the width; of its logarithm
MIN_CORNERS = 8
PLENTY = 80  # views; more help little
ENOUGH_VIEWS = 20
NOT_SEEN = "the board is not seen"


class ViewCollector:
    """Collects views of ``board`` by one ``camera``, and counts its images by their fate.

    ``every`` : accept similar views, too (a few chosen photographs). ``thorough`` : search longer for the board in each
    image, for a few pictures that each matter.
    """

    def __init__(
        self, board: Board, camera: str, *, model: str = SIMPLE, every: bool = False, thorough: bool = False
    ) -> None:
        self.board, self.camera, self.thorough = board, camera, thorough
        self.examined = self.found = 0
        self.reasons: Counter[str] = Counter()
        self._model, self._every = LensModel(model), every
        self._views: list[BoardView] = []

    @property
    def detections(self) -> list[TargetDetection]:
        """The views to calibrate from, in the order of their frames."""
        return sorted((view.detection for view in self._views), key=lambda detection: detection.frame_index)

    def __len__(self) -> int:
        return len(self._views)

    def process(self, image: np.ndarray, frame_index: int) -> tuple[TargetDetection | None, str]:
        """Search an image (H, W[, 3]) uint8.

        Returns the detection, None when the board was not found, and why it was not accepted ("": it was). Raises
        InputError when the images change their size.
        """
        detection = find_board(image, self.board, camera=self.camera, frame_index=frame_index, thorough=self.thorough)
        reason = NOT_SEEN if detection is None else self.try_add(detection)
        self.examined += 1
        self.found += detection is not None
        if reason:
            self.reasons[reason.partition(":")[0]] += 1
        return detection, reason

    def try_add(self, detection: TargetDetection) -> str:
        """Add the view and return "", or the reason why not. Raises InputError for an image of another size."""
        size, blurs_px = detection.image_size, [view.detection.blur_px for view in self._views]
        if self._views and size != self._views[0].detection.image_size:
            first = self._views[0].detection
            raise InputError(
                f"the images have several sizes: {first.image_size} in frame {first.frame_index}, {size} in frame "
                f"{detection.frame_index}",
                where=self.camera,
                remedy="Give images of one size: the one that the camera will work with.",
            )
        sharpest_px = np.percentile(blurs_px, 25) if blurs_px else 0.0
        if detection.blur_px > max(BLUR_PX * max(size[0] / REFERENCE_WIDTH_PX, 1.0), BLUR_FACTOR * sharpest_px):
            return f"too blurred: by {detection.blur_px:.1f} px; hold it still, check focus and exposure"
        if len(detection) < MIN_CORNERS:
            return f"shows {len(detection)} corners only"
        view = view_of(detection, self.board, self._model.camera(self.camera, float(max(size)), size))
        return "its pose cannot be told" if view is None else self._compare(view)

    @property
    def coverage(self) -> Coverage:
        """Coverage of the views accepted so far."""
        return coverage_of(self._views)

    @property
    def enough(self) -> bool:
        """Whether all goals are covered by enough views, or further views would help little."""
        return len(self) >= PLENTY or (len(self) >= ENOUGH_VIEWS and self.coverage.complete)

    def advice(self) -> str:
        """Return what to show next; "" when it is enough."""
        if self.enough:
            return ""
        if not self._views:
            return "show the whole board to the camera and hold it still"
        return self.coverage.advice() or "go on: tilted by 30 to 45 degrees, near, all over the image"

    def _compare(self, view: BoardView) -> str:
        distances = [view.unlike(other) for other in self._views]
        if not self._every and distances and min(distances) < 1.0:
            nearest = int(np.argmin(distances))
            if view.detection.blur_px >= self._views[nearest].detection.blur_px:
                return "like one that is there already: show the board elsewhere or tilted otherwise"
            self._views[nearest] = view
        elif len(self._views) >= PLENTY:
            return "there are views enough"
        else:
            self._views.append(view)
        return ""
