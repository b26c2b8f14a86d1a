"""Chooses the views to calibrate from: sharp, still, unlike each other, and informative about the lens.

Views are offered one by one, from a video or live, and each is answered at once. Collecting ends when focal length and
principal point are known well enough, by a fit to the views so far, not after some number of views.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array

from ..boards.board import Board, TargetDetection
from ..boards.corner_grid import MIN_FOUND
from ..boards.detector import as_grey, find_board
from .calibrate import board_pose, fit_lens, require_one_size, why_useless
from .coverage import BoardPlacement, Coverage, coverage_of, placement_of
from .lens_model import REFERENCE_WIDTH_PX, LensModel

# Thresholds: measured by python bench/calibration.py (rendered video).
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
