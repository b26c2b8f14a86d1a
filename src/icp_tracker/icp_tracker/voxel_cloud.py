"""The hull's voxels as the tracker takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class VoxelCloud:
    """Samples of the hull. points_world (m, 3) m; surface (m,) bool, True where a neighbour of the voxel is empty."""

    points_world: np.ndarray
    surface: np.ndarray

    def __len__(self) -> int:
        return len(self.surface)

    @staticmethod
    def checked(points_world: np.ndarray, surface: np.ndarray) -> VoxelCloud:
        """The samples whose coordinates are finite, as contiguous arrays."""
        points = np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
        finite = np.isfinite(points).all(axis=1)
        return VoxelCloud(np.ascontiguousarray(points[finite]), np.asarray(surface, dtype=np.bool_)[finite])

    def surface_points(self, count: int) -> np.ndarray:
        """At most ``count`` samples (m, 3) of the surface, evenly spread over the rows; the same ones every time."""
        return _thinned(self.points_world[self.surface], count)

    def hull_points(self, count: int) -> np.ndarray:
        """At most ``count`` samples (m, 3) of surface and interior, evenly spread over the rows."""
        return _thinned(self.points_world, count)


def _thinned(points: np.ndarray, count: int) -> np.ndarray:
    if len(points) > count:
        points = points[np.arange(count) * len(points) // count]
    return np.ascontiguousarray(points)


NO_VOXELS = VoxelCloud(np.empty((0, 3)), np.empty(0, dtype=np.bool_))
