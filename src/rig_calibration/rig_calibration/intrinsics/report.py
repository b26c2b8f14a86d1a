"""The report beside a calibration: what was found, how sure it is, from which views, and whether it will do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .result import Intrinsics, ViewResult
from .robust_fit import LeftOut


def report_of(result: Intrinsics, about: Mapping[str, Any]) -> dict[str, Any]:
    """Plain data for YAML; ``about`` (board, sources, versions, date) comes first."""
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
        "sd_enlarged_by": _short(result.jackknife),
        "parameters": {
            name: {"value": float(value), "sd": _short(result.sd[name])} for name, value in result.values.items()
        },
        "uncertainty_in_image_corners_px": _short(result.edge_sd_px),
        "corners_reach": _short(result.reach),
        "board_bow_mm": {
            axis: {"value": _short(1e3 * bow), "sd": _short(1e3 * sd)}
            for axis, bow, sd in zip("xy", result.bow_m, result.bow_sd_m, strict=True)
        },
        **(
            {
                "model_choice": {
                    "held_out_px": {name: _short(rms) for name, rms in result.choice.held_out_px.items()},
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
        "moment": view.sighting.moment,
        "corners": len(view.pixels),
        "rms_px": _short(view.rms_px),
        "tilt_deg": _short(float(np.rad2deg(view.look.tilt))),
        "distance_m": _short(float(np.linalg.norm(view.T_camera_board[:3, 3]))),
    }


def _left_out(entry: LeftOut) -> dict[str, Any]:
    what = {"moment": entry.sighting.moment, "why": entry.reason}
    return what if entry.whole else {**what, "corners": list(entry.corners)}


def _short(value: float) -> float:
    """Four digits: what a person reads."""
    return float(f"{value:.4g}")
