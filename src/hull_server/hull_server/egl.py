"""An OpenGL context without a display, through EGL: the device platform first, the surfaceless platform otherwise.

Plain ctypes on libEGL; PyOpenGL is used for OpenGL itself only. The steps are the same with Mesa and with NVIDIA's
driver. Environment variable PYOPENGL_PLATFORM must say ``egl`` before anything imports OpenGL: this module sees to it.
"""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

GL_VERSIONS = ((4, 5), (4, 3))  # compute shaders and storage buffers came with 4.3
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "software rasterizer")
MAX_DEVICES = 32

_EGL_EXTENSIONS, _EGL_OPENGL_API = 0x3055, 0x30A2
_EGL_PLATFORM_DEVICE, _EGL_PLATFORM_SURFACELESS = 0x313F, 0x31DD
_EGL_NONE, _EGL_MAJOR, _EGL_MINOR, _EGL_PROFILE_MASK, _EGL_CORE_PROFILE = 0x3038, 0x3098, 0x30FB, 0x30FD, 1
_pointer, _int, _uint = ctypes.c_void_p, ctypes.c_int32, ctypes.c_uint


class NoGraphics(RuntimeError):
    """No OpenGL 4.3 context of the wanted kind can be had on this machine; the text says why."""


@dataclass(frozen=True)
class _Display:
    handle: int
    description: str
    software: bool = False


class GlContext:
    """A headless OpenGL context. It may be used by any thread, but by one at a time: enter :meth:`current` to use it.

    hardware : True for hardware only, False for software only, None for whatever there is, hardware first.
    Raises NoGraphics when there is none.
    """

    def __init__(self, hardware: bool | None = None) -> None:
        self._egl = _load_egl()
        self._lock = threading.RLock()
        self._depth = 0
        reasons = []
        for display in _displays(self._egl):
            reason = self._try(display, hardware)
            if reason is None:
                return
            reasons.append(f"{display.description}: {reason}")
        wanted = {True: "hardware ", False: "software ", None: ""}[hardware]
        raise NoGraphics(f"no {wanted}OpenGL 4.3 context ({'; '.join(reasons) or 'EGL knows no device'})")

    def _try(self, display: _Display, hardware: bool | None) -> str | None:
        """Take the display if it gives a context of the wanted kind; otherwise say why not."""
        egl = self._egl
        if display.software and hardware:
            return "is a software renderer"
        if not egl.eglInitialize(display.handle, None, None) or not egl.eglBindAPI(_EGL_OPENGL_API):
            return f"cannot be initialised (EGL error 0x{egl.eglGetError():x})"
        context = next(filter(None, (_create_context(egl, display.handle, v) for v in GL_VERSIONS)), None)
        if context is None:
            return "has no OpenGL 4.3"
        self._display = display.handle
        self._context: int | None = context
        try:
            with self.current():
                self.renderer = _renderer()
        except NoGraphics as error:
            return str(error)
        self.is_hardware = not any(name in self.renderer.lower() for name in SOFTWARE_RENDERERS)
        if hardware is not None and self.is_hardware != hardware:
            egl.eglDestroyContext(display.handle, context)
            return f"{self.renderer} is {'hardware' if self.is_hardware else 'software'}"
        return None

    @contextmanager
    def current(self) -> Iterator[None]:
        """Make the context current on this thread for the duration; other threads wait."""
        with self._lock:
            if self._depth == 0 and not self._egl.eglMakeCurrent(self._display, None, None, self._context):
                raise NoGraphics(f"the context cannot be made current (EGL error 0x{self._egl.eglGetError():x})")
            self._depth += 1
            try:
                yield
            finally:
                self._depth -= 1
                if self._depth == 0:
                    self._egl.eglMakeCurrent(self._display, None, None, None)

    def close(self) -> None:
        """Destroy the context; it cannot be used afterwards. Closing twice is harmless."""
        with self._lock:
            if self._context:
                self._egl.eglDestroyContext(self._display, self._context)
                self._context = None


def _load_egl() -> ctypes.CDLL:
    try:
        egl = ctypes.CDLL("libEGL.so.1", mode=ctypes.RTLD_GLOBAL)
    except OSError:
        raise NoGraphics("libEGL.so.1 is not installed (Debian and Ubuntu: apt install libegl1)") from None
    signatures: tuple[tuple[str, Any, list], ...] = (
        ("eglGetProcAddress", _pointer, [ctypes.c_char_p]),
        ("eglInitialize", _uint, [_pointer, _pointer, _pointer]),
        ("eglBindAPI", _uint, [_uint]),
        ("eglCreateContext", _pointer, [_pointer, _pointer, _pointer, ctypes.POINTER(_int)]),
        ("eglMakeCurrent", _uint, [_pointer, _pointer, _pointer, _pointer]),
        ("eglDestroyContext", _uint, [_pointer, _pointer]),
        ("eglGetError", _int, []),
    )
    for name, result, arguments in signatures:
        function = getattr(egl, name)
        function.restype, function.argtypes = result, arguments
    return egl


def _extension(egl: ctypes.CDLL, name: str, result: type, *arguments: type):  # type: ignore[no-untyped-def]
    address = egl.eglGetProcAddress(name.encode())
    return ctypes.CFUNCTYPE(result, *arguments)(address) if address else None


def _displays(egl: ctypes.CDLL) -> list[_Display]:
    """One display a device, software devices last, then the surfaceless platform."""
    get_display = _extension(egl, "eglGetPlatformDisplayEXT", _pointer, _uint, _pointer, _pointer)
    query = _extension(egl, "eglQueryDevicesEXT", _uint, _int, _pointer, _pointer)
    describe = _extension(egl, "eglQueryDeviceStringEXT", ctypes.c_char_p, _pointer, _int)
    if get_display is None:
        raise NoGraphics("this EGL has no platform displays (EGL_EXT_platform_base)")
    devices: list[tuple[bool, int]] = []
    if query is not None and describe is not None:
        handles, count = (_pointer * MAX_DEVICES)(), _int()
        if query(MAX_DEVICES, handles, ctypes.byref(count)):
            for handle in filter(None, handles[: count.value]):
                software = b"EGL_MESA_device_software" in (describe(handle, _EGL_EXTENSIONS) or b"")
                devices.append((software, handle))
    devices.sort(key=lambda device: device[0])
    found = [
        _Display(get_display(_EGL_PLATFORM_DEVICE, handle, None), f"EGL device {number}", software)
        for number, (software, handle) in enumerate(devices)
    ]
    only_software = bool(devices) and all(software for software, _ in devices)
    found.append(_Display(get_display(_EGL_PLATFORM_SURFACELESS, None, None), "surfaceless EGL", only_software))
    return [display for display in found if display.handle]


def _create_context(egl: ctypes.CDLL, display: int, version: tuple[int, int]) -> int | None:
    attributes = (_EGL_MAJOR, version[0], _EGL_MINOR, version[1], _EGL_PROFILE_MASK, _EGL_CORE_PROFILE, _EGL_NONE)
    return egl.eglCreateContext(display, None, None, (_int * len(attributes))(*attributes))


def _renderer() -> str:
    try:
        from OpenGL import GL
    except ImportError as error:
        raise NoGraphics(f"PyOpenGL cannot be imported ({error}); pip install PyOpenGL") from None
    return GL.glGetString(GL.GL_RENDERER).decode(errors="replace")
