"""What the calibration of one camera comes to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.verdict import Verdict

from ..boards.sighting import Sighting
from .model_choice import Choice
from .parameters import Array
from .pose import BoardView
from .robust_fit import LeftOut


@dataclass(frozen=True, eq=False)
class ViewResult:
    """What one view contributed. ids (n,); pixels (n, 2) seen; residuals (n, 2) seen minus expected, px; rms_px of a
    corner's distance; look: where, how large and how tilted; T_camera_board (4, 4), m."""

    sighting: Sighting
    ids: np.ndarray
    pixels: Array
    residuals: Array
    rms_px: float
    look: BoardView
    T_camera_board: Array


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """One camera's lens, how well it is known, and whether it will do.

    camera : pose = identity. rms_px : of the corners' distances (as OpenCV's). sigma_px : sd of a corner's coordinate,
    from the residuals. sd : by parameter name, px or without unit; covariance : theirs, in the same order. jackknife :
    factor >= 1 by which sd and covariance exceed what independent corner errors would give. bow_m : how far the board's
    middle stands out along x and y, and sd. views, left_out : what the result rests on, and what not. edge_sd_px :
    uncertainty of a ray at the four corners of the image, the worst. choice : why this lens model, when it was chosen.
    """

    camera: CameraModel
    rms_px: float
    sigma_px: float
    sd: Mapping[str, float]
    covariance: Array
    jackknife: float
    board_diagonal_m: float
    bow_m: tuple[float, float]
    bow_sd_m: tuple[float, float]
    views: tuple[ViewResult, ...]
    left_out: tuple[LeftOut, ...]
    edge_sd_px: float
    choice: Choice | None
    verdict: Verdict

    @property
    def values(self) -> dict[str, float]:
        """The parameters by name, as ``sd``."""
        K, D = self.camera.K, self.camera.D
        return dict(zip(self.sd, [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D], strict=True))

    @property
    def reach(self) -> float:
        """How far from the image's centre the corners reach: a share of the half diagonal."""
        size = np.array([self.camera.width, self.camera.height])
        radii = [np.hypot(*(view.pixels - (size - 1) / 2).T).max() for view in self.views]
        return float(max(radii) / (np.hypot(*size) / 2))
