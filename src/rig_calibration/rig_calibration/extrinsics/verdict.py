"""Judges whether a calibrated rig is good enough to track a person with, and says what to do if not.

A tape measure is part of the evidence: it alone can tell that the board's fields have another size than stated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import inf

import numpy as np

from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.rig import Rig
from capture_rig.verdict import REDO, USABLE, Finding, Verdict, graded, judge

from ..bundle.initial_poses import cameras_by_pose
from ..bundle.robust_fit import CLEAR_SDS
from ..bundle.solve import RigSolution
from .world import CameraFigures, FloorView, PlacedRig, RigFigures

FLOOR = "floor"  # the name of the target


@dataclass(frozen=True)
class TapeCheck:
    """What was measured (text), by tape and in the calibration, metres."""

    what: str
    tape_m: float
    calibrated_m: float

    @property
    def ratio(self) -> float:
        """Calibrated over measured: 1.04 means that every length came out 4 % too long."""
        return self.calibrated_m / self.tape_m

    def __str__(self) -> str:
        return f"{self.what}: {self.tape_m:.3f} m by tape, {self.calibrated_m:.3f} m calibrated ({self.ratio - 1:+.1%})"


@dataclass(frozen=True)
class TapeMeasure:
    """A length that a person measured: between two lenses, or (``other`` None) of a lens above the floor."""

    one: str
    other: str | None
    tape_m: float

    def check(self, rig: Rig) -> TapeCheck:
        """Return the same length in the calibration. Raises InputError for an unknown camera and a useless length."""
        what = f"height of {self.one}" if self.other is None else f"{self.one} to {self.other}"
        if not np.isfinite(self.tape_m) or self.tape_m < MIN_TAPE_M:
            raise InputError(
                f"{self.tape_m} m is no length to check with",
                where=what,
                remedy=f"Measure {MIN_TAPE_M:.1f} m or more, to the middle of the lens.",
            )
        centre = rig.camera(self.one).centre_world
        length = centre[2] if self.other is None else np.linalg.norm(centre - rig.camera(self.other).centre_world)
        return TapeCheck(what, self.tape_m, float(length))


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """The rig (``placed.rig``) and everything that is known about it.

    floor : how each camera that shows the floor target sees it. floor_world (n, 3) : its points; None without a floor:
    z up is then a guess. floor_guess : frames in which the carried board was taken to lie on the floor because nothing
    was below it. moved_frames : by camera, frames in which the floor board lay elsewhere, and all its frames. tape :
    what was measured by hand.
    """

    placed: PlacedRig
    solution: RigSolution
    floor: Mapping[str, FloorView]
    floor_world: Array | None
    figures: RigFigures
    floor_guess: tuple[int, ...] = ()
    moved_frames: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    tape: tuple[TapeCheck, ...] = ()

    @cached_property
    def verdict(self) -> Verdict:
        """GOOD, USABLE or REDO, with every finding and its remedy: the rig's, each camera's, and the footage's."""
        findings = [*_of_floor(self), *_of_scale(self), *_of_layout(self)]
        findings += [found for camera in self.figures.cameras for found in camera_findings(camera, self)]
        # a floor board alone shares one view with every camera: there is nothing in it that could contradict
        carried = any(detection.target != FLOOR for detection in self.solution.detections)
        return judge([*findings, *(footage_findings(self.solution) if carried else ())])


# Limits of USABLE and REDO; where only one grade is given the other is out of reach. GRAZING_DEG measured by python
# bench/calibration.py --boards (found at 75 degrees, hardly at 80); else judgement.
FACING_DEG, CLOSE_DEG = 170.0, 12.0  # cameras that look at each other see the same outline, mirrored
MIN_CAMERAS = 3
RESTING_FRAMES = 3  # a board that lies on the floor is seen there in so many frames
RATIO = (0.01, 0.03)  # of two sizes, of a length to the tape's, of a focal length to the one given
TAPE_ERROR_M = 0.02  # a tape held against a lens errs by so much
MIN_TAPE_M = TAPE_ERROR_M / RATIO[1]  # a shorter length tells nothing
GRAZING_DEG = 75.0  # from the board's normal; beyond, its fields are too thin to find them well
SD_MM, SD_DEG = (10.0, 40.0), (0.2, 1.0)
RMS_PX, RMS_WIDTH_PX = (1.0, 3.0), 1000  # wider images may have residuals in proportion
LOWEST_M, HIGHEST_M = 0, 6
WRONG_SHARE = (0.2, 0.3)  # of a camera's detections or its frames of the floor board: USABLE; of all detections: REDO
SYNC_ERROR_M = 0.001
CONTRADICTION = 4.0  # variance ratio: standard deviations are twice what the corners' noise explains
FEW_TIES = 3


def _of_floor(rig: RigCalibration) -> Iterator[Finding]:
    if rig.floor_world is None:
        yield Finding(
            USABLE,
            "no picture shows the board on the floor: heights and the vertical are guesses",
            "Add pictures of the board lying on the floor (--floor), or carry it there (--floor-at).",
        )
    if 0 < len(rig.floor_guess) < RESTING_FRAMES:
        frames = ", ".join(map(str, rig.floor_guess))
        yield Finding(
            USABLE,
            f"the floor was taken from frame {frames}, where the carried board was lowest, but it did not rest there",
            "Look at the floor's grid in the pictures; lay the board down for some seconds, or say when it lies on the "
            "floor (--floor-at).",
        )
    if rig.solution.undecided:
        yield Finding(
            REDO,
            f"nothing tells on which side of the board {', '.join(rig.solution.undecided)} stand(s): it looks the same "
            "after part of a turn",
            "Use a board with an odd and an even number of inner corners, or a ChArUco board; or carry a board through "
            "the room (--moving); or give its outer corners in each picture, the same one first (--corners).",
        )


def _of_scale(rig: RigCalibration) -> Iterator[Finding]:
    for target, (ratio, sd) in sorted(rig.solution.scale_of.items()):
        yield from graded(
            abs(ratio - 1.0),
            (max(RATIO[0], CLEAR_SDS * sd), RATIO[1]),
            f"board '{target}' is {ratio:.3f} times as large as stated, if the other board's size is right",
            "Measure the fields of both prints over the whole length of a row, and state those (--board, "
            "--floor-board).",
        )
    for check in rig.tape:
        size = "smaller" if check.ratio > 1.0 else "larger"
        yield from graded(
            abs(check.ratio - 1.0),
            (max(RATIO[0], TAPE_ERROR_M / check.tape_m), RATIO[1]),
            str(check),
            f"If the tape is right, the board's fields are {size} than stated, {1.0 / check.ratio:.4f} times as "
            "large: measure the print, state that size and calibrate again.",
        )


def _of_layout(rig: RigCalibration) -> Iterator[Finding]:
    figures, count = rig.figures, len(rig.figures.cameras)
    if count == 1:
        remedy = "Give the pictures of all cameras (--cameras names them)."
        yield Finding(REDO, "one camera alone makes no hull", remedy)
    elif count < MIN_CAMERAS:
        what = f"{count} cameras: the hull will be much fatter than the body"
        yield Finding(USABLE, what, "Use three or more, around the person.")
    if not rig.placed.common.usable:
        what = "nowhere do enough cameras see a standing person from feet to head"
        yield Finding(USABLE, what, "Move the cameras back, or turn them towards one place.")
    for (one, other), angle in figures.facing_deg.items():
        if angle > FACING_DEG:
            what = f"{one} and {other} look at each other ({angle:.0f} degrees): they see the same outline"
            yield Finding(USABLE, what, "Move one of them sideways, by 20 degrees or more around the volume.")
        if angle < CLOSE_DEG:
            yield Finding(
                USABLE,
                f"{one} and {other} see almost the same ({angle:.0f} degrees apart)",
                "Move one of them around the volume; if they stand far apart in the room, check that each "
                "has its own footage.",
            )
    for (one, other), gap in figures.gaps_deg.items() if count >= MIN_CAMERAS else ():
        if gap > FACING_DEG:
            what = f"no camera stands between {one} and {other}, {gap:.0f} degrees apart"
            yield Finding(USABLE, what, "Spread the cameras around the volume.")


def camera_findings(camera: CameraFigures, rig: RigCalibration) -> Iterator[Finding]:
    """Find all that is wrong with one camera, the worst causes first."""
    yield from _of_view(camera, rig)
    widening = max(1.0, rig.placed.rig.camera(camera.name).width / RMS_WIDTH_PX)
    yield from graded(
        camera.rms_px / widening,
        RMS_PX,
        f"{camera.name}: the corners miss their places by {camera.rms_px:.2f} px (rms)",
        "Check that the intrinsics are this camera's, at this focus and image size, that the board is "
        "flat and specified as printed, and that it was held still.",
    )
    nearer = "Show it the board larger, nearer, more from above, and at more places of its image (--moving)."
    what = f"the place of {camera.name} is known to {camera.sd_centre_mm:.0f} mm only (sd)"
    yield from graded(camera.sd_centre_mm, SD_MM, what, nearer)
    what = f"the direction of {camera.name} is known to {camera.sd_rotation_deg:.2f} degrees only (sd)"
    yield from graded(camera.sd_rotation_deg, SD_DEG, what, nearer)
    if rig.floor_world is not None and camera.height_m < LOWEST_M:
        yield Finding(
            REDO,
            f"{camera.name} comes to lie {-camera.height_m:.2f} m below the floor",
            "Lay the board on the floor, print upwards; where corners are given by hand, give them in reading order.",
        )
    if rig.floor_world is not None and camera.height_m > HIGHEST_M:
        what = f"{camera.name} comes to lie {camera.height_m:.1f} m above the floor"
        yield Finding(USABLE, what, "If it hangs lower, the board's size is wrong: measure a field of the print.")
    yield from _of_detections(camera, rig)


def _of_view(camera: CameraFigures, rig: RigCalibration) -> Iterator[Finding]:
    view, detections = rig.floor.get(camera.name), rig.solution.detections
    tied = any(seen.camera == camera.name and seen.target != FLOOR for seen in detections)
    if view is None or camera.floor_angle_deg is None or tied:
        return
    if view.other is not None:
        yield Finding(
            REDO,
            f"two poses of {camera.name} fit the floor board equally well",
            "Use a larger board, lay it nearer to the camera, or carry a board through the room (--moving).",
        )
    yield from graded(
        camera.floor_angle_deg,
        (GRAZING_DEG, inf),
        f"{camera.name} sees the board at {camera.floor_angle_deg:.0f} degrees from its normal",
        "Raise the camera, move the board nearer to it, or carry a board through the room (--moving).",
    )


def _of_detections(camera: CameraFigures, rig: RigCalibration) -> Iterator[Finding]:
    left_out = [left for left in rig.solution.left_out if left.detection.camera == camera.name]
    for left in left_out:
        if left.detection.target != FLOOR:
            continue
        yield Finding(
            REDO,
            f"{camera.name} sees the floor board otherwise than the rest of the rig does: {left.reason}",
            "Was the board, or the camera, moved in between, or are its outer corners given the wrong way "
            "round? Take the pictures of the floor board again.",
        )
    total = len(left_out) + camera.detections
    if len(left_out) > WRONG_SHARE[0] * total:
        yield Finding(
            USABLE,
            f"{len(left_out)} of {total} detections of {camera.name} contradict the rest: {left_out[0].reason}",
            "Check that the cameras are synchronised, that the board was carried slowly, and that the camera "
            "was not touched.",
        )
    moved_frames, frames = rig.moved_frames.get(camera.name, (0, 0))
    if moved_frames > WRONG_SHARE[0] * frames:
        yield Finding(
            USABLE,
            f"in {moved_frames} of {frames} frames of {camera.name} the floor board lies elsewhere",
            "Film it lying still, and start when everybody has left it.",
        )


# --- What the solution says about how the footage was taken.


def footage_findings(solution: RigSolution) -> Iterator[Finding]:
    """Find what is wrong with synchrony, lenses and ties; sizes and left-out views are of the rig."""
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
    for name, (ratio, sd) in solution.focal_of.items():
        yield from graded(
            abs(ratio - 1),
            (max(RATIO[0], CLEAR_SDS * sd), RATIO[1]),
            f"together with the other cameras' views, those of {name} ask for a focal length {ratio:.3f} times the "
            "one given",
            f"Calibrate the intrinsics of {name} again, at the focus, zoom and image size that it is used with.",
        )
    for name, count in common_pose_counts(solution).items():
        if count < FEW_TIES:
            yield Finding(
                USABLE,
                f"{name} is tied to the other cameras by {count} position(s) of a target only: nothing would tell a "
                "mistake in them",
                "Carry the board where it and another camera see it.",
            )
    lost, used = len(solution.left_out), len(solution.detections)
    if lost > WRONG_SHARE[1] * (lost + used):
        yield Finding(
            REDO,
            f"{lost} of {lost + used} detections contradict the rest",
            "Was a camera moved, or is the footage of different recordings? Record again, all cameras together.",
        )


def common_pose_counts(solution: RigSolution) -> dict[str, int]:
    """Count by camera how many poses of targets it saw together with another camera."""
    shared = [cameras for cameras in cameras_by_pose(solution.detections).values() if len(cameras) > 1]
    return {name: sum(name in cameras for cameras in shared) for name in solution.cameras}
