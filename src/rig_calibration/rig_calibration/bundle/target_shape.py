"""A calibration target as the solver sees it: points about their centroid, flat or not, and which turns hide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from capture_rig.errors import InputError

from ..boards.board import Board, Checkerboard
from .rigid import Array, rotation

LINE, PLANE, VOLUME = 1, 2, 3
FLAT = 1e-6  # of the target's size


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A turn that maps the target onto itself: point i comes to lie on point ``permutation[i]``."""

    permutation: npt.NDArray[np.int64]
    R: Array


@dataclass(frozen=True, eq=False)
class TargetShape:
    """Points (n, 3) of a rigid target about their ``centroid`` (3,), metres, target frame.

    ``dimension`` is LINE, PLANE or VOLUME. ``turns`` are those that a picture does not show, the identity first;
    ``half_turn`` is the half turn that would map the points onto themselves, whether a picture shows it or not.
    """

    name: str
    points: Array
    centroid: Array
    dimension: int
    symmetries: tuple[Symmetry, ...]
    half_turn: Symmetry | None


def target_shape(name: str, points_target: npt.ArrayLike, symmetry_order: int = 1) -> TargetShape:
    """The shape of a target with points (n, 3); ``fold`` as in :func:`symmetry_order_of`.

    Raises InputError for fewer than two points, and when the points do not look alike after the turns of ``fold``.
    """
    points = np.asarray(points_target, float).reshape(-1, 3)
    if len(points) < 2 or not np.isfinite(points).all():
        raise InputError(f"target '{name}' has {len(points)} points", remedy="Give at least two points, in metres.")
    centred = points - points.mean(0)
    _, spread, axes = np.linalg.svd(centred, full_matrices=True)
    dimension = max(int(np.sum(spread > FLAT * spread[0])), 1)
    axis = axes[2] if dimension == PLANE else axes[1]  # of a line: any axis across it
    found = [_turn(centred, axis * 2 * np.pi * k / symmetry_order) for k in range(symmetry_order)]
    if any(symmetry is None for symmetry in found):
        raise InputError(
            f"target '{name}' does not look alike after 1/{symmetry_order} of a turn",
            remedy="Name it turnable only when its turns cannot be seen.",
        )
    half_turn = _turn(centred, axis * np.pi) if dimension < VOLUME else None
    return TargetShape(name, centred, points.mean(0), dimension, tuple(t for t in found if t is not None), half_turn)


def symmetry_order_of(board: Board) -> int:
    """How many ways round a board may lie without a picture showing it: 1 (its corners are told apart), 2 or 4."""
    if board.half_turn_is_visible or not isinstance(board, Checkerboard):
        return 1
    square = board.columns == board.rows and board.field_m[0] == board.field_m[1]
    return 4 if square and board.columns % 2 == 0 else 2


def shapes_of(targets: Mapping[str, npt.ArrayLike], symmetry_orders: Mapping[str, int]) -> dict[str, TargetShape]:
    """The shapes of all targets, in name order."""
    return {name: target_shape(name, targets[name], symmetry_orders.get(name, 1)) for name in sorted(targets)}


def _turn(centred: Array, vector: Array) -> Symmetry | None:
    R = rotation(vector)
    distance, nearest = cKDTree(centred).query(centred @ R.T)
    alike = distance.max() < 1e-3 * np.abs(centred).max() and len(set(nearest.tolist())) == len(nearest)
    return Symmetry(nearest.astype(np.int64), R) if alike else None
