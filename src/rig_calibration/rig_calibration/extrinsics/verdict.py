"""Judges whether a calibrated rig is good enough to track a person with, and says what to do if not.

A tape measure is part of the evidence: it alone can tell that the board's fields have another size than stated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import Rig
from capture_rig.verdict import REDO, USABLE, Finding, Verdict, judge

from .figures import CameraFigures, RigFigures
from .floor import FloorView

MIN_M = 0.2  # a shorter length tells nothing: a tape at a lens errs by a centimetre


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
        if not np.isfinite(self.tape_m) or self.tape_m < MIN_M:
            raise InputError(
                f"{self.tape_m} m is no length to check with",
                where=what,
                remedy=f"Measure {MIN_M} m or more, to the middle of the lens.",
            )
        centre = rig.camera(self.one).centre_world
        length = centre[2] if self.other is None else np.linalg.norm(centre - rig.camera(self.other).centre_world)
        return TapeCheck(what, self.tape_m, float(length))


@dataclass(frozen=True, eq=False)
class RigEvidence:
    """Everything that is known about a rig that was just calibrated.

    figures : its figures. widths_px : width of each camera's images. usable_volume : is there a place where enough
    cameras see a standing person? floor : how each camera that sees the floor board sees it. by_floor_alone : cameras
    that no carried board ties to the others. floor_known : False when z up is a guess. floor_guess : frames in
    which the carried board was taken to lie on the floor because nothing was below it. undecided : cameras that may
    stand on either side of the board. moved_frames : by camera, frames in which the floor board lay elsewhere, and all
    its frames. left_out : by camera, why detections were left out. scales : by target, its size relative to the first
    target's as the cameras see it, and that ratio's standard deviation. tape : what was measured by hand.
    floor_left_out : by camera, why its detection of the floor board was left out.
    """

    figures: RigFigures
    widths_px: Mapping[str, int]
    usable_volume: bool = True
    floor: Mapping[str, FloorView] = field(default_factory=dict)
    by_floor_alone: frozenset[str] = frozenset()
    floor_known: bool = True
    floor_guess: tuple[int, ...] = ()
    undecided: tuple[str, ...] = ()
    moved_frames: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    left_out: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    floor_left_out: Mapping[str, str] = field(default_factory=dict)
    scales: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    tape: tuple[TapeCheck, ...] = ()


# Thresholds: GRAZING_DEG measured by python bench/calibration.py --boards (found at 75 degrees, hardly at 80); else
# judgement.
FACING_DEG = 170.0  # cameras that look at each other see the same outline, mirrored
CLOSE_DEG, WIDE_DEG = 12.0, 170.0
MIN_CAMERAS = 3
RESTING_FRAMES = 3  # a board that lies on the floor is seen there in so many frames
SCALE_USABLE, SCALE_REDO, SCALE_SDS = 0.01, 0.03, 4.0
TAPE_ERROR_M = 0.02  # a tape held against a lens errs by so much


def rig_verdict(evidence: RigEvidence) -> Verdict:
    """Judge the rig GOOD, USABLE or REDO, with every finding and its remedy: the rig's first, then each camera's."""
    cameras = (camera_findings(camera, evidence) for camera in evidence.figures.cameras)
    rig = (_of_floor(evidence), _of_guess(evidence), _of_sides(evidence), _of_scale(evidence), _of_layout(evidence))
    return judge(chain.from_iterable([*rig, *cameras]))


def _of_floor(evidence: RigEvidence) -> Iterator[Finding]:
    if not evidence.floor_known:
        yield Finding(
            USABLE,
            "no picture shows the board on the floor: heights and the vertical are guesses",
            "Add pictures of the board lying on the floor (--floor), or carry it there (--floor-at).",
        )


def _of_guess(evidence: RigEvidence) -> Iterator[Finding]:
    if 0 < len(evidence.floor_guess) < RESTING_FRAMES:
        frames = ", ".join(map(str, evidence.floor_guess))
        yield Finding(
            USABLE,
            f"the floor was taken from frame {frames}, where the carried board was lowest, but it did not rest there",
            "Look at the floor's grid in the pictures; lay the board down for some seconds, or say when it lies on the "
            "floor (--floor-at).",
        )


def _of_sides(evidence: RigEvidence) -> Iterator[Finding]:
    if evidence.undecided:
        yield Finding(
            REDO,
            f"nothing tells on which side of the board {', '.join(evidence.undecided)} stand(s)",
            "Use a board with an odd and an even number of inner corners, or a ChArUco board.",
        )


def _of_scale(evidence: RigEvidence) -> Iterator[Finding]:
    for target, (ratio, sd) in sorted(evidence.scales.items()):
        if abs(ratio - 1.0) > max(SCALE_USABLE, SCALE_SDS * sd):
            yield Finding(
                REDO if abs(ratio - 1.0) > SCALE_REDO else USABLE,
                f"board '{target}' is {ratio:.3f} times as large as stated, if the other board's size is right",
                "Measure the fields of both prints over the whole length of a row, and state those (--board, "
                "--floor-board).",
            )
    for check in evidence.tape:
        yield from _of_tape(check)


def _of_tape(check: TapeCheck) -> Iterator[Finding]:
    error = abs(check.ratio - 1.0)
    if error > max(SCALE_USABLE, TAPE_ERROR_M / check.tape_m):
        size = "smaller" if check.ratio > 1.0 else "larger"
        yield Finding(
            REDO if error > SCALE_REDO else USABLE,
            str(check),
            f"If the tape is right, the board's fields are {size} than stated, {1.0 / check.ratio:.4f} times as "
            "large: measure the print, state that size and calibrate again.",
        )


def _of_layout(evidence: RigEvidence) -> Iterator[Finding]:
    figures = evidence.figures
    if len(figures.cameras) == 1:
        yield Finding(
            REDO, "one camera alone makes no hull", "Give the pictures of all cameras (--cameras names them)."
        )
    elif len(figures.cameras) < MIN_CAMERAS:
        yield Finding(
            USABLE,
            f"{len(figures.cameras)} cameras: the hull will be much fatter than the body",
            "Use three or more, around the person.",
        )
    if not evidence.usable_volume:
        yield Finding(
            USABLE,
            "nowhere do enough cameras see a standing person from feet to head",
            "Move the cameras back, or turn them towards one place.",
        )
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
    if len(figures.cameras) >= MIN_CAMERAS:
        for (one, other), gap in figures.gaps_deg.items():
            if gap > WIDE_DEG:
                yield Finding(
                    USABLE,
                    f"no camera stands between {one} and {other}, {gap:.0f} degrees apart",
                    "Spread the cameras around the volume.",
                )


# --- Findings about one camera.

GRAZING_DEG = 75.0  # from the board's normal; beyond, its fields are too thin to find them well
SD_USABLE_MM, SD_REDO_MM = 10.0, 40.0
SD_USABLE_DEG, SD_REDO_DEG = 0.2, 1.0
RMS_USABLE_PX, RMS_REDO_PX = 1.0, 3.0
RMS_WIDTH_PX = 1000  # wider images may have residuals in proportion
LOWEST_M, HIGHEST_M = 0.0, 6.0
LEFT_OUT_SHARE = 0.2
MOVED_SHARE = 0.2


def camera_findings(camera: CameraFigures, evidence: RigEvidence) -> Iterator[Finding]:
    """Find all that is wrong with one camera, the worst causes first."""
    yield from _of_view(camera, evidence)
    yield from _of_precision(camera, evidence)
    yield from _of_height(camera, evidence)
    yield from _of_detections(camera, evidence)


def _of_view(camera: CameraFigures, evidence: RigEvidence) -> Iterator[Finding]:
    view = evidence.floor.get(camera.name)
    if view is None or camera.floor_angle_deg is None:
        return
    alone = camera.name in evidence.by_floor_alone
    if view.other is not None and alone:
        yield Finding(
            REDO,
            f"two poses of {camera.name} fit the floor board equally well",
            "Use a larger board, lay it nearer to the camera, or carry a board through the room (--moving).",
        )
    if camera.floor_angle_deg > GRAZING_DEG and alone:
        yield Finding(
            USABLE,
            f"{camera.name} sees the board at {camera.floor_angle_deg:.0f} degrees from its normal",
            "Raise the camera, move the board nearer to it, or carry a board through the room (--moving).",
        )


def _of_precision(camera: CameraFigures, evidence: RigEvidence) -> Iterator[Finding]:
    widening = max(1.0, evidence.widths_px[camera.name] / RMS_WIDTH_PX)
    if camera.rms_px > RMS_USABLE_PX * widening:
        grade = REDO if camera.rms_px > RMS_REDO_PX * widening else USABLE
        yield Finding(
            grade,
            f"{camera.name}: the corners miss their places by {camera.rms_px:.2f} px (rms)",
            "Check that the intrinsics are this camera's, at this focus and image size, that the board is "
            "flat and specified as printed, and that it was held still.",
        )
    if camera.sd_centre_mm > SD_USABLE_MM:
        grade = REDO if camera.sd_centre_mm > SD_REDO_MM else USABLE
        yield Finding(grade, f"the place of {camera.name} is known to {camera.sd_centre_mm:.0f} mm only (sd)", _NEARER)
    if camera.sd_rotation_deg > SD_USABLE_DEG:
        grade = REDO if camera.sd_rotation_deg > SD_REDO_DEG else USABLE
        what = f"the direction of {camera.name} is known to {camera.sd_rotation_deg:.2f} degrees only (sd)"
        yield Finding(grade, what, _NEARER)


_NEARER = "Show it the board larger, nearer, more from above, and at more places of its image (--moving)."


def _of_height(camera: CameraFigures, evidence: RigEvidence) -> Iterator[Finding]:
    if not evidence.floor_known:
        return
    if camera.height_m < LOWEST_M:
        yield Finding(
            REDO,
            f"{camera.name} comes to lie {-camera.height_m:.2f} m below the floor",
            "Lay the board on the floor, print upwards; where corners are given by hand, give them in reading order.",
        )
    elif camera.height_m > HIGHEST_M:
        yield Finding(
            USABLE,
            f"{camera.name} comes to lie {camera.height_m:.1f} m above the floor",
            "If it hangs lower, the board's size is wrong: measure a field of the print.",
        )


def _of_detections(camera: CameraFigures, evidence: RigEvidence) -> Iterator[Finding]:
    if (reason := evidence.floor_left_out.get(camera.name)) is not None:
        yield Finding(
            REDO,
            f"{camera.name} sees the floor board otherwise than the rest of the rig does: {reason}",
            "Was the board, or the camera, moved in between, or are its outer corners given the wrong way "
            "round? Take the pictures of the floor board again.",
        )
    reasons = evidence.left_out.get(camera.name, ())
    total = len(reasons) + camera.detections
    if len(reasons) > LEFT_OUT_SHARE * total:
        yield Finding(
            USABLE,
            f"{len(reasons)} of {total} detections of {camera.name} contradict the rest: {reasons[0]}",
            "Check that the cameras are synchronised, that the board was carried slowly, and that the camera "
            "was not touched.",
        )
    moved_frames, frames = evidence.moved_frames.get(camera.name, (0, 0))
    if moved_frames > MOVED_SHARE * frames:
        yield Finding(
            USABLE,
            f"in {moved_frames} of {frames} frames of {camera.name} the floor board lies elsewhere",
            "Film it lying still, and start when everybody has left it.",
        )
