"""One page that shows how good a lens calibration is."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capture_rig.camera import CameraModel
from capture_rig.lens import Array

from .result import Intrinsics

SEEN, WRONG, CURVE = "#1769aa", "#b22222", "#d9772b"
ARROW_SHARE = 0.04  # of the image's width: the length of a typical residual arrow
MAX_ARROWS = 4000
PERCENTILE = 90


def draw(result: Intrinsics) -> Figure:
    """Draw residuals over the image, residual of each view, distortion over the radius."""
    figure = Figure(figsize=(13, 9.5), constrained_layout=True)
    axes = figure.subplot_mosaic([["image", "image"], ["views", "radius"]], height_ratios=[1.4, 1.0])
    over_image, by_view, over_radius = (axes[name] for name in ("image", "views", "radius"))
    _residuals(over_image, result)
    _views(by_view, result)
    _distortion(over_radius, result)
    figure.suptitle(
        f"{result.camera.name}: {result.verdict.grade}; {len(result.views)} views, rms {result.rms_px:.3f} px, "
        f"fx {result.values['fx']:.2f} ± {result.sd['fx']:.2f} px, fy {result.values['fy']:.2f} ± {result.sd['fy']:.2f}"
        f" px, centre ({result.values['cx']:.1f} ± {result.sd['cx']:.1f}, {result.values['cy']:.1f} ± "
        f"{result.sd['cy']:.1f}) px",
        fontsize=11,
    )
    return figure


def draw_residuals(axis: Axes, camera: CameraModel, pixels: Array, residuals: Array) -> float:
    """Draw residuals (n, 2) as arrows from their pixels (n, 2) over the camera's image; return the magnification."""
    every = max(1, -(-len(pixels) // MAX_ARROWS))
    typical = max(float(np.percentile(np.hypot(*residuals.T), PERCENTILE)), 1e-3)
    magnified = ARROW_SHARE * camera.width / typical
    axis.quiver(
        *pixels[::every].T,
        *residuals[::every].T,
        color=SEEN,
        angles="xy",
        scale_units="xy",
        scale=1 / magnified,
        width=0.0015,
    )
    _image_frame(axis, camera)
    return magnified


def _residuals(axis: Axes, result: Intrinsics) -> None:
    pixels = np.concatenate([view.pixels for view in result.views])
    magnified = draw_residuals(axis, result.camera, pixels, np.concatenate([view.residuals for view in result.views]))
    for entry in result.left_out:
        if entry.whole:
            axis.plot(*np.asarray(entry.detection.pixels).T, "x", color=WRONG, markersize=3, alpha=0.5)
    axis.set_title(f"residuals, {magnified:.0f} times larger; red: views left out", fontsize=10)


def _image_frame(axis: Axes, camera: CameraModel) -> None:
    axis.set_xlim(-0.5, camera.width - 0.5)
    axis.set_ylim(camera.height - 0.5, -0.5)
    axis.set_aspect("equal")
    axis.plot(*camera.K[:2, 2], "+", color=CURVE, markersize=14)
    axis.set_xlabel("px")


def _views(axis: Axes, result: Intrinsics) -> None:
    names = [str(view.detection.frame_index) for view in result.views]
    axis.bar(range(len(names)), [view.rms_px for view in result.views], color=SEEN)
    axis.axhline(result.rms_px, color=CURVE, label=f"all: {result.rms_px:.3f} px")
    axis.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axis.set_xlabel("frame")
    axis.set_ylabel("rms of a corner's distance [px]")
    axis.set_title("residual of each view", fontsize=10)
    axis.legend(loc="upper left")


def _distortion(axis: Axes, result: Intrinsics) -> None:
    """How far the lens moves a point outwards, along four directions from the principal point."""
    camera = result.camera
    ends = {
        "right": [camera.width - 1, camera.K[1, 2]],
        "left": [0, camera.K[1, 2]],
        "corner": [camera.width - 1, camera.height - 1],
        "opposite corner": [0, 0],
    }
    for name, end in ends.items():
        pixels = camera.K[:2, 2] + np.linspace(0, 1, 60)[:, None] * (np.array(end, float) - camera.K[:2, 2])
        rays = camera.rays_world(pixels)
        ideal = rays[:, :2] / rays[:, 2:] * camera.K.diagonal()[:2]
        radius = np.hypot(*(pixels - camera.K[:2, 2]).T)
        axis.plot(radius, radius - np.hypot(*ideal.T), label=name)
    reach = max(np.hypot(*(view.pixels - camera.K[:2, 2]).T).max() for view in result.views)
    axis.axvline(reach, color=WRONG, linestyle=":", label="corners were seen up to here")
    axis.set_xlabel("distance from the principal point [px]")
    axis.set_ylabel("distortion [px]")
    axis.set_title("moved outwards by the lens", fontsize=10)
    axis.legend(loc="best", fontsize=8)
