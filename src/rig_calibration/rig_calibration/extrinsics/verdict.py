"""Judges whether a calibrated rig is good enough to track a person with, and says what to do if not.

A tape measure is part of the evidence: it alone can tell that the board's fields have another size than stated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, nan

import numpy as np

from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.rig import Rig
from capture_rig.verdict import REDO, USABLE, Finding, Verdict, graded, judge

from ..bundle.initial_poses import cameras_by_pose
from ..bundle.robust_fit import CLEAR_SDS
from ..bundle.solve import RigSolution
from .world import CameraFigures, CommonVolume

FLOOR = "floor"  # the name of the target


@dataclass(frozen=True)
class TapeMeasure:
    """A length that a person measured: between two lenses, or (``other`` None) of a lens above the floor; and the same
    in the calibration, once there is one."""

    one: str
    other: str | None
    tape_m: float
    calibrated_m: float = nan

    def checked(self, rig: Rig) -> TapeMeasure:
        """Look the length up in the calibration. Raises InputError for an unknown camera and a useless length."""
        if not self.tape_m >= MIN_TAPE_M:
            what, remedy = f"{self.tape_m} m is no length to check with", f"Measure {MIN_TAPE_M:.1f} m or more."
            raise InputError(what, where=f"tape at {self.one}", remedy=remedy)
        centre = rig.camera(self.one).centre_world
        length = centre[2] if self.other is None else np.linalg.norm(centre - rig.camera(self.other).centre_world)
        return replace(self, calibrated_m=float(length))

    @property
    def ratio(self) -> float:
        """Calibrated over measured: 1.04 means that every length came out 4 % too long."""
        return self.calibrated_m / self.tape_m

    def __str__(self) -> str:
        what = f"height of {self.one}" if self.other is None else f"{self.one} to {self.other}"
        return f"{what}: {self.tape_m:.3f} m by tape, {self.calibrated_m:.3f} m calibrated ({self.ratio - 1:+.1%})"


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """The rig and everything that is known about it.

    common : what its cameras see in common. floor : by camera that shows the floor target, whether its picture alone
    leaves two poses. floor_world (n, 3) : its points; None without a floor: z up is then a guess. floor_guess : frames
    in which the carried board was taken to lie on the floor because nothing was below it. moved_frames : by camera,
    frames in which the floor board lay elsewhere, and all its frames. tape : what was measured by hand.
    """

    rig: Rig
    common: CommonVolume
    solution: RigSolution
    floor: Mapping[str, bool]
    floor_world: Array | None
    figures: Mapping[str, CameraFigures]
    floor_guess: tuple[int, ...] = ()
    moved_frames: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    tape: tuple[TapeMeasure, ...] = ()

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the corners, each detection counted alike."""
        squares, counts = zip(*((f.rms_px**2, f.detections) for f in self.figures.values()), strict=True)
        return float(np.sqrt(np.average(squares, weights=counts)))

    @cached_property
    def verdict(self) -> Verdict:
        """GOOD, USABLE or REDO, with every finding and its remedy: the rig's, each camera's, and the footage's. Where
        the cameras stand to each other and to the person is judged by sagoma doctor."""
        findings = [*_of_floor(self), *_of_scale(self)]
        findings += [found for camera in self.figures.values() for found in _of_camera(camera, self)]
        # a floor board alone shares one view with every camera: there is nothing in it that could contradict
        carried = any(detection.target != FLOOR for detection in self.solution.detections)
        return judge([*findings, *(footage_findings(self.solution) if carried else ())])


# Limits of USABLE and REDO; where only one grade is given the other is out of reach: judgement.
RESTING_FRAMES = 3  # a board that lies on the floor is seen there in so many frames
RATIO = (0.01, 0.03)  # of two sizes, of a length to the tape's, of a focal length to the one given
TAPE_ERROR_M = 0.02  # a tape held against a lens errs by so much
MIN_TAPE_M = TAPE_ERROR_M / RATIO[1]  # a shorter length tells nothing
SD_MM, SD_DEG = (10.0, 40.0), (0.2, 1.0)
RMS_PX, RMS_WIDTH_PX = (1.0, 3.0), 1000  # wider images may have residuals in proportion
WRONG_SHARE = (0.2, 0.3)  # of a camera's detections; the first of its frames of the floor board, too
SYNC_ERROR_M = 0.001
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


def _of_camera(camera: CameraFigures, rig: RigCalibration) -> Iterator[Finding]:
    """Find all that is wrong with one camera, the worst causes first."""
    name, detections = camera.name, rig.solution.detections
    nearer = "Show it the board larger, nearer, more from above, and at more places of its image (--moving)."
    tied = any(seen.camera == name and seen.target != FLOOR for seen in detections)
    if rig.floor.get(name) and not tied:
        yield Finding(REDO, f"two poses of {name} fit the floor board equally well", nearer)
    widening = max(1.0, rig.rig.camera(name).width / RMS_WIDTH_PX)
    yield from graded(
        camera.rms_px / widening,
        RMS_PX,
        f"{name}: the corners miss their places by {camera.rms_px:.2f} px (rms)",
        "Check that the intrinsics are this camera's, at this focus and image size, that the board is "
        "flat and specified as printed, and that it was held still.",
    )
    what = f"the place of {name} is known to {camera.sd_centre_mm:.0f} mm only (sd)"
    yield from graded(camera.sd_centre_mm, SD_MM, what, nearer)
    what = f"the direction of {name} is known to {camera.sd_rotation_deg:.2f} degrees only (sd)"
    yield from graded(camera.sd_rotation_deg, SD_DEG, what, nearer)
    if rig.floor_world is not None and camera.height_m < 0:
        yield Finding(
            REDO,
            f"{name} comes to lie {-camera.height_m:.2f} m below the floor",
            "Lay the board on the floor, print upwards, and switch off the camera's mirroring; where corners are given "
            "by hand, give them in reading order.",
        )
    for left in rig.solution.left_out:
        if (left.detection.camera, left.detection.target) == (name, FLOOR):
            yield Finding(
                REDO,
                f"{name} sees the floor board otherwise than the rest of the rig does: {left.reason}",
                "Was the board, or the camera, moved in between, or are its outer corners given the wrong way "
                "round? Take the pictures of the floor board again.",
            )
    moved_frames, frames = rig.moved_frames.get(name, (0, 1))
    yield from graded(
        moved_frames / frames,
        (WRONG_SHARE[0], inf),
        f"in {moved_frames} of {frames} frames of {name} the floor board lies elsewhere",
        "Film it lying still, and start when everybody has left it.",
    )


# --- What the solution says about how the footage was taken.


def footage_findings(solution: RigSolution) -> Iterator[Finding]:
    """Find what is wrong with synchrony, lenses and ties, and detections that contradict the rest."""
    if solution.sync_error_m > SYNC_ERROR_M:
        yield Finding(
            USABLE,
            f"the cameras see targets {1000 * solution.sync_error_m:.1f} mm apart: they moved between the exposures, "
            "or are bent",
            "Hold the board still for each picture, carry it slowly, or synchronise the cameras; fix the print to "
            "something flat.",
        )
    used, left_out = (
        [of.camera for of in some] for some in (solution.detections, [out.detection for out in solution.left_out])
    )
    for name, count in common_pose_counts(solution).items():
        ratio, sd = solution.focal_of[name]
        yield from graded(
            abs(ratio - 1),
            (max(RATIO[0], CLEAR_SDS * sd), RATIO[1]),
            f"together with the other cameras' views, those of {name} ask for a focal length {ratio:.3f} times the "
            "one given",
            f"Calibrate the intrinsics of {name} again, at the focus, zoom and image size that it is used with.",
        )
        lost = left_out.count(name)
        yield from graded(
            lost / (lost + used.count(name)),
            WRONG_SHARE,
            f"{lost} of {lost + used.count(name)} detections of {name} contradict the rest",
            "Check that the cameras are synchronised, that the board was carried slowly, that the camera was not "
            "touched, and that the footage is of one recording.",
        )
        if count < FEW_TIES:
            yield Finding(
                USABLE,
                f"{name} is tied to the other cameras by {count} position(s) of a target only: nothing would tell a "
                "mistake in them",
                "Carry the board where it and another camera see it.",
            )


def common_pose_counts(solution: RigSolution) -> dict[str, int]:
    """Count by camera how many poses of targets it saw together with another camera."""
    shared = [cameras for cameras in cameras_by_pose(solution.detections).values() if len(cameras) > 1]
    return {name: sum(name in cameras for cameras in shared) for name in solution.cameras}
