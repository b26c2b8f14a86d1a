"""Is a lens calibration good enough, and if not, what to do about it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.verdict import REDO, USABLE, Finding

from .lens_model import LensModel
from .model_choice import RICH
from .ray_uncertainty import outermost_pixels
from .result import Intrinsics

FEW_VIEWS, SCARCE_VIEWS = 6, 12
# Thresholds: judgement; the last judgement.
FOCAL_SD_GOOD, FOCAL_SD_USABLE = 0.002, 0.008  # of the focal length
CENTRE_SD_GOOD_PX, CENTRE_SD_USABLE_PX = 1.0, 4.0  # at 640 pixels of width
EDGE_SD_GOOD_PX, EDGE_SD_USABLE_PX = 2.0, 200.0  # at 640 pixels of width
REACH_GOOD, REACH_USABLE = 0.75, 0.5  # of the half diagonal
TILT_GOOD_DEG, TILT_USABLE_DEG = 20.0, 8.0
NOISE_GOOD_PX, NOISE_USABLE_PX = 0.4, 1.2  # sd of a corner's coordinate, at 640 pixels of width
NOISE_FACTOR = 3.0  # residuals against what the corners' own sharpness promises
NOISE_HARMLESS_PX = 0.15
ASPECT_TOLERANCE = 0.02
CENTRE_TOLERANCE = 0.12  # of the image's longer side
FOCAL_RANGE = (0.3, 8.0)  # of the image's longer side
LEFT_OUT_SHARE, CORNERS_LEFT_OUT_SHARE = 0.2, 0.03
BOW_SDS, BOW_SHARE = 4.0, 0.002  # of the board's diagonal
UNUSED_GOOD, UNUSED_USABLE = 0.001, 0.3  # of the image's pixels: without rays; above, the lens needs another model
WIDE_HALF_ANGLE_DEG = 50.0  # off the axis: beyond, plumb_bob misses the classical wide lenses by more than corners err
UNDETERMINED = 0.5  # of the prior's sd: the views say next to nothing about a coefficient
REFERENCE_WIDTH_PX = 640


def lens_findings(result: Intrinsics) -> Iterator[Finding]:
    """Find what is wrong with a calibration, worst causes first."""
    yield from _views(result)
    yield from _tilt(result)
    yield from _accuracy(result)
    yield from _coefficients(result)
    yield from _unused(result)
    yield from _reach(result)
    yield from _noise(result)
    yield from _plausibility(result)
    yield from _board(result)


def _graded(value: float, good: float, usable: float, what: str, remedy: str) -> Iterator[Finding]:
    """Yield a finding when ``value`` exceeds ``good``, a bad one when it exceeds ``usable``."""
    if not value <= good:
        yield Finding(USABLE if value <= usable else REDO, what, remedy)


def _views(result: Intrinsics) -> Iterator[Finding]:
    count = len(result.views)
    yield from _graded(
        -count,
        -SCARCE_VIEWS,
        -FEW_VIEWS,
        f"only {count} views",
        "take 20 or more, tilted, near and far, all over the image",
    )
    whole = [entry for entry in result.left_out if entry.whole]
    if len(whole) > LEFT_OUT_SHARE * (count + len(whole)):
        yield Finding(
            USABLE,
            f"{len(whole)} of {count + len(whole)} views were left out, the first because it {whole[0].reason}",
            "hold the board still, film one flat board only; try --model auto",
        )
    single = sum(len(entry.corners) for entry in result.left_out)
    share = single / max(single + sum(len(view.ids) for view in result.views), 1)
    if share > CORNERS_LEFT_OUT_SHARE:
        yield Finding(
            USABLE,
            f"{100 * share:.0f} % of the corners contradict the others and were left out",
            "the lens may need another model: try --model auto",
        )


def _tilt(result: Intrinsics) -> Iterator[Finding]:
    tilts = np.rad2deg(sorted((view.placement.tilt for view in result.views), reverse=True))
    typical = tilts[min(len(tilts) // 4, len(tilts) - 1)]  # a quarter of the views are tilted more
    yield from _graded(
        -typical,
        -TILT_GOOD_DEG,
        -TILT_USABLE_DEG,
        f"three quarters of the views are tilted by less than {typical:.0f} degrees: distance and focal "
        "length are hard to tell apart",
        "tilt the board by 30 to 45 degrees, in all four directions",
    )


def _accuracy(result: Intrinsics) -> Iterator[Finding]:
    values, sd = result.values, result.sd
    focal = max(sd["fx"] / values["fx"], sd["fy"] / values["fy"])
    yield from _graded(
        focal,
        FOCAL_SD_GOOD,
        FOCAL_SD_USABLE,
        f"the focal length is known to {100 * focal:.2g} % only",
        "more views with the board tilted by 30 to 45 degrees, near enough to fill half the image",
    )
    centre, scale = max(sd["cx"], sd["cy"]), _scale(result)
    yield from _graded(
        centre / scale,
        CENTRE_SD_GOOD_PX,
        CENTRE_SD_USABLE_PX,
        f"the principal point is known to {centre:.1f} px only",
        "more views with the board tilted, also turned by a quarter in the image plane",
    )


def _coefficients(result: Intrinsics) -> Iterator[Finding]:
    camera = result.camera
    prior = LensModel(camera.distortion_model).distortion_prior_sd(camera.K[0, 0], (camera.width, camera.height))
    # of a wide lens the coefficients may make up for each other: there the rays count, below
    rich = camera.distortion_model == RICH
    lost = [name for name, sd in prior.items() if result.sd[name] > UNDETERMINED * sd]
    if lost and not (rich and _half_angle_deg(camera) > WIDE_HALF_ANGLE_DEG):
        yield Finding(
            REDO if rich else USABLE,
            f"the views do not determine {', '.join(lost)}",
            "use --model plumb_bob, or bring the board closer to the image's corners"
            if rich
            else "bring the board closer to the image's corners",
        )
    scale = _scale(result)
    yield from _graded(
        result.edge_sd_px / scale,
        EDGE_SD_GOOD_PX,
        EDGE_SD_USABLE_PX,
        f"in the image's corners rays are uncertain by {result.edge_sd_px:.1f} px",
        "bring the board into all four corners of the image",
    )


def _half_angle_deg(camera: CameraModel) -> float:
    """Off the axis, of the outermost pixels."""
    return float(np.rad2deg(np.arctan(np.hypot(*camera.ideal_points(outermost_pixels(camera)).T).max())))


def _unused(result: Intrinsics) -> Iterator[Finding]:
    camera, share = result.camera, 100 * result.camera.unused_share
    yield from _graded(
        share / 100,
        UNUSED_GOOD,
        UNUSED_USABLE,
        f"the lens model holds up to {np.rad2deg(camera.reach_rad):.0f} degrees: the outer {share:.1f} % of the image "
        "is not used",
        "nothing is expected to be seen there; to use it, bring a ChArUco board, which may leave the image, into its "
        "corners" + ("" if camera.distortion_model == RICH else ", and calibrate with --model auto"),
    )


def _reach(result: Intrinsics) -> Iterator[Finding]:
    reach = result.reach
    yield from _graded(
        -reach,
        -REACH_GOOD,
        -REACH_USABLE,
        f"board corners reach only {100 * reach:.0f} % of the way to the image's corners; farther out "
        "the distortion is a guess",
        "bring the board into the image's corners",
    )


def _noise(result: Intrinsics) -> Iterator[Finding]:
    scale, sigma = _scale(result), result.sigma_px
    causes = (
        "board not flat, moving during exposure, rolling shutter, or the lens refocused or zoomed on the way: film "
    )
    causes += "a stiff board held still, with focus and zoom fixed"
    yield from _graded(
        sigma / scale, NOISE_GOOD_PX, NOISE_USABLE_PX, f"corners miss their places by {sigma:.2f} px", causes
    )
    promised = float(np.median([view.detection.sigma_px for view in result.views]))
    if NOISE_FACTOR * promised < sigma <= NOISE_GOOD_PX * scale and sigma > NOISE_HARMLESS_PX * scale:
        yield Finding(
            USABLE, f"corners miss their places by {sigma:.2f} px though they are sharp to {promised:.2f} px", causes
        )


def _plausibility(result: Intrinsics) -> Iterator[Finding]:
    camera, values = result.camera, result.values
    longer = max(camera.width, camera.height)
    focal = values["fx"] / longer
    if not FOCAL_RANGE[0] <= focal <= FOCAL_RANGE[1]:
        yield Finding(
            REDO,
            f"a focal length of {values['fx']:.0f} px is implausible for images {camera.width} wide",
            "tilt the board more; check that the views come from one camera with fixed zoom",
        )
    aspect = abs(values["fx"] / values["fy"] - 1)
    if aspect > ASPECT_TOLERANCE:
        yield Finding(
            USABLE,
            f"fx and fy differ by {100 * aspect:.1f} %",
            "check that fields are as wide and as high as given, and that images are not stretched",
        )
    offset = np.array([values["cx"], values["cy"]]) - (np.array([camera.width, camera.height]) - 1) / 2
    if np.hypot(*offset) > CENTRE_TOLERANCE * longer:
        yield Finding(
            USABLE,
            f"the principal point lies {np.hypot(*offset):.0f} px from the image's centre",
            "usual for a cut-out of a larger sensor only; else tilt the board more",
        )


def _board(result: Intrinsics) -> Iterator[Finding]:
    for axis, bow, sd in zip(("rows", "columns"), result.bow_m, result.bow_sd_m, strict=True):
        if abs(bow) > BOW_SDS * sd and abs(bow) > BOW_SHARE * result.board_diagonal_m:
            yield Finding(
                USABLE,
                f"the board is bent along its {axis}: its middle stands out by {1e3 * bow:.1f} mm",
                "allowed for here, but glue it to something flat before it measures the rig",
            )


def _scale(result: Intrinsics) -> float:
    return max(result.camera.width, result.camera.height) / REFERENCE_WIDTH_PX
