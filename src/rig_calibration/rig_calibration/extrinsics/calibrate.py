"""From detections of boards to the rig in the world, its figures and its verdict: the recipe of the extrinsics (thesis
6.1).

A tape measure is part of the evidence: it alone reveals that the board's fields have another size than stated.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.rig import Rig
from capture_rig.rigid import inverse
from capture_rig.verdict import REDO, USABLE, Finding, Verdict, graded, judge

from ..boards.board import Board, TargetDetection
from ..bundle.initial_poses import cameras_by_pose
from ..bundle.robust_fit import CLEAR_SDS
from ..bundle.solve import RigSolution, solve_rig
from .world import (
    CameraFigures,
    CommonVolume,
    WorldChoice,
    board_in_world,
    camera_figures,
    common_volume,
    world_of_level_camera,
)

FLOOR, MOVING = "floor", "moving"
"""Names of targets, beside WAND."""
FLOOR_POSE = (FLOOR, 0)


@dataclass(frozen=True, eq=False)
class Target:
    """Something of known shape: points (n, 3) in its own frame, metres.

    looks_alike : after half a turn, so that a picture does not show which way round it lies.
    T_world_target (4, 4) : its pose in the world; None of a carried target.
    """

    points: Array
    looks_alike: bool = False
    T_world_target: Array | None = None

    @classmethod
    def of(cls, board: Board, choice: WorldChoice | None = None) -> Target:
        """Return a board as a target; with a ``choice``, one on the floor from which the world is measured so."""
        T_world_board = None if choice is None else board_in_world(board.corners_board, choice)
        return cls(board.corners_board, not board.half_turn_is_visible, T_world_board)


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
    """The rig and its figures.

    common : the common volume. floor_world (n, 3) : the points of the floor target; None without one: z up is then a
    guess. tape : measurements by hand.
    """

    rig: Rig
    common: CommonVolume
    solution: RigSolution
    floor_world: Array | None
    figures: Mapping[str, CameraFigures]
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
        findings += [found for name in self.figures for found in _of_camera(name, self)]
        # a floor board alone shares one view with every camera: there is nothing in it that could contradict
        carried = any(detection.target != FLOOR for detection in self.solution.detections)
        return judge([*findings, *(footage_findings(self.solution) if carried else ())])


def calibrate_rig(
    cameras: Mapping[str, CameraModel],
    detections: Sequence[TargetDetection],
    targets: Mapping[str, Target],
    *,
    intrinsics_sd: Mapping[str, Sequence[float]] | None = None,
    tape: Iterable[TapeMeasure] = (),
) -> RigCalibration:
    """Place all ``cameras`` (only their intrinsics are used) by their detections of ``targets``.

    The target called FLOOR, seen in frame 0, defines the world; without it the first camera is taken for level.
    Every detection names its target. ``intrinsics_sd`` : as :func:`solve_rig` takes them. Raises InputError naming
    cameras that see nothing, or groups that share no view.
    """
    floor = targets.get(FLOOR)
    # all cameras and targets at once, in the floor target's frame
    solution = solve_rig(
        cameras,
        detections,
        {name: target.points for name, target in targets.items()},
        reference=FLOOR_POSE if floor is not None else None,
        alike={name for name, target in targets.items() if target.looks_alike},
        intrinsics_sd=intrinsics_sd,
    )
    # z up, the origin on the floor (thesis 6.1)
    if floor is None or floor.T_world_target is None:
        T_world_reference, on_floor = world_of_level_camera(solution.cameras[min(cameras)].T_camera_world), None
    else:
        T_world_reference = floor.T_world_target @ inverse(solution.T_reference_target[FLOOR_POSE])
        on_floor = floor.points @ floor.T_world_target[:3, :3].T + floor.T_world_target[:3, 3]
    T_reference_world = inverse(T_world_reference)
    cameras_world = tuple(
        replace(camera, T_camera_world=camera.T_camera_world @ T_reference_world)
        for _, camera in sorted(solution.cameras.items())
    )
    common = common_volume(cameras_world)
    rig, measured = Rig(cameras_world, common.box), tuple(tape)
    figures = camera_figures(rig, solution)
    return RigCalibration(rig, common, solution, on_floor, figures, tuple(measure.checked(rig) for measure in measured))


# --- Is the rig good enough to track a person with, and what to do if not?

# Limits of USABLE and REDO: judgement.
RATIO = (0.01, 0.03)  # of two sizes, of a length to the tape's, of a focal length to the one given
TAPE_ERROR_M = 0.02  # error of a tape held against a lens
MIN_TAPE_M = TAPE_ERROR_M / RATIO[1]  # a shorter length is too inaccurate
SD_MM, SD_DEG = (10.0, 40.0), (0.2, 1.0)
RMS_PX, RMS_WIDTH_PX = (1.0, 3.0), 1000  # wider images may have residuals in proportion
WRONG_SHARE = (0.2, 0.3)  # of a camera's detections
SYNC_ERROR_M = 0.001
FEW_TIES = 3


def _of_floor(rig: RigCalibration) -> Iterator[Finding]:
    if rig.floor_world is None:
        yield Finding(
            USABLE,
            "no picture shows the board on the floor: heights and the vertical are guesses",
            "Add pictures of the board lying on the floor (--floor), or carry it there (--floor-at).",
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
        what = f"board '{target}' is {ratio:.3f} times as large as stated, if the other board's size is right"
        remedy = "Measure the fields of both prints over a whole row, and state those (--board, --floor-board)."
        yield from graded(abs(ratio - 1.0), (max(RATIO[0], CLEAR_SDS * sd), RATIO[1]), what, remedy)
    for check in rig.tape:
        remedy = f"If the tape is right, the board's fields are {1.0 / check.ratio:.4f} times as large as stated: "
        remedy += "measure the print, state that size and calibrate again."
        limits = max(RATIO[0], TAPE_ERROR_M / check.tape_m), RATIO[1]
        yield from graded(abs(check.ratio - 1.0), limits, str(check), remedy)


def _of_camera(name: str, rig: RigCalibration) -> Iterator[Finding]:
    """Find all that is wrong with one camera, the worst causes first."""
    camera = rig.figures[name]
    nearer = "Show it the board larger, nearer, more from above, and at more places of its image (--moving)."
    what = f"{name}: the corners miss their places by {camera.rms_px:.2f} px (rms)"
    remedy = "Check that the intrinsics are this camera's, at this focus and image size, that the board is flat and "
    remedy += "specified as printed, and that it was held still."
    widening = max(1.0, rig.rig.camera(name).width / RMS_WIDTH_PX)
    yield from graded(camera.rms_px / widening, RMS_PX, what, remedy)
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


def footage_findings(solution: RigSolution) -> Iterator[Finding]:
    """Yield faults of synchrony, lenses and ties, and detections that contradict the rest."""
    if solution.sync_error_m > SYNC_ERROR_M:
        yield Finding(
            USABLE,
            f"the cameras see targets {1000 * solution.sync_error_m:.1f} mm apart: they moved between the exposures, "
            "or are bent",
            "Hold the board still for each picture, carry it slowly, or synchronise the cameras; fix the print to "
            "something flat.",
        )
    used = [detection.camera for detection in solution.detections]
    left_out = [out.detection.camera for out in solution.left_out]
    shared = [names for names in cameras_by_pose(solution.detections).values() if len(names) > 1]
    for name, (ratio, sd) in solution.focal_of.items():
        what = f"the other cameras' views ask for a focal length of {name} that is {ratio:.3f} times the one given"
        remedy = f"Calibrate the intrinsics of {name} again, at the focus, zoom and image size that it is used with."
        yield from graded(abs(ratio - 1), (max(RATIO[0], CLEAR_SDS * sd), RATIO[1]), what, remedy)
        lost, every = left_out.count(name), left_out.count(name) + used.count(name)
        what = f"{lost} of {every} detections of {name} contradict the rest"
        remedy = "Check that the cameras are synchronised, that the board was carried slowly, that the camera was not "
        remedy += "touched, and that the footage is of one recording."
        yield from graded(lost / every, WRONG_SHARE, what, remedy)
        count = sum(name in names for names in shared)
        if count < FEW_TIES:
            what = f"{name} is tied to the other cameras by {count} position(s) of a target only: nothing would tell a "
            yield Finding(USABLE, what + "mistake in them", "Carry the board where it and another camera see it.")
