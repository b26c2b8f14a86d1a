"""From detections of boards to the rig in the world, its figures and its verdict: the recipe of the extrinsics (thesis
6.1)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.lens import Array
from capture_rig.rig import Rig
from capture_rig.rigid import inverse, transform

from ..boards.board import Board, TargetDetection
from ..boards.wand import WAND
from ..bundle.problem import detection_poses, symmetry_order_of, target_shape
from ..bundle.robust_fit import CLEAR_SDS
from ..bundle.solve import RigSolution, solve_rig
from .verdict import FLOOR, RigCalibration, TapeMeasure
from .world import WorldChoice, board_in_world, camera_figures, common_volume, placed_cameras, world_of_level_camera

MOVING = "moving"
"""Name of a target, beside FLOOR and WAND."""
FLOOR_POSE = (FLOOR, 0)
__all__ = ["FLOOR", "MOVING", "WAND", "RigCalibration", "Target", "calibrate_rig"]


@dataclass(frozen=True, eq=False)
class Target:
    """Something of known shape: points (n, 3) in its own frame, metres.

    symmetry_order : how many ways round it may lie without a picture showing it (1: its points are told apart).
    T_world_target (4, 4) : where it lies in the world; None of what is carried.
    """

    points: Array
    symmetry_order: int = 1
    T_world_target: Array | None = None

    @classmethod
    def of(cls, board: Board, choice: WorldChoice | None = None) -> Target:
        """Return a board as a target; with a ``choice``, one on the floor from which the world is measured so."""
        T_world_board = None if choice is None else board_in_world(board.corners_board, choice)
        return cls(board.corners_board, symmetry_order_of(board), T_world_board)


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

    The target called FLOOR, seen in frame 0, tells where the world is; without it the first camera is taken for level.
    Every detection names its target. ``intrinsics_sd``, ``refine_intrinsics`` : as :func:`solve_rig` takes them.
    ``moved_frames``, ``floor_guess`` : as RigCalibration. Raises InputError naming cameras that see nothing, or groups
    that share no view.
    """
    floor = targets.get(FLOOR)
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
    if floor is None or floor.T_world_target is None:
        T_world_reference, on_floor = world_of_level_camera(solution.T_camera_reference[min(cameras)]), None
    else:
        T_world_reference = floor.T_world_target @ inverse(solution.T_reference_target[FLOOR_POSE])
        on_floor = floor.points @ floor.T_world_target[:3, :3].T + floor.T_world_target[:3, 3]
    cameras_world = placed_cameras(solution, T_world_reference)
    common = common_volume(cameras_world)
    rig = Rig(cameras_world, common.box)
    return RigCalibration(
        rig=rig,
        common=common,
        solution=solution,
        floor={} if floor is None else _floor_views(solution, floor.points),
        floor_world=on_floor,
        figures=camera_figures(rig, solution, on_floor, FLOOR),
        floor_guess=floor_guess,
        moved_frames=moved_frames or {},
        tape=tuple(measure.checked(rig) for measure in tape),
    )


def _floor_views(solution: RigSolution, points: Array) -> dict[str, bool]:
    """Tell, by camera that shows the floor target, whether its picture alone leaves two poses above the floor.

    The floor board is mostly seen at a grazing angle, and a plane has two poses that fit its picture nearly as well
    (Schweighofer & Pinz 2006).
    """
    shape, views = target_shape(FLOOR, points), {}
    for seen in solution.detections:  # numbered as the solver found right
        if seen.target != FLOOR:
            continue
        views[seen.camera] = False
        if (poses := detection_poses(seen, solution.cameras[seen.camera], shape)) is not None:
            T_target_camera = inverse(transform(poses.R, poses.t))
            squares = poses.rms_px[T_target_camera[:, 2, 3] > 0] ** 2  # of distances: twice the noise of a coordinate
            sigma_px = max(seen.sigma_px, float(np.sqrt(squares[:1].sum() / 2)))
            views[seen.camera] = bool((len(seen) * (squares[1:] - squares[:1]) <= (CLEAR_SDS * sigma_px) ** 2).any())
    return views
