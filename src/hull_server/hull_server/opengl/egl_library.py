"""libEGL through plain ctypes: the calls that a context without a window needs, the same for Mesa and for NVIDIA."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

GL_VERSIONS = ((4, 5), (4, 3))  # compute shaders and storage buffers came with 4.3
MAX_DEVICES = 32
PBUFFER_PX = 16

_EXTENSIONS, _OPENGL_API, _NONE = 0x3055, 0x30A2, 0x3038
_PLATFORM_DEVICE, _PLATFORM_SURFACELESS = 0x313F, 0x31DD
_MAJOR, _MINOR, _PROFILE_MASK, _CORE_PROFILE = 0x3098, 0x30FB, 0x30FD, 1
_SURFACE_TYPE, _PBUFFER_BIT, _RENDERABLE_TYPE, _OPENGL_BIT = 0x3033, 1, 0x3040, 8
_WIDTH, _HEIGHT = 0x3057, 0x3056
_ERRORS = {
    0x3001: "EGL_NOT_INITIALIZED",
    0x3002: "EGL_BAD_ACCESS",
    0x3003: "EGL_BAD_ALLOC",
    0x3004: "EGL_BAD_ATTRIBUTE",
    0x3005: "EGL_BAD_CONFIG",
    0x3006: "EGL_BAD_CONTEXT",
    0x3008: "EGL_BAD_DISPLAY",
    0x3009: "EGL_BAD_MATCH",
    0x300C: "EGL_BAD_PARAMETER",
    0x300E: "EGL_CONTEXT_LOST",
}
_pointer, _int, _uint, _text = ctypes.c_void_p, ctypes.c_int32, ctypes.c_uint, ctypes.c_char_p
_SIGNATURES: tuple[tuple[str, Any, list], ...] = (
    ("eglGetProcAddress", _pointer, [_text]),
    ("eglGetDisplay", _pointer, [_pointer]),
    ("eglInitialize", _uint, [_pointer, _pointer, _pointer]),
    ("eglBindAPI", _uint, [_uint]),
    ("eglChooseConfig", _uint, [_pointer, _pointer, _pointer, _int, _pointer]),
    ("eglCreatePbufferSurface", _pointer, [_pointer, _pointer, _pointer]),
    ("eglDestroySurface", _uint, [_pointer, _pointer]),
    ("eglCreateContext", _pointer, [_pointer, _pointer, _pointer, _pointer]),
    ("eglMakeCurrent", _uint, [_pointer, _pointer, _pointer, _pointer]),
    ("eglDestroyContext", _uint, [_pointer, _pointer]),
    ("eglGetError", _int, []),
)


class NoGraphics(RuntimeError):
    """No OpenGL 4.3 context of the wanted kind can be had on this machine; the text says why."""


@dataclass(frozen=True)
class Display:
    """Something that may offer OpenGL; ``software`` where that is known to be all it offers."""

    handle: int
    description: str
    software: bool = False


class Egl:
    """The library. Raises NoGraphics when it is not installed."""

    def __init__(self) -> None:
        try:
            self._library = ctypes.CDLL("libEGL.so.1", mode=ctypes.RTLD_GLOBAL)
        except OSError:
            raise NoGraphics("libEGL.so.1 is not installed (Debian and Ubuntu: apt install libegl1)") from None
        for name, result, arguments in _SIGNATURES:
            function = getattr(self._library, name)
            function.restype, function.argtypes = result, arguments

    def displays(self) -> list[Display]:
        """What to try, in this order: hardware devices, software devices, the surfaceless platform, the default."""
        devices = sorted(self._devices(), key=lambda device: device[0])
        found = [
            (self._platform_display(_PLATFORM_DEVICE, handle), f"EGL device {number}", software)
            for number, (software, handle) in enumerate(devices)
        ]
        only_software = bool(devices) and all(software for software, _ in devices)
        found.append((self._platform_display(_PLATFORM_SURFACELESS, None), "surfaceless EGL", only_software))
        found.append((self._library.eglGetDisplay(None), "default EGL display", only_software))
        return [Display(handle, description, software) for handle, description, software in found if handle]

    def initialize(self, display: Display) -> bool:
        return bool(self._library.eglInitialize(display.handle, None, None)) and self.choose_opengl()

    def choose_opengl(self) -> bool:
        """Make this thread's EGL calls mean OpenGL, not OpenGL ES; every thread has to say so itself."""
        return bool(self._library.eglBindAPI(_OPENGL_API))

    def pbuffer_config(self, display: Display) -> int | None:
        """A configuration that has OpenGL and small off-screen surfaces."""
        config, count = _pointer(), _int()
        wanted = _attributes(_SURFACE_TYPE, _PBUFFER_BIT, _RENDERABLE_TYPE, _OPENGL_BIT)
        self._library.eglChooseConfig(display.handle, wanted, ctypes.byref(config), 1, ctypes.byref(count))
        return config.value if count.value else None

    def create_pbuffer(self, display: Display, config: int) -> int | None:
        size = _attributes(_WIDTH, PBUFFER_PX, _HEIGHT, PBUFFER_PX)
        return self._library.eglCreatePbufferSurface(display.handle, config, size)

    def create_context(self, display: Display, config: int | None) -> int | None:
        """A core context of the newest version to be had."""
        for major, minor in GL_VERSIONS:
            attributes = _attributes(_MAJOR, major, _MINOR, minor, _PROFILE_MASK, _CORE_PROFILE)
            context = self._library.eglCreateContext(display.handle, config, None, attributes)
            if context:
                return context
        return None

    def make_current(self, display: Display, surface: int | None, context: int | None) -> bool:
        """On this thread; surface and context None to release."""
        return bool(self._library.eglMakeCurrent(display.handle, surface, surface, context))

    def destroy(self, display: Display, surface: int | None, context: int | None) -> None:
        if context:
            self._library.eglDestroyContext(display.handle, context)
        if surface:
            self._library.eglDestroySurface(display.handle, surface)

    def error(self) -> str:
        """The name of this thread's last error."""
        code = self._library.eglGetError()
        return _ERRORS.get(code, f"EGL error 0x{code:x}")

    def _devices(self) -> Iterator[tuple[bool, int]]:
        """Every device: whether it is a software renderer, and its handle."""
        query = self._extension("eglQueryDevicesEXT", _uint, _int, _pointer, _pointer)
        describe = self._extension("eglQueryDeviceStringEXT", _text, _pointer, _int)
        handles, count = (_pointer * MAX_DEVICES)(), _int()
        if query is None or describe is None or not query(MAX_DEVICES, handles, ctypes.byref(count)):
            return
        for handle in filter(None, handles[: count.value]):
            yield b"EGL_MESA_device_software" in (describe(handle, _EXTENSIONS) or b""), handle

    def _platform_display(self, platform: int, native: int | None) -> int | None:
        get_display = self._extension("eglGetPlatformDisplayEXT", _pointer, _uint, _pointer, _pointer)
        return None if get_display is None else get_display(platform, native, None)

    def _extension(self, name: str, result: Any, *arguments: Any) -> Any:
        address = self._library.eglGetProcAddress(name.encode())
        return ctypes.CFUNCTYPE(result, *arguments)(address) if address else None


def _attributes(*pairs: int) -> ctypes.Array:
    return (_int * (len(pairs) + 1))(*pairs, _NONE)
