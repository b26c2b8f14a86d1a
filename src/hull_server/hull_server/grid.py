"""The voxel grid, and the hull as bricks of its voxels: the sparse occupancy that every backend returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from capture_rig import InputError, Volume
from capture_rig.kernel import kernel

from .bitset import lowest_bit

BRICK_EDGE = 8  # voxels along the edge of a brick
MAX_BRICKS = 1 << 22  # two thousand million voxels; more is a typing error in the voxel size

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """A regular grid of cubes in the map frame (thesis 3.1.1).

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
        """Make the smallest grid that starts at the volume's low corner and covers it.

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
        """Convert voxel indices (n, 3), whole or fractional, to points (n, 3), metres, map frame."""
        return self.origin + (np.asarray(voxels, float) + 0.5) * self.voxel_size

    def projection_from_voxels(self, P: Array) -> Array:
        """Convert projections (..., 3, 4) of map points to projections of voxel indices (i, j, k, 1)."""
        world_from_voxel = np.eye(4)
        world_from_voxel[:3, :3] *= self.voxel_size
        world_from_voxel[:3, 3] = self.origin + 0.5 * self.voxel_size
        return P @ world_from_voxel


_BITS_IN_BYTE = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1).sum(axis=1)


@dataclass(frozen=True, eq=False)
class BrickVolume:
    """The occupied voxels of a grid, as bricks of 8 x 8 x 8 voxels that hold at least one of them.

    index : (k,) uint32, ascending: ``(bz * bricks_y + by) * bricks_x + bx``.
    leaves : (k, 8) uint64: word = layer z of the brick, bit = ``8 y + x`` inside it.
    """

    grid: VoxelGrid
    index: npt.NDArray[np.uint32]
    leaves: npt.NDArray[np.uint64]

    @classmethod
    def from_dense(cls, grid: VoxelGrid, occupied: npt.NDArray[np.bool_]) -> BrickVolume:
        """Pack a dense (nx, ny, nz) array, nonzero where occupied."""
        x, y, z = grid.brick_shape
        padded = np.zeros((z * BRICK_EDGE, y * BRICK_EDGE, x * BRICK_EDGE), bool)
        nx, ny, nz = grid.shape
        padded[:nz, :ny, :nx] = np.asarray(occupied, bool).transpose(2, 1, 0)
        blocks = padded.reshape(z, BRICK_EDGE, y, BRICK_EDGE, x, BRICK_EDGE).transpose(0, 2, 4, 1, 3, 5)
        packed = np.packbits(blocks.reshape(-1, BRICK_EDGE**2), axis=1, bitorder="little")
        leaves = packed.view("<u8").reshape(-1, BRICK_EDGE).astype(np.uint64)
        index = np.flatnonzero(leaves.any(axis=1)).astype(np.uint32)
        return cls(grid, index, leaves[index])

    def to_dense(self) -> npt.NDArray[np.bool_]:
        """Unpack to (nx, ny, nz) bool, True where occupied."""
        dense = np.zeros(self.grid.shape, bool)
        dense[tuple(self.voxels().T)] = True
        return dense

    @property
    def count(self) -> int:
        """Number of occupied voxels."""
        return int(_BITS_IN_BYTE[np.ascontiguousarray(self.leaves).view(np.uint8)].sum())

    @property
    def litres(self) -> float:
        """The volume of the occupied voxels; a person has 60 to 90 litres, a hull somewhat more."""
        return self.count * self.grid.voxel_volume_m3 * 1e3

    def voxels(self) -> npt.NDArray[np.int64]:
        """Return the indices (i, j, k) (count, 3) of the occupied voxels, in brick order."""
        found = np.empty((self.count, 3), np.int64)
        _list_voxels(self.brick_corners(), np.ascontiguousarray(self.leaves), found)
        return found

    def brick_corners(self) -> npt.NDArray[np.int64]:
        """Return the voxel indices (k, 3) of each brick's low corner."""
        nx, ny, _ = self.grid.brick_shape
        index = self.index.astype(np.int64)
        return np.stack([index % nx, index // nx % ny, index // (nx * ny)], axis=1) * BRICK_EDGE


@kernel
def _list_voxels(corners, leaves, voxels):  # type: ignore[no-untyped-def]
    """Write the indices (count, 3) of the occupied voxels of bricks with low corners (k, 3)."""
    row = 0
    for brick in range(leaves.shape[0]):
        for layer in range(BRICK_EDGE):
            left = leaves[brick, layer]
            while left:
                bit = lowest_bit(left)
                left &= left - np.uint64(1)
                voxels[row, 0] = corners[brick, 0] + (bit & 7)
                voxels[row, 1] = corners[brick, 1] + (bit >> 3)
                voxels[row, 2] = corners[brick, 2] + layer
                row += 1
