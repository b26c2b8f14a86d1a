"""From detections of boards to the rig in the world, its figures and its verdict: the recipe of the extrinsics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.rigid import inverse

from ..boards.board import Board, TargetDetection
from ..boards.wand import WAND
from ..bundle.problem import symmetry_order_of
from ..bundle.solve import RigSolution, solve_rig
from .floor import FLOOR, floor_view
from .verdict import RigCalibration, TapeMeasure
from .world import WorldChoice, board_in_world, place_rig, rig_figures, world_of_level_camera

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
    require_way_round(detections, targets)
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


def require_way_round(detections: Iterable[TargetDetection], targets: Mapping[str, Target]) -> None:
    """Raise InputError when only the floor target ties the cameras together and no picture tells which way round it
    lies: each camera might as well stand on the other side of it."""
    seen = {(detection.target, detection.camera) for detection in detections}
    on_floor = sorted(camera for target, camera in seen if target == FLOOR)
    floor = targets.get(FLOOR)
    if floor is None or floor.symmetry_order == 1 or len(on_floor) < 2 or any(target != FLOOR for target, _ in seen):
        return
    raise InputError(
        f"the floor board looks the same after 1/{floor.symmetry_order} of a turn, so that {', '.join(on_floor)} may "
        "as well stand on the other side of it",
        remedy="Use a board with an odd and an even number of inner corners, or a ChArUco board; or carry a board "
        "through the room (--moving); or give its outer corners in each picture, the same one first (--corners).",
    )


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
