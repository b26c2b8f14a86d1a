"""The voxel grid: the capture volume cut into small cubes (thesis 3.1.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from capture_rig import InputError, Volume

BRICK_EDGE = 8  # voxels along the edge of a brick
MAX_BRICKS = 1 << 22  # two thousand million voxels; more is a mistyped voxel size

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """A regular grid of cubes in the map frame.

    origin : (3,) the grid's low corner, metres.
    voxel_size : edge of a voxel, metres.
    shape : voxels along x, y and z.

    Voxel (i, j, k) has its centre at ``origin + (i + 0.5, j + 0.5, k + 0.5) * voxel_size``.
    """

    origin: Array
    voxel_size: float
    shape: tuple[int, int, int]

    @classmethod
    def covering(cls, volume: Volume, voxel_size: float) -> VoxelGrid:
        """The smallest grid that starts at the volume's low corner and covers it.

        Raises InputError when the grid would be absurdly large.
        """
        counts = np.ceil((volume.high - volume.low) / voxel_size - 1e-9).astype(int).clip(1)
        grid = cls(np.array(volume.low, float), float(voxel_size), (int(counts[0]), int(counts[1]), int(counts[2])))
        if np.prod(grid.brick_shape, dtype=float) > MAX_BRICKS:
            raise InputError(
                f"voxel_size_m = {voxel_size} cuts the volume into {' x '.join(map(str, grid.shape))} voxels",
                remedy="Use larger voxels (0.01 to 0.02 m suit a person) or a smaller volume.",
            )
        return grid

    @property
    def brick_shape(self) -> tuple[int, int, int]:
        """Bricks of 8 x 8 x 8 voxels along x, y and z; the last of a row may be partly outside the grid."""
        x, y, z = (-(-count // BRICK_EDGE) for count in self.shape)
        return x, y, z

    @property
    def brick_count(self) -> int:
        x, y, z = self.brick_shape
        return x * y * z

    @property
    def voxel_volume_m3(self) -> float:
        return self.voxel_size**3

    def centres_world(self, voxels: npt.ArrayLike) -> Array:
        """Voxel indices (n, 3), whole or fractional, to points (n, 3), metres, map frame."""
        return self.origin + (np.asarray(voxels, float) + 0.5) * self.voxel_size

    def projection_from_voxels(self, P: Array) -> Array:
        """(..., 3, 4) projections of map points to the same projections of voxel indices (i, j, k, 1)."""
        world_from_voxel = np.eye(4)
        world_from_voxel[:3, :3] *= self.voxel_size
        world_from_voxel[:3, 3] = self.origin + 0.5 * self.voxel_size
        return P @ world_from_voxel
