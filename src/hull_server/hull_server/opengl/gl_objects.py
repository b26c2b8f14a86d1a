"""The few OpenGL objects that the GL backends share: programs, storage buffers and their transfers."""

from __future__ import annotations

import ctypes

import numpy as np
import numpy.typing as npt

from .egl import NoGraphics  # imported first: it tells PyOpenGL to use EGL

from OpenGL import GL  # isort: skip

MAX_GL_CAMERAS = 32  # cameras of a frame set are the bits of one shader word


def make_program(**sources: str) -> int:
    """Compile and link shaders given by stage: ``compute=...``, or ``vertex=...`` and ``fragment=...``."""
    stages = {"compute": GL.GL_COMPUTE_SHADER, "vertex": GL.GL_VERTEX_SHADER, "fragment": GL.GL_FRAGMENT_SHADER}
    program = GL.glCreateProgram()
    for stage, source in sources.items():
        shader = GL.glCreateShader(stages[stage])
        GL.glShaderSource(shader, source)
        GL.glCompileShader(shader)
        if not GL.glGetShaderiv(shader, GL.GL_COMPILE_STATUS):
            raise NoGraphics(f"the driver rejects a {stage} shader: {_text(GL.glGetShaderInfoLog(shader))}")
        GL.glAttachShader(program, shader)
        GL.glDeleteShader(shader)
    GL.glLinkProgram(program)
    if not GL.glGetProgramiv(program, GL.GL_LINK_STATUS):
        raise NoGraphics(f"the driver cannot link the shaders: {_text(GL.glGetProgramInfoLog(program))}")
    return int(program)


class StorageBuffer:
    """A shader storage buffer of a fixed size. Transfers go through mapping, which every 4.3 driver does well.

    size : bytes, or an array, which it then holds. usage : what it is for, a hint on which memory suits it.
    Raises NoGraphics when the driver has no room for it.
    """

    def __init__(self, size: int | np.ndarray, usage: int = GL.GL_DYNAMIC_COPY) -> None:
        data = size if isinstance(size, np.ndarray) else None
        self.nbytes = max(16, data.nbytes if data is not None else int(size))
        self.name = int(GL.glGenBuffers(1))
        GL.glBindBuffer(GL.GL_SHADER_STORAGE_BUFFER, self.name)
        try:
            GL.glBufferData(GL.GL_SHADER_STORAGE_BUFFER, self.nbytes, None, usage)
        except GL.GLError as error:
            raise NoGraphics(f"the driver has no room for {self.nbytes} bytes (OpenGL error {error.err})") from None
        if data is not None:
            self.write(data)

    def bind(self, binding: int) -> None:
        GL.glBindBufferBase(GL.GL_SHADER_STORAGE_BUFFER, binding, self.name)

    def bind_part(self, binding: int, offset: int, nbytes: int) -> None:
        """Bind bytes ``offset`` (a multiple of 256) to ``offset + nbytes`` only."""
        GL.glBindBufferRange(GL.GL_SHADER_STORAGE_BUFFER, binding, self.name, offset, nbytes)

    def write(self, data: np.ndarray) -> None:
        """Copy a contiguous array to the buffer's beginning."""
        data = np.ascontiguousarray(data)
        address = self._map(data.nbytes, GL.GL_MAP_WRITE_BIT | GL.GL_MAP_INVALIDATE_RANGE_BIT)
        ctypes.memmove(address, data.ctypes.data, data.nbytes)
        GL.glUnmapBuffer(GL.GL_SHADER_STORAGE_BUFFER)

    def read(self, dtype: npt.DTypeLike, count: int) -> np.ndarray:
        """The first ``count`` items, copied."""
        data: np.ndarray = np.empty(count, dtype)
        if count:
            address = self._map(data.nbytes, GL.GL_MAP_READ_BIT)
            ctypes.memmove(data.ctypes.data, address, data.nbytes)
            GL.glUnmapBuffer(GL.GL_SHADER_STORAGE_BUFFER)
        return data

    def _map(self, nbytes: int, access: int) -> int:
        if nbytes > self.nbytes:
            raise ValueError(f"{nbytes} bytes do not fit a buffer of {self.nbytes}")
        GL.glBindBuffer(GL.GL_SHADER_STORAGE_BUFFER, self.name)
        return GL.glMapBufferRange(GL.GL_SHADER_STORAGE_BUFFER, 0, nbytes, access)


def _text(log: bytes | str) -> str:
    return log.decode(errors="replace") if isinstance(log, bytes) else log
