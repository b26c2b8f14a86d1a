"""What the calibration of one lens comes to, whether it will do, and the report about it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.lens import Array
from capture_rig.verdict import REDO, USABLE, Finding, Verdict, graded

from ..boards.board import TargetDetection
from ..bundle.robust_fit import CLEAR_SDS, RejectedDetection
from .coverage import BoardPlacement
from .lens_model import (
    ASPECT_PRIOR,
    CENTRE_PRIOR,
    FISHEYE,
    REFERENCE_WIDTH_PX,
    SIMPLE,
    WARP_PRIOR,
    LensModel,
    outermost_pixels,
)


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


# --- Is it good enough, and if not, what to do about it?


# Limits of USABLE and REDO, px at 640 pixels of width: judgement.
FEW_VIEWS = (12, 6)
FOCAL_SD, CENTRE_SD_PX = (0.002, 0.008), (1.0, 4.0)  # the first of the focal length
EDGE_SD_PX = (2.0, 200.0)
REACH = (0.75, 0.5)  # of the half diagonal
TILT_DEG = (20.0, 8.0)
NOISE_PX = (0.4, 1.2)  # sd of a corner's coordinate
FOCAL_RANGE = (0.2, 8.0)  # of the image's longer side; 0.24: a fisheye of 190 degrees in the height of 4:3
LEFT_OUT_SHARE, CORNERS_LEFT_OUT_SHARE = (0.2, 0.5), (0.03, inf)
UNUSED = UNUSED_GOOD, UNUSED_USABLE = 0.001, 0.3  # of the image's pixels: without rays
WIDE_HALF_ANGLE_DEG = 50.0  # off the axis: beyond, plumb_bob misses the classical wide lenses by more than corners err
UNDETERMINED = 0.5  # of the prior's sd: the views say next to nothing about a coefficient


def lens_findings(result: Intrinsics) -> Iterator[Finding]:
    """Find what is wrong with a calibration, worst causes first."""
    yield from _views(result)
    yield from _accuracy(result)
    yield from _coefficients(result)
    yield from _reach(result)
    yield from _noise(result)
    yield from _plausibility(result)


def _views(result: Intrinsics) -> Iterator[Finding]:
    count = len(result.views)
    remedy = "take 20 or more, tilted, near and far, all over the image"
    yield from _too_little(count, FEW_VIEWS, f"only {count} views", remedy)
    whole = [entry for entry in result.left_out if entry.whole]
    first = f" (the first: {whole[0].reason})" if whole else ""
    yield from graded(
        len(whole) / (count + len(whole)),
        LEFT_OUT_SHARE,
        f"{len(whole)} of {count + len(whole)} views were left out{first}",
        "hold the board still, film one flat board only; try --model auto",
    )
    single = sum(len(entry.corners) for entry in result.left_out)
    share = single / max(single + sum(len(view.ids) for view in result.views), 1)
    yield from graded(
        share,
        CORNERS_LEFT_OUT_SHARE,
        f"{100 * share:.0f} % of the corners contradict the others and were left out",
        "the lens may need another model: try --model auto",
    )
    tilts = np.rad2deg(sorted((view.placement.tilt for view in result.views), reverse=True))
    typical = tilts[min(len(tilts) // 4, len(tilts) - 1)]  # a quarter of the views are tilted more
    yield from _too_little(
        typical,
        TILT_DEG,
        f"three quarters of the views are tilted by less than {typical:.0f} degrees: distance and focal "
        "length are hard to tell apart",
        "tilt the board by 30 to 45 degrees, in all four directions",
    )


def _accuracy(result: Intrinsics) -> Iterator[Finding]:
    values, sd = result.values, result.sd
    focal, centre = max(sd["fx"] / values["fx"], sd["fy"] / values["fy"]), max(sd["cx"], sd["cy"])
    yield from graded(
        focal,
        FOCAL_SD,
        f"the focal length is known to {100 * focal:.2g} % only",
        "more views with the board tilted by 30 to 45 degrees, near enough to fill half the image",
    )
    yield from graded(
        centre / _scale(result),
        CENTRE_SD_PX,
        f"the principal point is known to {centre:.1f} px only",
        "more views with the board tilted, also turned by a quarter in the image plane",
    )


def _coefficients(result: Intrinsics) -> Iterator[Finding]:
    camera = result.camera
    prior = LensModel(camera.distortion_model).distortion_prior_sd(camera.K[0, 0], (camera.width, camera.height))
    # of a wide lens the coefficients may make up for each other: there the rays count, below
    rich = camera.distortion_model != SIMPLE
    outermost = np.hypot(*camera.ideal_points(outermost_pixels(camera)).T).max()
    lost = [name for name, sd in prior.items() if result.sd[name] > UNDETERMINED * sd]
    if lost and not (rich and np.rad2deg(np.arctan(outermost)) > WIDE_HALF_ANGLE_DEG):
        closer = "bring the board closer to the image's corners"
        yield Finding(
            REDO if rich else USABLE,
            f"the views do not determine {', '.join(lost)}",
            f"use --model plumb_bob, or {closer}" if rich else closer,
        )
    yield from graded(
        result.edge_sd_px / _scale(result),
        EDGE_SD_PX,
        f"in the image's corners rays are uncertain by {result.edge_sd_px:.1f} px",
        "bring the board into all four corners of the image",
    )


def _reach(result: Intrinsics) -> Iterator[Finding]:
    camera, share, reach = result.camera, result.camera.unused_share, result.reach
    remedy = "nothing is expected to be seen there"
    if camera.distortion_model != FISHEYE:
        remedy += "; to use it, bring a ChArUco board, which may leave the image, into its corners"
    if camera.distortion_model == SIMPLE:
        remedy += ", and calibrate with --model auto"
    yield from graded(
        share, (UNUSED_GOOD, inf) if camera.distortion_model == FISHEYE else UNUSED, unused_text(camera), remedy
    )
    yield from _too_little(
        reach,
        REACH,
        f"board corners reach only {100 * reach:.0f} % of the way to the image's corners; farther out "
        "the distortion is a guess",
        "bring the board into the image's corners",
    )


def unused_text(camera: CameraModel) -> str:
    """Say how much of the image has no rays that are used, and from which angle on."""
    ends = "undistorted picture ends at" if camera.distortion_model == FISHEYE else "lens model holds up to"
    share = f"{100 * camera.unused_share:.1f} % of the image is not used"
    return f"the {ends} {np.rad2deg(camera.reach_rad):.0f} degrees: the outer {share}"


def _noise(result: Intrinsics) -> Iterator[Finding]:
    causes = (
        "board not flat, moving during exposure, rolling shutter, or the lens refocused or zoomed on the way: film "
        "a stiff board held still, with focus and zoom fixed"
    )
    missed = f"corners miss their places by {result.sigma_px:.2f} px"
    yield from graded(result.sigma_px / _scale(result), NOISE_PX, missed, causes)


def _plausibility(result: Intrinsics) -> Iterator[Finding]:
    camera, values = result.camera, result.values
    longer = max(camera.width, camera.height)
    if not FOCAL_RANGE[0] <= values["fx"] / longer <= FOCAL_RANGE[1]:
        yield Finding(
            REDO,
            f"a focal length of {values['fx']:.0f} px is implausible for images {camera.width} wide",
            "tilt the board more; check that the views come from one camera with fixed zoom",
        )
    aspect = abs(values["fx"] / values["fy"] - 1)
    yield from graded(
        aspect,
        (ASPECT_PRIOR, inf),
        f"fx and fy differ by {100 * aspect:.1f} %",
        "check that fields are as wide and as high as given, and that images are not stretched",
    )
    offset = np.hypot(values["cx"] - (camera.width - 1) / 2, values["cy"] - (camera.height - 1) / 2)
    yield from graded(
        offset / longer,
        (CENTRE_PRIOR, inf),
        f"the principal point lies {offset:.0f} px from the image's centre",
        "usual for a cut-out of a larger sensor only; else tilt the board more",
    )
    for axis, warp, sd in zip(("rows", "columns"), result.warp_m, result.warp_sd_m, strict=True):
        yield from graded(
            abs(warp),
            (max(CLEAR_SDS * sd, WARP_PRIOR * result.board_diagonal_m), inf),
            f"the board is bent along its {axis}: its middle stands out by {1e3 * warp:.1f} mm",
            "allowed for here, but glue it to something flat before it measures the rig",
        )


def _too_little(value: float, limits: tuple[float, float], what: str, remedy: str) -> Iterator[Finding]:
    """Yield a finding where a value falls short of its limits."""
    return graded(-value, (-limits[0], -limits[1]), what, remedy)


def _scale(result: Intrinsics) -> float:
    return max(result.camera.width, result.camera.height) / REFERENCE_WIDTH_PX
