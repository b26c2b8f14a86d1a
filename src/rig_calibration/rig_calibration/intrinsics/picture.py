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
    """Draw residuals over the image, and the residual of each view."""
    figure = Figure(figsize=(13, 9.5), constrained_layout=True)
    over_image, by_view = figure.subplots(2, 1, height_ratios=[2.0, 1.0])
    camera, rms = result.camera, [view.rms_px for view in result.views]
    pixels = np.concatenate([view.detection.pixels for view in result.views])
    magnified = draw_residuals(over_image, camera, pixels, np.concatenate([view.residuals for view in result.views]))
    for entry in result.left_out:
        over_image.plot(*np.asarray(entry.detection.pixels).T, "x", color=WRONG, markersize=3, alpha=0.5)
    over_image.set_title(f"residuals, {magnified:.0f} times larger; red: views left out", fontsize=10)
    by_view.bar(range(len(rms)), rms, color=SEEN)
    by_view.axhline(result.rms_px, color=CURVE, label=f"all: {result.rms_px:.3f} px")
    names = [str(view.detection.frame_index) for view in result.views]
    by_view.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    by_view.set(xlabel="frame", ylabel="rms of a corner's distance [px]")
    by_view.legend(loc="upper left")
    known = ", ".join(f"{key} {result.values[key]:.2f} ± {result.sd[key]:.2f} px" for key in ("fx", "fy", "cx", "cy"))
    title = f"{camera.name}: {result.verdict.grade}; {len(rms)} views, rms {result.rms_px:.3f} px, {known}"
    figure.suptitle(title, fontsize=11)
    return figure


def draw_residuals(axis: Axes, camera: CameraModel, pixels: Array, residuals: Array) -> float:
    """Draw residuals (n, 2) as arrows from their pixels (n, 2) over the camera's image; return the magnification."""
    every = max(1, -(-len(pixels) // MAX_ARROWS))
    typical = max(float(np.percentile(np.hypot(*residuals.T), PERCENTILE)), 1e-3)
    magnified = ARROW_SHARE * camera.width / typical
    start, way = pixels[::every].T, residuals[::every].T
    axis.quiver(*start, *way, color=SEEN, angles="xy", scale_units="xy", scale=1 / magnified, width=0.0015)
    axis.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), aspect="equal", xlabel="px")
    axis.plot(*camera.K[:2, 2], "+", color=CURVE, markersize=14)
    return magnified
