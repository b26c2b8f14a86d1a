"""Chooses the views to calibrate from: sharp, still, unlike each other, and informative about the lens.

Views are offered one by one, from a video or live, and each is answered at once. Collecting ends when focal length and
principal point are known well enough, by a fit to the views so far, not after some number of views.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array

from ..boards.board import Board, TargetDetection
from ..boards.corner_grid import MIN_FOUND
from ..boards.detector import as_grey, find_board
from .calibrate import board_pose, fit_lens, require_one_size, why_useless
from .lens_model import REFERENCE_WIDTH_PX, LensModel

# --- What the views of a board cover: the image, the four directions of tilt, distances.

# Thresholds here and below: measured by python bench/calibration.py (rendered video).
CELLS_ACROSS = 8
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


# --- The views.

BLUR_PX, BLUR_FACTOR = 2.0, 2.0  # refused above: at 640 pixels of width, and of the sharpest views so far
MOTION_PX = 3.0  # refused above, between neighbouring images, at 640 pixels of width
ALIKE_PLACE, ALIKE_SIZE, ALIKE_LEAN_DEG, ALIKE_ROLL_DEG = 0.1, 0.2, 10.0, 25.0  # of the width; of its logarithm
FIRST_FIT, GROWTH = 6, 1.3  # fits after so many views, then after so many times more
PLENTY = 80  # views; more help little
ENOUGH_VIEWS = 12


class LensAccuracy(NamedTuple):
    """How well a lens is known: sd of the focal length (share) and of the principal point (px)."""

    focal_sd: float
    centre_sd_px: float


GOALS = LensAccuracy(focal_sd=0.001, centre_sd_px=1.0)


@dataclass(frozen=True, eq=False)
class _CollectedView:
    detection: TargetDetection
    placement: BoardPlacement
    roll: float
    blur_and_motion_px: float

    def unlike(self, other: _CollectedView) -> float:
        """1 and more: another view; less: the same again."""
        width = self.detection.image_size[0]
        turn = np.rad2deg(np.angle(np.exp(1j * (self.roll - other.roll))))
        differences = (
            np.hypot(*(self.placement.centre_px - other.placement.centre_px)) / (ALIKE_PLACE * width),
            np.log(self.placement.size / other.placement.size) / ALIKE_SIZE,
            np.rad2deg(np.hypot(*(self.placement.lean_rad - other.placement.lean_rad))) / ALIKE_LEAN_DEG,
            turn / ALIKE_ROLL_DEG,
        )
        return float(np.linalg.norm(differences))


class ViewCollector:
    """Collects views of ``board`` by one camera. ``every`` : take alike views, too (a few chosen photographs)."""

    def __init__(
        self, board: Board, *, model: str = "plumb_bob", every: bool = False, goals: LensAccuracy = GOALS
    ) -> None:
        self._board, self._model, self._every = board, LensModel(model), every
        self.goals = goals
        self._held: list[_CollectedView] = []
        self._lens: CameraModel | None = None
        self._fitted_sd: Array = np.empty(0)  # of fx fy cx cy, when it was fitted
        self._fitted, self._next_fit = 0, FIRST_FIT

    @property
    def detections(self) -> list[TargetDetection]:
        """The views to calibrate from, in the order of their frames."""
        return sorted((held.detection for held in self._held), key=lambda detection: detection.frame_index)

    def __len__(self) -> int:
        return len(self._held)

    def try_add(self, detection: TargetDetection, motion_px: float = 0.0) -> str:
        """Add the view and return "", or say why not. ``motion_px`` : how far it moved from the image before.

        Raises InputError for an image of another size, corners the board has not."""
        scale = max(detection.image_size[0] / REFERENCE_WIDTH_PX, 1.0)
        if detection.blur_px > max(BLUR_PX * scale, BLUR_FACTOR * self._sharpest()):
            return f"too blurred: by {detection.blur_px:.1f} px; hold it still, check focus and exposure"
        if not motion_px <= MOTION_PX * scale:
            return "the board moves: hold it still"
        if reason := why_useless(detection, self._board):
            return reason
        require_one_size([*self.detections[:1], detection])
        held = self._placed(detection, float(np.hypot(detection.blur_px, motion_px)))
        return "its pose cannot be told" if held is None else self._compare(held)

    @property
    def coverage(self) -> Coverage:
        """Coverage of the views taken so far."""
        size = self._held[0].detection.image_size if self._held else (4, 3)
        return coverage_of(
            [held.detection.pixels for held in self._held], [held.placement for held in self._held], size
        )

    @property
    def expected(self) -> LensAccuracy | None:
        """What a calibration from the views so far would know, since the last fit by their number; None until there are
        enough to tell."""
        if self._lens is None:
            return None
        sd = self._fitted_sd * np.sqrt(self._fitted / len(self))
        return LensAccuracy(float((sd[:2] / self._lens.K.diagonal()[:2]).max()), float(sd[2:].max()))

    @property
    def enough(self) -> bool:
        """Whether all is covered and known well enough, or so many views were taken that more help little."""
        expected = self.expected
        if expected is None or len(self) < ENOUGH_VIEWS or not self.coverage.complete:
            return False
        focal, centre = expected.focal_sd <= self.goals.focal_sd, expected.centre_sd_px <= self.goals.centre_sd_px
        return (focal and centre) or len(self) >= PLENTY

    def advice(self) -> str:
        """Return what to show next; "" when it is enough."""
        if self.enough:
            return ""
        if not self._held:
            return "show the whole board to the camera and hold it still"
        return self.coverage.advice() or "go on: tilted by 30 to 45 degrees, near, all over the image"

    def _sharpest(self) -> float:
        return float(np.percentile([held.blur_and_motion_px for held in self._held], 25)) if self._held else 0.0

    def _placed(self, detection: TargetDetection, blur_and_motion_px: float) -> _CollectedView | None:
        size = detection.image_size
        lens = self._lens or self._model.camera(detection.camera, float(max(size)), size)
        pose = board_pose(detection, self._board, lens)
        if pose is None:
            return None
        # the turn in the image: that of the board's long way through its corners
        along = detection.pixels[-1] - detection.pixels[0]
        roll = float(np.arctan2(along[1], along[0]))
        return _CollectedView(detection, placement_of(pose, detection), roll, blur_and_motion_px)

    def _compare(self, held: _CollectedView) -> str:
        distances = [held.unlike(other) for other in self._held]
        if not self._every and distances and min(distances) < 1.0:
            nearest = int(np.argmin(distances))
            if held.blur_and_motion_px >= self._held[nearest].blur_and_motion_px:
                return "like one that is there already: show the board elsewhere or tilted otherwise"
            self._held[nearest] = held
        elif len(self._held) >= PLENTY:
            return "there are views enough"
        else:
            self._held.append(held)
        self._fit_now_and_then()
        return ""

    def _fit_now_and_then(self) -> None:
        if len(self) < self._next_fit:
            return
        self._next_fit = int(np.ceil(GROWTH * len(self)))
        try:
            fit = fit_lens(self.detections, self._board, self._model)
        except InputError:
            return
        self._lens, self._fitted = fit.camera, len(self)
        self._fitted_sd = np.sqrt(np.diag(fit.covariance)[:4])
        again = [self._placed(held.detection, held.blur_and_motion_px) for held in self._held]
        self._held = [held for held in again if held is not None]


# --- From images to views.

NOT_SEEN = "the board is not seen"


class BoardImageProcessor:
    """Feeds the images of ``camera`` into a collector, and counts what became of them.

    ``thorough`` : look longer for the board in each image, for a few pictures that each matter.
    """

    def __init__(self, board: Board, camera: str, collector: ViewCollector, *, thorough: bool = False) -> None:
        self.board, self.camera, self.collector, self.thorough = board, camera, collector, thorough
        self.examined = self.found = 0
        self.reasons: Counter[str] = Counter()

    def process(
        self, image: np.ndarray, neighbour: np.ndarray | None, frame_index: int
    ) -> tuple[TargetDetection | None, str]:
        """Look at an image (H, W[, 3]) uint8; ``neighbour`` is the one just before it, if there is one.

        Returns the detection, None when the board was not found, and why it was not taken ("": it was). Raises
        InputError when the images change their size.
        """
        detection = find_board(image, self.board, camera=self.camera, frame_index=frame_index, thorough=self.thorough)
        reason = NOT_SEEN
        if detection is not None:
            moved = 0.0 if neighbour is None else motion_px(image, neighbour, detection.pixels)
            reason = self.collector.try_add(detection, moved)
        self.examined += 1
        self.found += detection is not None
        if reason:
            self.reasons[reason.partition(":")[0]] += 1
        return detection, reason


def motion_px(image: np.ndarray, neighbour: np.ndarray, pixels: Array) -> float:
    """Measure the median distance that the corners ``pixels`` (n, 2) of ``image`` travel to the ``neighbour``, px.

    By optical flow (Lucas & Kanade 1981, pyramids); infinite when too few corners are found again.
    """
    first, second = as_grey(image), as_grey(neighbour)
    if first.shape != second.shape:
        return float("inf")
    corners = pixels.astype(np.float32).reshape(-1, 1, 2)
    none = np.empty(0, np.float32)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, none, winSize=(15, 15), maxLevel=3)
    seen = np.ravel(found) == 1
    if moved is None or seen.mean() < MIN_FOUND:
        return float("inf")
    return float(np.median(np.hypot(*(moved - corners).reshape(-1, 2)[seen].T)))
