"""Where a camera sees the corners of views, and the normal equations of the differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import kernel
from .parameters import BOW_NAMES, Array, LensModel
from .views import View


@dataclass(frozen=True, eq=False)
class Corners:
    """The corners of several views behind one another: those of view v are first[v] .. first[v + 1]."""

    first: npt.NDArray[np.int64]
    points_board: Array
    bow: Array
    pixels: Array
    sigma_px: Array

    @classmethod
    def of(cls, views: Sequence[View]) -> Corners:
        first = np.concatenate([[0], np.cumsum([len(view) for view in views])]).astype(np.int64)
        points, bow, pixels = (
            np.ascontiguousarray(np.concatenate([getattr(view, name) for view in views]))
            for name in ("points_board", "bow", "pixels")
        )
        return cls(first, points, bow, pixels, np.array([view.sigma_px for view in views]))

    def residuals(self, theta: Array, poses: Array, model: LensModel) -> Array:
        """(N, 2) seen minus expected, px."""
        expected = np.empty_like(self.pixels)
        kernel.project_all(_widened(theta, model), poses, self.first, self.points_board, self.bow, expected)
        return self.pixels - expected


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Blocks of the views: camera (V, p, p), mixed (V, p, 6), pose (V, 6, 6); right: theta (V, p), of_pose (V, 6)."""

    camera: Array
    mixed: Array
    pose: Array
    theta: Array
    of_pose: Array


def normal_equations(
    theta: Array, poses: Array, corners: Corners, model: LensModel, robust: float = np.inf
) -> NormalEquations:
    """For the parameters (p,) and poses (V, 6), rotation vector and translation camera from board.

    ``robust`` : standard deviations from which a corner counts for less (Cauchy's loss).
    """
    size = kernel.PARAMETERS + kernel.POSE
    matrices, rights = np.empty((len(poses), size, size)), np.empty((len(poses), size))
    kernel.normal_equations(
        _widened(theta, model),
        poses,
        corners.first,
        corners.points_board,
        corners.bow,
        corners.pixels,
        corners.sigma_px,
        robust,
        matrices,
        rights,
    )
    own, pose = _places(model), slice(kernel.PARAMETERS, size)
    return NormalEquations(
        matrices[:, own[:, None], own], matrices[:, own, pose], matrices[:, pose, pose], rights[:, own], rights[:, pose]
    )


def residuals(theta: Array, pose: Array, view: View, model: LensModel) -> Array:
    """(n, 2) of one view seen from ``pose`` (6,): seen minus expected, px."""
    return Corners.of([view]).residuals(theta, pose[None], model)


def _places(model: LensModel) -> npt.NDArray[np.int64]:
    """Where the model's parameters are among the kernel's."""
    count = len(model.names)
    return np.r_[:count, kernel.PARAMETERS - len(BOW_NAMES) : kernel.PARAMETERS]


def _widened(theta: Array, model: LensModel) -> Array:
    """The kernel's parameters; coefficients that the model has not are zero."""
    wide = np.zeros(kernel.PARAMETERS)
    wide[_places(model)] = theta
    return wide
