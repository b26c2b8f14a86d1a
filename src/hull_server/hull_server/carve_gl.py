"""The OpenGL backend: the hierarchical carve in compute shaders (OpenGL 4.3), as exact as the CPU's.

Silhouettes travel bit-packed; tiles of 8 x 8 pixels tell which bricks can hold anything; only those are tested voxel
by voxel, and only they are read back. The driver appends bricks in any order: they are sorted afterwards.
"""

from __future__ import annotations

import numpy as np

from capture_rig import InputError

from .boxes import UNSEEN, block_boxes, pixel_projections, summed_area
from .bricks import BrickVolume
from .carve_shaders import BRICKS, HEADER, LEAVES, PROJECT, TILES
from .egl import GlContext
from .gl_objects import GL, MAX_GL_CAMERAS, StorageBuffer, make_program
from .grid import BRICK_EDGE, VoxelGrid
from .views import Masks, RigViews

TILE_PX = 8
MAX_TILES = 4095  # tile coordinates are packed into 12 bits
BRICK_LIST_HEAD = 4  # words: size of the indirect dispatch, number of bricks


class GlCarver:
    """Carves in compute shaders. Any thread may call :meth:`carve`, one at a time.

    Raises NoGraphics when there is no such context, InputError when the rig is beyond the shaders' limits.
    """

    name = "gl"

    def __init__(self, views: RigViews, grid: VoxelGrid, hardware: bool | None = None) -> None:
        cameras, height, width = views.seen.shape
        if cameras > MAX_GL_CAMERAS or max(height, width) > MAX_TILES * TILE_PX:
            raise InputError(f"{cameras} cameras of {width} x {height} pixels are too much for the GL backend",
                             where="backend", remedy="Choose backend 'cpu'.")  # fmt: skip
        self.views, self.grid = views, grid
        self._packed = np.zeros((cameras, height, width // 8), np.uint8)
        self._foreground = np.zeros_like(views.seen)
        self._context = GlContext(hardware)
        self.device = self._context.renderer
        with self._context.current():
            self._compile(cameras, height, width)
            self._allocate(cameras, height, width)

    def carve(self, masks: Masks, min_seeing: int) -> BrickVolume:
        """As :meth:`hull_server.carve_cpu.CpuCarver.carve`."""
        present = self.views.present(masks)
        self.views.foreground(masks, present, self._foreground)
        self._packed[present] = np.packbits(self._foreground[present] != 0, axis=-1, bitorder="little")
        with self._context.current():
            self._buffers["foreground"].write(self._packed)
            self._buffers["bricks"].write(np.array([0, 1, 1, 0], np.uint32))
            self._dispatch(sum(1 << int(camera) for camera in present), min_seeing)
            index, leaves = self._read_back()
        return self._sorted(index, leaves)

    def close(self) -> None:
        """Release the context and everything in it."""
        self._context.close()

    def _compile(self, cameras: int, height: int, width: int) -> None:
        self._tiles = (-(-width // TILE_PX), -(-height // TILE_PX))
        header = HEADER.format(cameras=cameras, width=width, height=height, tile=TILE_PX,
                               tiles_x=self._tiles[0], tiles_y=self._tiles[1])  # fmt: skip
        self._programs = [make_program(compute=header + body) for body in (TILES, BRICKS, PROJECT + LEAVES)]
        for program in self._programs:
            GL.glUseProgram(program)
            GL.glUniform3i(GL.glGetUniformLocation(program, "grid"), *self.grid.shape)
            GL.glUniform3i(GL.glGetUniformLocation(program, "bricks"), *self.grid.brick_shape)

    def _allocate(self, cameras: int, height: int, width: int) -> None:
        bricks, projections = self.grid.brick_count, pixel_projections(self.views, self.grid)
        self._buffers = {  # in the order of their bindings
            "foreground": StorageBuffer(self._packed.nbytes),
            "seen": StorageBuffer(np.packbits(self.views.seen != 0, axis=-1, bitorder="little")),
            "projections": StorageBuffer(projections.astype(np.float32)),
            "tiles": StorageBuffer(4 * cameras * self._tiles[0] * self._tiles[1]),
            "boxes": StorageBuffer(self._tile_boxes()),
            "bricks": StorageBuffer(4 * (BRICK_LIST_HEAD + bricks)),
            "leaves": StorageBuffer(8 * BRICK_EDGE * bricks),
            "exact": StorageBuffer(projections),
        }

    def _tile_boxes(self) -> np.ndarray:
        """(bricks, N, 2) uint32: first and last tile in u, and what is seen; first and last tile in v."""
        boxes = block_boxes(self.views, self.grid, BRICK_EDGE, summed_area(self.views.seen))
        pixels = boxes.pixels.astype(np.int64)
        first = pixels[..., :2] // TILE_PX
        last = (pixels[..., 2:] - 1).clip(0) // TILE_PX
        words = (first | last << 12).astype(np.uint32)
        words[..., 0] |= boxes.sight.astype(np.uint32) << 24
        words[boxes.sight == UNSEEN] = 0
        return words

    def _dispatch(self, present: int, min_seeing: int) -> None:
        tiles, bricks, leaves = self._programs
        for binding, buffer in enumerate(self._buffers.values()):
            buffer.bind(binding)
        for program in (bricks, leaves):
            GL.glUseProgram(program)
            GL.glUniform1ui(GL.glGetUniformLocation(program, "present"), present)
            GL.glUniform1i(GL.glGetUniformLocation(program, "min_seeing"), min_seeing)
        GL.glUseProgram(tiles)
        GL.glDispatchCompute(-(-self._tiles[0] // 8), -(-self._tiles[1] // 8), len(self.views.names))
        GL.glMemoryBarrier(GL.GL_SHADER_STORAGE_BARRIER_BIT)
        GL.glUseProgram(bricks)
        GL.glDispatchCompute(-(-self.grid.brick_count // 64), 1, 1)
        GL.glMemoryBarrier(GL.GL_SHADER_STORAGE_BARRIER_BIT | GL.GL_COMMAND_BARRIER_BIT)
        GL.glUseProgram(leaves)
        GL.glBindBuffer(GL.GL_DISPATCH_INDIRECT_BUFFER, self._buffers["bricks"].name)
        GL.glDispatchComputeIndirect(0)
        GL.glMemoryBarrier(GL.GL_BUFFER_UPDATE_BARRIER_BIT)

    def _read_back(self) -> tuple[np.ndarray, np.ndarray]:
        found = int(self._buffers["bricks"].read(np.uint32, BRICK_LIST_HEAD)[3])
        index = self._buffers["bricks"].read(np.uint32, BRICK_LIST_HEAD + found)[BRICK_LIST_HEAD:]
        return index, self._buffers["leaves"].read(np.uint64, BRICK_EDGE * found).reshape(found, BRICK_EDGE)

    def _sorted(self, index: np.ndarray, leaves: np.ndarray) -> BrickVolume:
        """In brick order, without the bricks in which no voxel survived."""
        order = np.argsort(index)
        order = order[leaves[order].any(axis=1)]
        return BrickVolume(self.grid, index[order], leaves[order])
