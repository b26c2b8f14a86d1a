"""Carves on OpenGL: the hierarchical carve in compute shaders (OpenGL 4.3), as exact as the CPU's.

A frame set is one upload, five dispatches and one read-back of the bricks found. The caller waits for it; meanwhile the
pipeline's other thread works on the frame set before.

Consumer GPUs compute in double precision 32 to 64 times slower than in single. Single precision is enough wherever a
voxel lands farther from the nearest border between two pixels than its rounding error; the others are computed again in
double. Origins in the middle of the grid and of the canvas keep the numbers, and so the rounding, small.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from capture_rig import InputError

from ..carving.pixel_boxes import UNSEEN, block_boxes, pixel_projections, summed_area
from ..grid import BRICK_EDGE, BrickVolume, VoxelGrid
from ..views import Boxes, Masks, RigViews
from .carve_shaders import HEADER, KERNELS
from .egl import GlContext, NoGraphics
from .gl_buffers import FRAME_OFFSET, GL, LISTS, FrameUpload, StorageBuffer, check_cameras, make_program

# Thresholds: from the rounding of single precision; python bench/hull.py --quick counts differences from float64.
UNIT = float(np.finfo(np.float32).eps) / 2  # relative rounding of one operation
IN_SUMS = 8  # roundings on the way to a row's value: the entry's own, a product, three sums, three steps in a block
IN_QUOTIENT = 8  # and from there: a reciprocal that may be five units off, a product, canvas's centre and margin added

GROUP = 64  # invocations of a work group
GROUPS_IN_ROW = 32768  # work groups along x; every driver allows 65535
COARSE_EDGE = 32
BLOCKS_PER_BRICK = 8
COARSE_BYTES, BLOCK_BYTES, RECHECK_BYTES = 16, 16, 8  # of the lists' entries; voxels to recheck by half blocks
BOX_BYTES = 8
BRICK = np.dtype([("index", "<u4"), ("cameras", "<u4", 3), ("leaves", "<u8", BRICK_EDGE)])  # as the shaders' Brick
LIST_BYTES = 16  # size of a dispatch, and length
LENGTH_OF_BRICKS = 7  # word of the lists
PATIENCE_NS = 10_000_000_000  # for the carve of one frame set


class GlCarver:
    """Carves in compute shaders. Any thread may call any method: the context serves one at a time, the others wait.

    Raises NoGraphics when there is no such context, InputError when the rig or the grid is beyond its limits.
    """

    name = "gl"

    def __init__(self, views: RigViews, grid: VoxelGrid, hardware: bool | None = None) -> None:
        check_cameras(len(views.names))
        self.views, self.grid = views, grid
        self._upload = FrameUpload(views)
        self._context = GlContext(hardware)
        self.device = self._context.renderer
        try:
            with self._context.current():
                self._compile()
                self._allocate()
        except (NoGraphics, InputError):
            self.close()
            raise

    def carve(self, masks: Masks, min_seeing: int, boxes: Boxes | None = None) -> BrickVolume:
        """Carve as :meth:`hull_server.carving.cpu_carver.CpuCarver.carve`."""
        present = self.views.present(masks)
        with self._context.current():
            self._frame.write(self._upload.fill(masks, present, min_seeing))
            self._run_kernels()
            bricks = self._read_bricks()
        # in brick order, without the bricks in which no voxel survived
        order = np.argsort(bricks["index"])
        leaves = bricks["leaves"][order]
        kept = leaves.any(axis=1)
        return BrickVolume(self.grid, bricks["index"][order[kept]], leaves[kept])

    def close(self) -> None:
        """Release the context and everything in it."""
        self._context.close()

    def _compile(self) -> None:
        cameras, height, width = self.views.seen.shape
        nx, ny, nz = (-(-count // COARSE_EDGE) for count in self.grid.shape)
        self._coarse_blocks = nx * ny * nz
        rows, centre, border = single_precision(self.views, self.grid)
        header = HEADER.format(
            cameras=cameras,
            width=width,
            height=height,
            labels=self._upload.labels_start,
            grid=self.grid.shape,
            bricks=self.grid.brick_shape,
            coarse=(nx, ny, nz),
            centre=tuple(map(int, centre)),
            border=border,
            groups=GROUPS_IN_ROW,
        )
        self._programs = {name: make_program(compute=header + kernel) for name, kernel in KERNELS.items()}
        for program in self._programs.values():
            GL.glUseProgram(program)
            GL.glUniform4fv(GL.glGetUniformLocation(program, "projection"), 3 * cameras, rows)

    def _allocate(self) -> None:
        blocks = BLOCKS_PER_BRICK * self.grid.brick_count
        self._check_limits(max(BLOCK_BYTES * blocks, BOX_BYTES * len(self.views.names) * self.grid.brick_count))
        contents: dict[int, np.ndarray | int] = {
            0: pixel_projections(self.views, self.grid),
            1: np.concatenate([self._boxes(COARSE_EDGE), self._boxes(BRICK_EDGE)], axis=None),
            4: COARSE_BYTES * self._coarse_blocks,
            6: BLOCK_BYTES * blocks,
            7: RECHECK_BYTES * blocks,
        }
        for binding, content in contents.items():
            StorageBuffer(content).bind(binding)
        self._frame = StorageBuffer(self._upload.words.nbytes)
        self._bricks = StorageBuffer(BRICK.itemsize * self.grid.brick_count)
        self._read_back = StorageBuffer(self._bricks.nbytes, GL.GL_STREAM_READ)
        self._texture = int(GL.glGenTextures(1))
        GL.glBindTexture(GL.GL_TEXTURE_BUFFER, self._texture)
        GL.glTexBuffer(GL.GL_TEXTURE_BUFFER, GL.GL_R32I, self._frame.name)

    def _check_limits(self, table_bytes: int) -> None:
        """Raise InputError when the largest table or the upload is beyond what the driver can address."""
        for needed, what, limit in (
            (table_bytes, "bytes for a table of the voxels", GL.GL_MAX_SHADER_STORAGE_BLOCK_SIZE),
            (self._upload.words.size, "words for all silhouettes", GL.GL_MAX_TEXTURE_BUFFER_SIZE),
        ):
            allowed = int(GL.glGetIntegerv(limit))
            if needed > allowed:
                raise InputError(
                    f"OpenGL needs {needed} {what}; {self.device} allows {allowed}",
                    where="backend",
                    remedy="Use larger voxels, a smaller volume or smaller images, or choose backend 'cpu'.",
                )

    def _boxes(self, edge: int) -> np.ndarray:
        """Pack pixel boxes (N, blocks, 2) uint32: u, v from, in 15 bits each, and visibility in the two bits above;
        u, v to."""
        boxes = block_boxes(self.views, self.grid, edge, summed_area(self.views.seen))
        pixels = boxes.pixels.astype(np.uint32)
        pixels[boxes.visibility == UNSEEN] = 0
        words = pixels[..., 0::2] | pixels[..., 1::2] << 15
        words[..., 0] |= boxes.visibility.astype(np.uint32) << 30
        return words

    def _run_kernels(self) -> None:
        """Queue one kernel after the other, each to do what the list of the one before holds."""
        name, nbytes = self._frame.name, self._frame.nbytes - FRAME_OFFSET
        GL.glBindBufferRange(GL.GL_SHADER_STORAGE_BUFFER, 2, name, 0, LIST_BYTES * LISTS)
        GL.glBindBufferRange(GL.GL_SHADER_STORAGE_BUFFER, 3, name, FRAME_OFFSET, nbytes)
        self._bricks.bind(5)
        GL.glBindTexture(GL.GL_TEXTURE_BUFFER, self._texture)
        GL.glBindBuffer(GL.GL_DISPATCH_INDIRECT_BUFFER, name)
        for number, program in enumerate(self._programs.values()):
            GL.glUseProgram(program)
            if number == 0:
                GL.glDispatchCompute(-(-self._coarse_blocks // GROUP), 1, 1)
            else:
                GL.glDispatchComputeIndirect(LIST_BYTES * (number - 1))
            GL.glMemoryBarrier(GL.GL_SHADER_STORAGE_BARRIER_BIT | GL.GL_COMMAND_BARRIER_BIT)
        GL.glMemoryBarrier(GL.GL_BUFFER_UPDATE_BARRIER_BIT)

    def _read_bricks(self) -> npt.NDArray:
        """Wait for the bricks found (k,) BRICK, in no particular order. NoGraphics when they do not come."""
        fence = GL.glFenceSync(GL.GL_SYNC_GPU_COMMANDS_COMPLETE, 0)
        state = GL.glClientWaitSync(fence, GL.GL_SYNC_FLUSH_COMMANDS_BIT, PATIENCE_NS)
        GL.glDeleteSync(fence)
        if state not in (GL.GL_ALREADY_SIGNALED, GL.GL_CONDITION_SATISFIED):
            raise NoGraphics(f"the device did not finish a carve within {PATIENCE_NS // 10**9} s; choose backend 'cpu'")
        count = int(self._frame.read(np.uint32, 4 * LISTS)[LENGTH_OF_BRICKS])
        GL.glBindBuffer(GL.GL_COPY_READ_BUFFER, self._bricks.name)
        GL.glBindBuffer(GL.GL_COPY_WRITE_BUFFER, self._read_back.name)
        nbytes = BRICK.itemsize * count
        GL.glCopyBufferSubData(GL.GL_COPY_READ_BUFFER, GL.GL_COPY_WRITE_BUFFER, 0, 0, nbytes)
        return self._read_back.read(BRICK, count)


def single_precision(views: RigViews, grid: VoxelGrid) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64], float]:
    """Return rows, centre and border for a rig and a grid.

    rows : (N, 3, 4), voxel (i, j, k, 1) less ``centre`` to pixel less half the canvas, times depth w. centre : (3,) the
    voxel in the middle of the grid. border : a pixel coordinate computed with these rows is less than ``border / w``
    away from the true one; pixels times the unit of w, which is metres; of all roundings' sum (Higham 2002, 3.1).
    """
    _, height, width = views.seen.shape
    centre = np.array(grid.shape, np.int64) // 2
    P = pixel_projections(views, grid)
    P[..., 3] += P[..., :3] @ centre
    P[:, :2] -= 0.5 * np.array([width, height])[:, None] * P[:, 2:]
    largest = np.abs(P) @ np.append(centre + 1.0, 1.0)  # (N, 3) sums of absolute terms, anywhere in the grid
    sums = IN_SUMS * largest[:, :2].max(axis=1)
    depth = (IN_SUMS + IN_QUOTIENT) * 0.5 * max(width, height) * largest[:, 2]
    return P.astype(np.float32), centre, float(UNIT * (sums + depth).max())
