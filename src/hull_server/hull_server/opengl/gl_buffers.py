"""OpenGL programs and buffers: storage buffers, and the upload of a frame set.

The upload is laid out on the host as the shaders read it, so that a frame set is one transfer.
"""

from __future__ import annotations

import ctypes

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import InputError
from capture_rig.mask_levels import SHADOW_CANDIDATE

from ..views import Masks, RigViews
from .egl import NoGraphics  # imported first: it tells PyOpenGL to use EGL

from OpenGL import GL  # isort: skip

MAX_GL_CAMERAS = 32  # cameras of a frame set are the bits of one shader word
LISTS = 4  # lists that the kernels hand on: coarse blocks, bricks, blocks, half blocks to recheck
FRAME_OFFSET = 256  # bytes: the largest alignment that a driver may ask of a bound range
PIXELS_PER_WORD = 16
_HEAD, _BOX = 4, 4  # words: of the frame's head, of a camera's foreground box


def check_cameras(count: int) -> None:
    """Raise InputError for more cameras than the shaders hold."""
    if count > MAX_GL_CAMERAS:
        what = f"{count} cameras are too many for OpenGL"
        raise InputError(what, where="backend", remedy=f"Use at most {MAX_GL_CAMERAS}, or choose backend 'cpu'.")


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

    def write(self, data: np.ndarray) -> None:
        """Copy a contiguous array to the buffer's beginning."""
        data = np.ascontiguousarray(data)
        address = self._map(data.nbytes, GL.GL_MAP_WRITE_BIT | GL.GL_MAP_INVALIDATE_RANGE_BIT)
        ctypes.memmove(address, data.ctypes.data, data.nbytes)
        GL.glUnmapBuffer(GL.GL_SHADER_STORAGE_BUFFER)

    def read(self, dtype: npt.DTypeLike, count: int) -> np.ndarray:
        """Copy the first ``count`` items."""
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


class FrameUpload:
    """The words of a frame set: the empty lists; from FRAME_OFFSET on head, boxes, labels and summed areas.

    words : int32, all of them at their largest. labels_start : word at which the labels begin.
    Only rows that hold foreground, now or in the frame set before, are written. Not for two threads at a time.
    """

    def __init__(self, views: RigViews) -> None:
        cameras, height, width = views.seen.shape
        self._names, self._countable = views.names, np.minimum(views.seen, 1)
        columns = width // PIXELS_PER_WORD
        boxes = FRAME_OFFSET // 4 + _HEAD
        starts = boxes + _BOX * cameras
        self.labels_start = starts + cameras
        self._areas_start = self.labels_start + cameras * height * columns
        self.words: npt.NDArray[np.int32] = np.zeros(self._areas_start + cameras * (height + 1) * (width + 1), np.int32)
        self.words[: 4 * LISTS] = [0, 1, 1, 0] * LISTS  # groups x, y, z of a dispatch; length
        self._head = self.words[FRAME_OFFSET // 4 : boxes]
        self._boxes = self.words[boxes:starts].reshape(cameras, _BOX)
        self._area_starts = self.words[starts : self.labels_start]
        labels = self.words[self.labels_start : self._areas_start]
        self._labels = labels.view(np.uint32).reshape(cameras, height, columns)
        self._blind = np.packbits(views.seen == 0, axis=-1, bitorder="little").view("<u2").astype(np.uint32) << 16
        self._labels[:] = self._blind
        self._rows = np.zeros((cameras, 2), np.int64)  # from and to, of each camera's foreground

    def fill(self, masks: Masks, present: npt.NDArray[np.int64], min_seeing: int) -> npt.NDArray[np.int32]:
        """Fill in the masks of the ``present`` cameras; return the words to upload, valid until the next call."""
        self._head.view(np.uint32)[:2] = sum(1 << int(camera) for camera in present), min_seeing
        end = self._areas_start
        for camera in present:
            end = self._fill_camera(camera, masks[self._names[camera]], end)
        return self.words[:end]

    def _fill_camera(self, camera: int, mask: npt.NDArray[np.uint8], start: int) -> int:
        """Fill in labels, foreground box and summed areas, these from word ``start``; return where they end."""
        labels, (first, last) = self._labels[camera], self._rows[camera]
        labels[first:last] = self._blind[camera, first:last]
        left, v0, width, height = cv2.boundingRect(mask)
        u0, u1 = (edge // PIXELS_PER_WORD * PIXELS_PER_WORD for edge in (left, left + width + PIXELS_PER_WORD - 1))
        v1 = v0 + height
        self._rows[camera] = v0, v1
        self._boxes[camera] = u0, v0, u1, v1
        self._area_starts[camera] = start
        if width == 0:
            return start
        part, seen = np.zeros((height, u1 - u0), np.uint8), self._countable[camera, v0:v1, u0:u1] > 0
        part[:, : mask.shape[1] - u0] = mask[v0:v1, u0:u1]  # a canvas need not end with a word
        sure, uncertain = _packed((part > SHADOW_CANDIDATE) & seen), _packed((part > 0) & (part <= SHADOW_CANDIDATE))
        labels[v0:v1, u0 // PIXELS_PER_WORD : u1 // PIXELS_PER_WORD] |= sure | uncertain << 16
        counts = np.minimum(part, 1) + (part >> 7)  # two a foreground pixel, one an uncertain one
        counts = cv2.multiply(counts, self._countable[camera, v0:v1, u0:u1])
        end = start + (v1 - v0 + 1) * (u1 - u0 + 1)
        cv2.integral(counts, self.words[start:end].reshape(v1 - v0 + 1, u1 - u0 + 1), cv2.CV_32S)
        return end


def _packed(flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint32]:
    """Pack flags (h, 16 n) into the low halves of words (h, n): bit p of a word is pixel p."""
    return np.packbits(flags, axis=1, bitorder="little").view("<u2").astype(np.uint32)


def _text(log: bytes | str) -> str:
    return log.decode(errors="replace") if isinstance(log, bytes) else log
