"""The measurement of the filter: the 15 reference points with a covariance each (thesis eq. 5.48)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from capture_rig.errors import InputError
from stick_figure.skeleton import POINT_NAMES

from .algebra import positive3

POINTS = len(POINT_NAMES)
ASYMMETRY_M2 = 1e-9
"""m^2: more than rounding of float32 leaves between the two triangles of a covariance."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """z and R of one frame set.

    points_world : (15, 3) metres
    covariance : (15, 3, 3) m^2, each positive definite; points are taken as independent of each other
    visible : (15,) bool, the points that were measured
    """

    points_world: np.ndarray
    covariance: np.ndarray
    visible: np.ndarray

    @classmethod
    def checked(
        cls, points_world: np.ndarray, covariance: np.ndarray, visible: np.ndarray, sd_floor: float
    ) -> Measurement:
        """A measurement whose points have at least the standard deviation ``sd_floor`` (m) in every direction.

        Numbers of points that are not visible are ignored. Raises InputError for wrong shapes, numbers that are not
        finite, and covariances that are not symmetric or not positive.
        """
        points_world = np.ascontiguousarray(points_world, float)
        covariance = np.ascontiguousarray(covariance, float)
        visible = np.ascontiguousarray(visible, bool)
        for name, array, shape in (
            ("points", points_world, (POINTS, 3)),
            ("covariance", covariance, (POINTS, 3, 3)),
            ("visible", visible, (POINTS,)),
        ):
            if array.shape != shape:
                raise InputError(f"{name} has shape {array.shape}", remedy=f"Expected {shape}.")
        z, R = np.zeros((POINTS, 3)), np.zeros((POINTS, 3, 3))
        if not _take(points_world, covariance, visible, sd_floor**2, z, R):
            _complain(z, R)
        return cls(z, R, visible.copy())


@njit(cache=True)
def _take(points_world, covariance, visible, floor, z, R):
    """z and R <- what is visible, the floor (m^2) added to each variance; whether all of it can be used."""
    good = True
    for point in range(POINTS):
        if visible[point]:
            z[point] = points_world[point]
            R[point] = covariance[point]
        for i in range(3):
            good = good and math.isfinite(z[point, i])
            for j in range(i):
                good = good and abs(R[point, i, j] - R[point, j, i]) < ASYMMETRY_M2
            R[point, i, i] += floor
        good = good and positive3(R[point])
    return good


def _complain(points_world: np.ndarray, covariance: np.ndarray) -> None:
    """Raises InputError that names the first bad point and what is wrong with it."""
    for i, name in enumerate(POINT_NAMES):
        problem = "has a covariance that is not positive"
        if not np.isfinite(points_world[i]).all():
            problem = "is not finite"
        elif not np.isfinite(covariance[i]).all():
            problem = "has a covariance that is not finite"
        elif _asymmetry(covariance[i]) >= ASYMMETRY_M2:
            problem = "has an asymmetric covariance"
        elif np.linalg.eigvalsh(covariance[i])[0] > 0.0:
            continue
        raise InputError(f"point '{name}' {problem}", remedy="Mark points that could not be measured as not visible.")


def _asymmetry(covariance: np.ndarray) -> np.ndarray:
    return np.abs(covariance - covariance.swapaxes(-1, -2)).max(axis=(-1, -2))
