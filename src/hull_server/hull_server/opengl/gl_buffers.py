"""The buffers of one frame set under way on the device: what goes there, and what comes home."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..grid import BRICK_EDGE
from .egl import NoGraphics
from .gl_objects import GL, StorageBuffer
from .gl_upload import FRAME_OFFSET, LISTS

BRICK = np.dtype([("index", "<u4"), ("cameras", "<u4", 3), ("leaves", "<u8", BRICK_EDGE)])  # as the shaders' Brick
LIST_BYTES = 16  # size of a dispatch, and length
LISTS_BYTES = LIST_BYTES * LISTS
LENGTH_OF_BRICKS = 7  # word of the lists
LEAST_GUESS = 1024  # bricks
PATIENCE_NS = 10_000_000_000  # for the carve of one frame set


class BufferSet:
    """Upload, bricks and read-back of one frame set. To be used with the context current."""

    def __init__(self, upload_bytes: int, bricks: int) -> None:
        self.frame = StorageBuffer(upload_bytes)
        self._bricks = StorageBuffer(BRICK.itemsize * bricks)
        self._home = StorageBuffer(LISTS_BYTES + self._bricks.nbytes, GL.GL_STREAM_READ)
        self._texture = int(GL.glGenTextures(1))
        GL.glBindTexture(GL.GL_TEXTURE_BUFFER, self._texture)
        GL.glTexBuffer(GL.GL_TEXTURE_BUFFER, GL.GL_R32I, self.frame.name)
        self._capacity, self._expected = bricks, min(LEAST_GUESS, bricks)
        self._fence: object = None

    def bind(self, lists: int, frame: int, bricks: int) -> None:
        """Bind to these binding points; the frame as the texture too, the lists to indirect dispatch too."""
        self.frame.bind_part(lists, 0, LISTS_BYTES)
        self.frame.bind_part(frame, FRAME_OFFSET, self.frame.nbytes - FRAME_OFFSET)
        self._bricks.bind(bricks)
        GL.glBindTexture(GL.GL_TEXTURE_BUFFER, self._texture)
        GL.glBindBuffer(GL.GL_DISPATCH_INDIRECT_BUFFER, self.frame.name)

    def send_home(self) -> None:
        """Queue the copies of the lists' lengths and of as many bricks as are to be expected, and a fence behind."""
        GL.glBindBuffer(GL.GL_COPY_WRITE_BUFFER, self._home.name)
        for source, offset, nbytes in (
            (self.frame, 0, LISTS_BYTES),
            (self._bricks, LISTS_BYTES, BRICK.itemsize * self._expected),
        ):
            GL.glBindBuffer(GL.GL_COPY_READ_BUFFER, source.name)
            GL.glCopyBufferSubData(GL.GL_COPY_READ_BUFFER, GL.GL_COPY_WRITE_BUFFER, 0, offset, nbytes)
        self._fence = GL.glFenceSync(GL.GL_SYNC_GPU_COMMANDS_COMPLETE, 0)
        GL.glFlush()

    def list_lengths(self) -> list[int]:
        """What the kernels left to one another: coarse blocks, bricks, blocks, halves of blocks. Waits for them."""
        return [int(length) for length in self.frame.read(np.uint32, 4 * LISTS)[3::4]]

    def has_arrived(self) -> bool:
        """Whether what was sent home is there already."""
        return GL.glClientWaitSync(self._fence, 0, 0) == GL.GL_ALREADY_SIGNALED

    def arrived(self) -> npt.NDArray:
        """Wait for what was sent home: (k,) BRICK, in no particular order. NoGraphics when it does not come."""
        if GL.glClientWaitSync(self._fence, 0, PATIENCE_NS) not in (GL.GL_ALREADY_SIGNALED, GL.GL_CONDITION_SATISFIED):
            raise NoGraphics(f"the device did not finish a carve within {PATIENCE_NS // 10**9} s; choose backend 'cpu'")
        GL.glDeleteSync(self._fence)
        found = int(self._home.read(np.uint32, 4 * LISTS)[LENGTH_OF_BRICKS])
        if found <= self._expected:
            bricks = self._home.read(np.uint8, LISTS_BYTES + BRICK.itemsize * found)[LISTS_BYTES:].view(BRICK)
        else:
            bricks = self._bricks.read(BRICK, found)  # more than expected: fetch them all
        self._expected = min(max(LEAST_GUESS, 2 * found), self._capacity)
        return bricks
