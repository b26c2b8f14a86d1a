"""From detections of boards to the rig in the world, its figures and its verdict: the recipe of the extrinsics (thesis
6.1).

The floor board is mostly seen at a grazing angle. A plane has two poses that fit its picture nearly as well
(Schweighofer & Pinz 2006): both are kept unless the corners rule one out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.rigid import inverse, transform

from ..boards.board import Board, TargetDetection
from ..boards.wand import WAND
from ..bundle.problem import MIN_CORNERS, detection_poses, symmetry_order_of, target_shape
from ..bundle.robust_fit import CLEAR_SDS
from ..bundle.solve import RigSolution, solve_rig
from .verdict import FLOOR, RigCalibration, TapeMeasure
from .world import FloorView, WorldChoice, board_in_world, place_rig, rig_figures, world_of_level_camera

MOVING = "moving"
"""Name of a target, beside FLOOR and WAND."""
FLOOR_POSE = (FLOOR, 0)
__all__ = ["FLOOR", "MOVING", "WAND", "FloorTarget", "RigCalibration", "Target", "calibrate_rig"]


@dataclass(frozen=True, eq=False)
class Target:
    """Something of known shape: points (n, 3) in its own frame, metres; ``turns``: how many ways round it may lie
    without a picture showing it (1: its points are told apart)."""

    points: Array
    symmetry_order: int = 1

    @classmethod
    def of(cls, board: Board) -> Target:
        """Return a board as a target."""
        return cls(board.corners_board, symmetry_order_of(board))


@dataclass(frozen=True, eq=False)
class FloorTarget(Target):
    """What lies on the floor, and where it lies in the world: ``T_world_floor`` (4, 4)."""

    T_world_floor: Array = field(default_factory=lambda: np.eye(4))

    @classmethod
    def of_board(cls, board: Board, choice: WorldChoice) -> FloorTarget:
        """Return a board, from which the world is measured as ``choice`` says."""
        return cls(board.corners_board, symmetry_order_of(board), board_in_world(board.corners_board, choice))


def calibrate_rig(
    cameras: Mapping[str, CameraModel],
    detections: Sequence[TargetDetection],
    targets: Mapping[str, Target],
    *,
    intrinsics_sd: Mapping[str, npt.ArrayLike] | None = None,
    refine_intrinsics: bool = False,
    moved_frames: Mapping[str, tuple[int, int]] | None = None,
    floor_guess: tuple[int, ...] = (),
    tape: Iterable[TapeMeasure] = (),
) -> RigCalibration:
    """Place all ``cameras`` (only their intrinsics are used) by what they saw of ``targets``.

    The target called FLOOR, a FloorTarget seen in frame 0, tells where the world is; without it the first camera is
    taken for level. Every detection names its target. ``intrinsics_sd``, ``refine_intrinsics`` : as
    :func:`solve_rig` takes them. ``moved_frames``, ``floor_guess`` : as RigCalibration. Raises InputError naming
    cameras that see nothing, or groups that share no view.
    """
    floor = _floor_target(targets)
    # all cameras and targets at once, in the frame of what lies on the floor
    solution = solve_rig(
        cameras,
        detections,
        {name: target.points for name, target in targets.items()},
        reference=FLOOR_POSE if floor is not None else None,
        symmetry_orders={name: target.symmetry_order for name, target in targets.items()},
        intrinsics_sd=intrinsics_sd,
        refine_intrinsics=refine_intrinsics,
    )
    # z up, the origin on the floor (thesis 6.1)
    placed = place_rig(solution.cameras, solution.T_camera_reference, _world(solution, floor))
    views = {
        seen.camera: floor_view(seen, floor.points, solution.cameras[seen.camera])
        for seen in solution.detections  # numbered as the solver found right
        if floor is not None and seen.target == FLOOR
    }
    on_floor = None if floor is None else floor.points @ floor.T_world_floor[:3, :3].T + floor.T_world_floor[:3, 3]
    checks = tuple(measure.check(placed.rig) for measure in tape)
    figures = rig_figures(placed, solution, views)
    return RigCalibration(placed, solution, views, on_floor, figures, floor_guess, moved_frames or {}, checks)


def _floor_target(targets: Mapping[str, Target]) -> FloorTarget | None:
    floor = targets.get(FLOOR)
    if floor is not None and not isinstance(floor, FloorTarget):
        raise TypeError(f"the target called '{FLOOR}' must be a FloorTarget, which knows where it lies in the world")
    return floor


def _world(solution: RigSolution, floor: FloorTarget | None) -> Array:
    """T_world_reference."""
    if floor is None:
        return world_of_level_camera(solution.T_camera_reference[min(solution.T_camera_reference)])
    return floor.T_world_floor @ inverse(solution.T_reference_target[FLOOR_POSE])


# --- The pose of one camera from the floor board alone.


def floor_view(detection: TargetDetection, corners_board: Array, camera: CameraModel) -> FloorView:
    """Find the camera's pose before the board that ``detection`` shows. Only the intrinsics of ``camera`` are used.

    ``corners_board`` (n, 3) metres. Raises InputError for too few corners, and for a board seen from below.
    """
    if len(detection) < MIN_CORNERS:
        raise InputError(
            f"only {len(detection)} corners of the board are seen",
            where=detection.camera,
            remedy=f"Show it whole, or give its {MIN_CORNERS} outer corners (--corners).",
        )
    shape = target_shape(detection.target, corners_board)
    poses = detection_poses(detection, camera, shape)
    if poses is None:
        raise InputError(
            "the corners fit no pose of the board",
            where=detection.camera,
            remedy="Check its corners in the picture, or give its outer corners (--corners).",
        )
    T_camera_board = transform(poses.R, poses.t - poses.R @ shape.centroid)
    above = np.flatnonzero(inverse(T_camera_board)[:, 2, 3] > 0)
    if len(above) == 0:
        raise InputError(
            "the corners' order is that of a board seen from below or in a mirror",
            where=detection.camera,
            remedy="Lay the print upwards, switch off the camera's mirroring, and give outer corners "
            "in reading order: the first row's two ends, then the last row's last and first.",
        )
    squares = poses.rms_px[above] ** 2  # of distances: twice the noise of a coordinate
    sigma = max(detection.sigma_px, float(np.sqrt(squares[0] / 2)))
    ruled_out = len(detection) * (squares - squares[0]) > (CLEAR_SDS * sigma) ** 2
    to_camera = inverse(T_camera_board[above[0]])[:3, 3] - corners_board[detection.ids].mean(axis=0)
    return FloorView(
        camera=detection.camera,
        T_camera_board=T_camera_board[above[0]],
        other=T_camera_board[above[1]] if len(above) > 1 and not ruled_out[1] else None,
        angle=float(np.arccos(np.clip(to_camera[2] / np.linalg.norm(to_camera), -1.0, 1.0))),
    )
