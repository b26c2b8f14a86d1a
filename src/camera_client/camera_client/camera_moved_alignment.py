"""By how much has the camera turned since a reference picture was taken? Found from another picture of the scene.

All edges of the scene that nobody hides move as one when the camera turns, as its rotation and its lens say. The three
angles are found by Gauss-Newton steps on the pictures themselves (Lucas and Kanade 1981, in the inverse compositional
form of Baker and Matthews, IJCV 2004), with weights that let go of what does not move with the rest: people, shadows,
a chair that was moved. A camera that was pushed aside is found, too: what is nearer moves more, but all moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import lens
from capture_rig.camera import CameraModel

from .camera_moved_points import Array, Picture, Points, choose_points, pictures
from .camera_moved_search import coarse_guesses
from .rotation import matrix_of, vector_of

MOST_STEPS, LAST_STEPS, CONVERGED_RAD = 8, 3, 2e-5
LETS_GO = 3.0  # standard deviations of the noise, or of the typical residual ...
SURE, SURE_SIGMAS = 0.3, 0.385  # ... which this share of the places tells: more than half may be hidden
AGREES_PX = 0.5  # a place agrees when its edge lies within so much (of a pixel at the working size) of where it should
AGREES_NOISE = 3.0  # ... or its brightness is so many standard deviations of the noise from what it should be
FEW_POINTS, FEW_CELLS = 60, 12
WELL_KNOWN = 0.5  # when so many agree there is no need to search
BY_CHANCE = 0.5  # a place that agrees as often as this with turns that are wrong tells nothing
WRONG_TURNS_RAD = np.radians([(a, b, c) for a in (-5, 0, 4) for b in (-4, 0, 5) for c in (-2, 1) if a or b])
SINGULAR = 1e-9

Weights = Callable[[Array, Points], npt.NDArray]


@dataclass(frozen=True, eq=False)
class Alignment:
    """How the camera stands, seen from how it stood.

    turn_rad (3,) : rotation vector of the camera in its own frame (x right, y down, z forward), radians: a direction d
    of then is the direction exp(turn) d of now. sd_rad (3,) : its standard deviations by noise. agreeing : share of
    the reference's edges, as far as they are in view, that are where this turn puts them, beyond what chance does: 0
    when the picture has nothing to do with the reference, 1 when nothing is hidden. agreeing_unmoved : the same without
    any turn.
    """

    turn_rad: Array
    sd_rad: Array
    agreeing: float
    agreeing_unmoved: float


class PictureAlignment:
    """Compares pictures with one reference. Not for two threads at a time."""

    def __init__(self, camera: CameraModel, mean: npt.NDArray[np.float32], sigma: float) -> None:
        """``mean`` (H, W[, 3]) : the reference, grey levels. ``sigma`` : noise of a frame's pixel, grey levels."""
        self._K, self._D = camera.K, camera.D
        self._levels = choose_points(camera, mean, sigma)
        self._chance = self._agree_by_chance(pictures(mean)[0])

    @property
    def tells(self) -> bool:
        """Whether the reference has edges enough, in parts enough of the picture, to tell anything by."""
        finest = self._levels[0]
        coarsest = self._levels[-1]
        enough = len(finest.value) >= FEW_POINTS and len(coarsest.value) >= FEW_CELLS
        return enough and len(np.unique(finest.cell)) >= FEW_CELLS

    def align(self, image: npt.NDArray, start_rad: Array | None = None, search: bool = True) -> Alignment | None:
        """The turn that fits ``image`` (H, W[, 3]) best; None when too little of the reference's edges is in view.

        It is looked for near ``start_rad``, and where that fits badly, with ``search``, everywhere within ten degrees.
        """
        if not self.tells:
            return None
        views = pictures(image)
        best = self._refine(views, self._levels[:1], np.zeros(3) if start_rad is None else start_rad)
        if search and (best is None or best.agreeing < WELL_KNOWN):
            for guess_rad in coarse_guesses(self._levels[-1], views[-1], float(self._K[0, 0])):
                other = self._refine(views, self._levels, guess_rad)
                if other is not None and (best is None or other.agreeing > best.agreeing):
                    best = other
        return best

    def _agree_by_chance(self, view: Picture) -> float:
        """Keep the points that seldom agree with wrong turns; returns how often they do."""
        points = self._levels[0]
        if not len(points.value):
            return 1.0
        found = [self._residual(view, points, matrix_of(turn)) for turn in WRONG_TURNS_RAD]
        agree = np.sum([_agree(residual, points) & seen for residual, seen in found], axis=0)
        share = agree / np.maximum(np.sum([seen for _, seen in found], axis=0), 1)
        self._levels[0] = points.only(share < BY_CHANCE)
        return float(np.mean(share[share < BY_CHANCE])) if (share < BY_CHANCE).any() else 1.0

    def _refine(self, views: Sequence[Picture], levels: Sequence[Points], start_rad: Array) -> Alignment | None:
        """From the coarsest of the ``levels`` to the finest, and at last by the places alone that agree."""
        R: Array | None = matrix_of(start_rad)
        for points, view in reversed(list(zip(levels, views, strict=False))):
            R = None if R is None else self._iterate(view, points, R, MOST_STEPS, _weights)
        R = None if R is None else self._iterate(views[0], levels[0], R, LAST_STEPS, _agree)
        return None if R is None else self._judge(views[0], R)

    def _iterate(self, view: Picture, points: Points, R: Array, steps: int, weights: Weights) -> Array | None:
        """Steps until the turn R moves no more."""
        for _ in range(steps):
            step = self._step(view, points, R, weights)
            if step is None:
                return None
            R = R @ matrix_of(-step)
            if np.abs(step).max() < CONVERGED_RAD * points.scale:
                break
        return R

    def _step(self, view: Picture, points: Points, R: Array, weights: Weights) -> Array | None:
        residual, seen = self._residual(view, points, R)
        weighted = points.slope * (weights(residual, points) * seen)[:, None]
        H = weighted.T @ points.slope
        if np.count_nonzero(seen) < FEW_POINTS / 4 or not _invertible(H):
            return None
        return np.linalg.solve(H, residual @ weighted)

    def _residual(self, view: Picture, points: Points, R: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """(n,) how much more contrast the view has where the turn R puts each place, and which places are in view."""
        rays = points.rays @ R.T
        ideal = rays[:, :2] / np.maximum(rays[:, 2:], 1e-3)
        at = lens.distort(ideal, self._D) * self._K.diagonal()[:2] + self._K[:2, 2]
        at = ((at - points.offset) / points.scale).clip(-9, 32766).astype(np.float32)
        seen = np.asarray(((at >= 0) & (at <= np.array(view.shape[::-1]) - 1)).all(axis=1))
        value = cv2.remap(view, at[:, :1], at[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return value.reshape(-1) - points.value, seen

    def _judge(self, view: Picture, R: Array) -> Alignment | None:
        points = self._levels[0]
        residual, seen = self._residual(view, points, R)
        agree = _agree(residual, points) & seen
        told = points.slope[agree] / points.noise
        H = told.T @ told
        if np.count_nonzero(seen) < FEW_POINTS or not _invertible(H):
            return None
        unmoved, seen_unmoved = self._residual(view, points, np.eye(3))
        return Alignment(
            turn_rad=vector_of(R),
            sd_rad=np.sqrt(np.linalg.inv(H).diagonal()),
            agreeing=self._beyond_chance(agree, seen),
            agreeing_unmoved=self._beyond_chance(_agree(unmoved, points) & seen_unmoved, seen_unmoved),
        )

    def _beyond_chance(self, agree: npt.NDArray[np.bool_], seen: npt.NDArray[np.bool_]) -> float:
        share = agree.sum() / max(int(seen.sum()), 1)
        return max(0.0, float((share - self._chance) / (1 - self._chance)))


def _agree(residual: Array, points: Points) -> npt.NDArray[np.bool_]:
    return np.abs(residual) < np.maximum(AGREES_NOISE * points.noise, AGREES_PX * points.steepness)


def _weights(residual: Array, points: Points) -> Array:
    """Geman and McClure: quadratic within a few standard deviations, and blind to what lies far beyond."""
    typical = max(float(np.quantile(np.abs(residual), SURE)) / SURE_SIGMAS, points.noise)
    x = residual / (LETS_GO * typical)
    return 1 / (1 + x * x) ** 2


def _invertible(H: Array) -> bool:
    values = np.linalg.eigvalsh(H)
    return bool(values[0] > SINGULAR * values[-1] > 0)
