"""What the calibration of one lens comes to, whether it will do, and the report about it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Any

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.lens import Array
from capture_rig.verdict import Finding, Verdict, graded, judge

from ..boards.board import TargetDetection
from ..bundle.robust_fit import CLEAR_SDS, RejectedDetection
from .lens_model import FISHEYE, REFERENCE_WIDTH_PX, WARP_PRIOR


@dataclass(frozen=True, eq=False)
class ViewResult:
    """What one view contributed: the corners that counted; residuals (n, 2) seen minus expected, px; T_camera_board
    (4, 4), m."""

    detection: TargetDetection
    residuals: Array
    T_camera_board: Array

    @property
    def rms_px(self) -> float:
        """Of a corner's distance."""
        return rms_length([self])


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """One camera's lens, its uncertainty, and the verdict on it.

    camera : pose = identity. sigma_px : sd of a corner's coordinate, from the residuals; the typical view's. sd : by
    parameter name, px or without unit; covariance : theirs, in the same order. sd_enlarged_by : ratio >= 1 of sd to
    that from independent corner errors. warp_m : offset of the board's middle by bending along x and y, and sd. views,
    left_out : used and rejected views. edge_sd_px : uncertainty of a ray at the four corners of the image (or as far as
    the lens model holds), the worst. choice : the lens model and why, when it was chosen.
    """

    camera: CameraModel
    sigma_px: float
    sd: Mapping[str, float]
    covariance: Array
    sd_enlarged_by: float
    board_diagonal_m: float
    warp_m: tuple[float, ...]
    warp_sd_m: tuple[float, ...]
    views: tuple[ViewResult, ...]
    left_out: tuple[RejectedDetection, ...]
    edge_sd_px: float
    choice: str = ""

    @property
    def values(self) -> dict[str, float]:
        """The parameters by name, as ``sd``."""
        K, D = self.camera.K, self.camera.D
        return dict(zip(self.sd, [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D], strict=True))

    @property
    def rms_px(self) -> float:
        """Of the corners' distances (as OpenCV's)."""
        return rms_length(self.views)

    @property
    def typical_px(self) -> float:
        """Of the corners' distances in the median view, a view that was left out being worse than any other."""
        return float(np.median([view.rms_px for view in self.views] + [inf] * len(self.left_out)))

    @cached_property
    def verdict(self) -> Verdict:
        """Whether it is good enough, and if not, what to do."""
        return judge(lens_findings(self))


def rms_length(views: Sequence[ViewResult]) -> float:
    """Compute the root mean square length of the views' residuals, px."""
    return float(np.sqrt((np.concatenate([view.residuals for view in views]) ** 2).sum(axis=1).mean()))


def report_of(result: Intrinsics, about: Mapping[str, Any]) -> dict[str, Any]:
    """Make plain data for YAML; ``about`` (board, sources, versions, date) comes first."""
    return {
        **about,
        "camera": result.camera.name,
        "image_size": [result.camera.width, result.camera.height],
        "distortion_model": result.camera.distortion_model,
        "verdict": result.verdict.grade,
        "findings": [{key: getattr(f, key) for key in ("grade", "what", "remedy")} for f in result.verdict.findings],
        "rms_px": _short(result.rms_px),
        "corner_sd_px": _short(result.sigma_px),
        "sd_enlarged_by": _short(result.sd_enlarged_by),
        "parameters": {
            name: {"value": float(value), "sd": _short(result.sd[name])} for name, value in result.values.items()
        },
        "uncertainty_in_image_corners_px": _short(result.edge_sd_px),
        "lens_holds_to_deg": _short(float(np.rad2deg(result.camera.reach_rad))),
        "image_unused": _short(result.camera.unused_share),
        "board_bow_mm": {
            axis: {"value": _short(1e3 * warp), "sd": _short(1e3 * sd)}
            for axis, warp, sd in zip("xy", result.warp_m, result.warp_sd_m, strict=True)
        },
        "model_choice": result.choice,
        "views": [
            {
                "frame": view.detection.frame_index,
                "corners": len(view.detection),
                "rms_px": _short(view.rms_px),
                "tilt_deg": _short(float(np.rad2deg(np.arccos(min(abs(view.T_camera_board[2, 2]), 1.0))))),
                "distance_m": _short(float(np.linalg.norm(view.T_camera_board[:3, 3]))),
            }
            for view in result.views
        ],
        "left_out": [{"frame": entry.detection.frame_index, "why": entry.reason} for entry in result.left_out],
    }


def _short(value: float) -> float:
    """Format a number with four digits."""
    return float(f"{value:.4g}")


# --- Is it good enough, and if not, what to do about it?


# Limits of USABLE and REDO, px at 640 pixels of width: judgement. What the views do not show (too few of them, no tilt,
# nothing in the image's corners) shows as uncertainty.
FOCAL_SD, CENTRE_SD_PX = (0.002, 0.008), (1.0, 4.0)  # the first of the focal length
EDGE_SD_PX = (2.0, 25.0)
NOISE_PX = (0.4, 1.2)  # sd of a corner's coordinate
LEFT_OUT_SHARE = (0.2, 0.5)
UNUSED_GOOD, UNUSED_USABLE = 0.001, 0.3  # of the image's pixels: without rays


def lens_findings(result: Intrinsics) -> Iterator[Finding]:
    """Yield faults of a calibration, worst causes first; sagoma doctor judges whether such a lens exists."""
    values, sd, camera = result.values, result.sd, result.camera
    scale = max(camera.width, camera.height) / REFERENCE_WIDTH_PX
    tilted = "more views, the board tilted by 30 to 45 degrees in all four directions and filling half the image"
    focal, centre = max(sd["fx"] / values["fx"], sd["fy"] / values["fy"]), max(sd["cx"], sd["cy"])
    what = f"the focal length is known to {100 * focal:.2g} % only"
    yield from graded(focal, FOCAL_SD, what, tilted)
    what = f"the principal point is known to {centre:.1f} px only"
    yield from graded(centre / scale, CENTRE_SD_PX, what, tilted + ", also turned by a quarter in its plane")
    what = f"in the image's corners rays are uncertain by {result.edge_sd_px:.1f} px"
    yield from graded(result.edge_sd_px / scale, EDGE_SD_PX, what, "bring the board into all four corners of the image")
    fisheye, remedy = camera.distortion_model == FISHEYE, "nothing is expected to be seen there"
    if not fisheye:
        remedy += "; to use it, bring a ChArUco board, which may leave the image, into its corners, and calibrate with "
        remedy += "--model auto"
    limits = (UNUSED_GOOD, inf) if fisheye else (UNUSED_GOOD, UNUSED_USABLE)
    yield from graded(camera.unused_share, limits, unused_text(camera), remedy)
    gone, views = result.left_out, len(result.views) + len(result.left_out)
    what = f"{len(gone)} of {views} views were left out" + "".join(f" (the first: {out.reason})" for out in gone[:1])
    remedy = "hold the board still, film one flat board only; try --model auto"
    yield from graded(len(gone) / views, LEFT_OUT_SHARE, what, remedy)
    what = f"corners miss their places by {result.sigma_px:.2f} px"
    remedy = (
        "board not flat, moving during exposure, rolling shutter, or the lens refocused or zoomed on the way: film a "
    )
    remedy += "stiff board held still, with focus and zoom fixed"
    yield from graded(result.sigma_px / scale, NOISE_PX, what, remedy)
    for axis, warp, warp_sd in zip(("rows", "columns"), result.warp_m, result.warp_sd_m, strict=True):
        limit = max(CLEAR_SDS * warp_sd, WARP_PRIOR * result.board_diagonal_m)
        what = f"the board is bent along its {axis}: its middle stands out by {1e3 * warp:.1f} mm"
        remedy = "allowed for here, but glue it to something flat before it measures the rig"
        yield from graded(abs(warp), (limit, inf), what, remedy)


def unused_text(camera: CameraModel) -> str:
    """Return in words the share of the image without usable rays, and the angle from which on."""
    ends = "undistorted picture ends at" if camera.distortion_model == FISHEYE else "lens model holds up to"
    share = f"{100 * camera.unused_share:.1f} % of the image is not used"
    return f"the {ends} {np.rad2deg(camera.reach_rad):.0f} degrees: the outer {share}"
