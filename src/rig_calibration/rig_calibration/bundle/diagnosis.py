"""What a solution says about how the footage was taken, with remedies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from capture_rig.verdict import REDO, USABLE, Finding

from .solution import RigSolution

# Thresholds: judgement, no measurement.
SYNC_ERROR_M = 0.001
CONTRADICTION = 4.0  # variance ratio: standard deviations are twice what the corners' noise explains
FOCAL_USABLE, FOCAL_REDO, FOCAL_SDS = 0.01, 0.03, 4.0
FEW_TIES = 3
LEFT_OUT_SHARE = 0.3


def diagnose(solution: RigSolution) -> tuple[Finding, ...]:
    """Find what is wrong with synchrony, intrinsics and ties; sizes and left-out views stand in the solution."""
    return (*_of_synchrony(solution), *_of_lenses(solution), *_of_ties(solution), *_of_footage(solution))


def common_pose_counts(solution: RigSolution) -> dict[str, int]:
    """Count by camera how many poses of targets it saw together with another camera."""
    seen: dict[tuple[str, int], set[str]] = {}
    for detection in solution.detections:
        seen.setdefault((detection.target, detection.frame_index), set()).add(detection.camera)
    shared = [cameras for cameras in seen.values() if len(cameras) > 1]
    return {name: sum(name in cameras for cameras in shared) for name in solution.cameras}


def _of_synchrony(solution: RigSolution) -> Iterator[Finding]:
    if solution.sync_error_m > SYNC_ERROR_M:
        yield Finding(
            USABLE,
            f"the cameras see targets {1000 * solution.sync_error_m:.1f} mm apart: they moved between the exposures, "
            "or are bent",
            "Hold the board still for each picture, carry it slowly, or synchronise the cameras; fix the print to "
            "something flat.",
        )
    elif solution.inflation > CONTRADICTION:
        yield Finding(
            USABLE,
            f"the cameras contradict one another {np.sqrt(solution.inflation):.1f} times as much as the noise of the "
            "corners explains",
            "Calibrate the intrinsics more thoroughly, to the edges of the images; use a flat board.",
        )


def _of_lenses(solution: RigSolution) -> Iterator[Finding]:
    for name, (ratio, sd) in solution.focal_of.items():
        if abs(ratio - 1) > max(FOCAL_USABLE, FOCAL_SDS * sd):
            yield Finding(
                REDO if abs(ratio - 1) > FOCAL_REDO else USABLE,
                f"together with the other cameras' views, those of {name} ask for a focal length {ratio:.3f} times the "
                "one given",
                f"Calibrate the intrinsics of {name} again, at the focus, zoom and image size that it is used with.",
            )


def _of_ties(solution: RigSolution) -> Iterator[Finding]:
    for name, count in common_pose_counts(solution).items():
        if count < FEW_TIES:
            yield Finding(
                USABLE,
                f"{name} is tied to the other cameras by {count} position(s) of a target only: nothing would tell a "
                "mistake in them",
                "Carry the board where it and another camera see it.",
            )


def _of_footage(solution: RigSolution) -> Iterator[Finding]:
    lost, used = len(solution.left_out), len(solution.detections)
    if lost > LEFT_OUT_SHARE * (lost + used):
        yield Finding(
            REDO,
            f"{lost} of {lost + used} detections contradict the rest",
            "Was a camera moved, or is the footage of different recordings? Record again, all cameras together.",
        )
