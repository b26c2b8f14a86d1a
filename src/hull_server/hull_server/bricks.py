"""The hull as bricks: the sparse occupancy that every backend returns and every later stage reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .grid import BRICK_EDGE, Array, VoxelGrid

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
    def empty(cls, grid: VoxelGrid) -> BrickVolume:
        return cls(grid, np.zeros(0, np.uint32), np.zeros((0, BRICK_EDGE), np.uint64))

    @classmethod
    def from_dense(cls, grid: VoxelGrid, occupied: npt.NDArray[np.bool_]) -> BrickVolume:
        """From a dense (nx, ny, nz) array, nonzero where occupied."""
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
        """(nx, ny, nz) bool, True where occupied."""
        x, y, z = self.grid.brick_shape
        blocks = np.zeros((z * y * x, BRICK_EDGE, BRICK_EDGE, BRICK_EDGE), bool)
        blocks[self.index] = self._bits()
        dense = blocks.reshape(z, y, x, *blocks.shape[1:]).transpose(0, 3, 1, 4, 2, 5)
        nx, ny, nz = self.grid.shape
        whole = dense.reshape(z * BRICK_EDGE, y * BRICK_EDGE, x * BRICK_EDGE)
        return whole.transpose(2, 1, 0)[:nx, :ny, :nz]

    @property
    def count(self) -> int:
        """Number of occupied voxels."""
        return int(_BITS_IN_BYTE[np.ascontiguousarray(self.leaves).view(np.uint8)].sum())

    @property
    def litres(self) -> float:
        """The volume of the occupied voxels; a person has 60 to 90 litres, a hull somewhat more."""
        return self.count * self.grid.voxel_volume_m3 * 1e3

    def voxels(self) -> npt.NDArray[np.int64]:
        """(count, 3) indices (i, j, k) of the occupied voxels, in brick order."""
        brick, z, y, x = np.nonzero(self._bits())
        return self.brick_corners()[brick] + np.stack([x, y, z], axis=1)

    def brick_corners(self) -> npt.NDArray[np.int64]:
        """(k, 3) voxel indices (i, j, k) of each brick's low corner."""
        nx, ny, _ = self.grid.brick_shape
        index = self.index.astype(np.int64)
        return np.stack([index % nx, index // nx % ny, index // (nx * ny)], axis=1) * BRICK_EDGE

    def centres_world(self) -> Array:
        """(count, 3) centres of the occupied voxels, metres, map frame."""
        return self.grid.centres_world(self.voxels())

    def _bits(self) -> npt.NDArray[np.bool_]:
        """(k, z, y, x) one bool per voxel."""
        as_bytes = np.ascontiguousarray(self.leaves.astype("<u8")).view(np.uint8)
        bits = np.unpackbits(as_bytes, bitorder="little").view(bool)
        return bits.reshape(-1, BRICK_EDGE, BRICK_EDGE, BRICK_EDGE)
