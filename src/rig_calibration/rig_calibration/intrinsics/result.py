"""What the calibration of one lens comes to, and the report about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.lens import Array
from capture_rig.verdict import Verdict

from ..boards.board import TargetDetection
from ..bundle.outliers import RejectedDetection
from .coverage import BoardPlacement
from .lens_model import outermost_pixels


@dataclass(frozen=True)
class ModelChoice:
    """``model`` and why; rms_px: of a corner's coordinate in the median view, by model."""

    model: str
    rms_px: dict[str, float]
    reason: str


@dataclass(frozen=True, eq=False)
class ViewResult:
    """What one view contributed. ids (n,); pixels (n, 2) seen; residuals (n, 2) seen minus expected, px; rms_px of a
    corner's distance; look: where, how large and how tilted; T_camera_board (4, 4), m."""

    detection: TargetDetection
    ids: np.ndarray
    pixels: Array
    residuals: Array
    rms_px: float
    placement: BoardPlacement
    T_camera_board: Array


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """One camera's lens, how well it is known, and whether it will do.

    camera : pose = identity. rms_px : of the corners' distances (as OpenCV's). sigma_px : sd of a corner's coordinate,
    from the residuals. sd : by parameter name, px or without unit; covariance : theirs, in the same order.
    sd_enlarged_by : factor >= 1 by which sd exceeds what independent corner errors would give. warp_m : how far the
    board's middle stands out along x and y, and sd. views, left_out : what the result rests on, and what not.
    edge_sd_px : uncertainty of a ray at the four corners of the image (or as far as the lens model holds), the worst.
    choice : why this lens model, when it was chosen.
    """

    camera: CameraModel
    rms_px: float
    sigma_px: float
    sd: Mapping[str, float]
    covariance: Array
    sd_enlarged_by: float
    board_diagonal_m: float
    warp_m: tuple[float, float]
    warp_sd_m: tuple[float, float]
    views: tuple[ViewResult, ...]
    left_out: tuple[RejectedDetection, ...]
    edge_sd_px: float
    choice: ModelChoice | None
    verdict: Verdict

    @property
    def values(self) -> dict[str, float]:
        """The parameters by name, as ``sd``."""
        K, D = self.camera.K, self.camera.D
        return dict(zip(self.sd, [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D], strict=True))

    @property
    def reach(self) -> float:
        """How far from the image's centre the corners reach: a share of the way to the outermost pixels with a ray."""
        middle = (np.array([self.camera.width, self.camera.height]) - 1) / 2
        radii = [np.hypot(*(view.pixels - middle).T).max() for view in self.views]
        return float(max(radii) / np.hypot(*(outermost_pixels(self.camera) - middle).T).max())


def report_of(result: Intrinsics, about: Mapping[str, Any]) -> dict[str, Any]:
    """Make plain data for YAML; ``about`` (board, sources, versions, date) comes first."""
    return {
        **about,
        "camera": result.camera.name,
        "image_size": [result.camera.width, result.camera.height],
        "distortion_model": result.camera.distortion_model,
        "verdict": result.verdict.grade,
        "findings": [
            {"grade": finding.grade, "what": finding.what, "remedy": finding.remedy}
            for finding in result.verdict.findings
        ],
        "rms_px": _short(result.rms_px),
        "corner_sd_px": _short(result.sigma_px),
        "sd_enlarged_by": _short(result.sd_enlarged_by),
        "parameters": {
            name: {"value": float(value), "sd": _short(result.sd[name])} for name, value in result.values.items()
        },
        "uncertainty_in_image_corners_px": _short(result.edge_sd_px),
        "corners_reach": _short(result.reach),
        "lens_holds_to_deg": _short(float(np.rad2deg(result.camera.reach_rad))),
        "image_unused": _short(result.camera.unused_share),
        "board_bow_mm": {
            axis: {"value": _short(1e3 * warp), "sd": _short(1e3 * sd)}
            for axis, warp, sd in zip("xy", result.warp_m, result.warp_sd_m, strict=True)
        },
        **(
            {
                "model_choice": {
                    "rms_px": {name: _short(rms) for name, rms in result.choice.rms_px.items()},
                    "reason": result.choice.reason,
                }
            }
            if result.choice
            else {}
        ),
        "views": [_view(view) for view in result.views],
        "left_out": [_left_out(entry) for entry in result.left_out],
    }


def _view(view: ViewResult) -> dict[str, Any]:
    return {
        "frame": view.detection.frame_index,
        "corners": len(view.pixels),
        "rms_px": _short(view.rms_px),
        "tilt_deg": _short(float(np.rad2deg(view.placement.tilt))),
        "distance_m": _short(float(np.linalg.norm(view.T_camera_board[:3, 3]))),
    }


def _left_out(entry: RejectedDetection) -> dict[str, Any]:
    what = {"frame": entry.detection.frame_index, "why": entry.reason}
    return what if entry.whole else {**what, "corners": list(entry.corners)}


def _short(value: float) -> float:
    """Four digits: what a person reads."""
    return float(f"{value:.4g}")
