"""Creates an OpenGL context without a display, through EGL by plain ctypes, the same for Mesa and for NVIDIA.

PyOpenGL is used for OpenGL itself only. The environment variable PYOPENGL_PLATFORM must say ``egl`` before anything
imports OpenGL: this module sees to it.
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

SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "software rasterizer", "swiftshader")
REMEDY = (
    "Install the graphics driver's EGL part (Mesa: libegl-mesa0, libgl1-mesa-dri; NVIDIA: libnvidia-gl) and let this "
    "user open /dev/dri/renderD* (group render); in a container, pass the GPU with its graphics capability."
)

GL_VERSIONS = ((4, 5), (4, 3))  # compute shaders and storage buffers came with 4.3
MAX_DEVICES = 32

_EXTENSIONS, _OPENGL_API, _NONE = 0x3055, 0x30A2, 0x3038
_PLATFORM_DEVICE, _PLATFORM_SURFACELESS = 0x313F, 0x31DD
_MAJOR, _MINOR, _PROFILE_MASK, _CORE_PROFILE = 0x3098, 0x30FB, 0x30FD, 1
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
    ("eglCreateContext", _pointer, [_pointer, _pointer, _pointer, _pointer]),
    ("eglMakeCurrent", _uint, [_pointer, _pointer, _pointer, _pointer]),
    ("eglDestroyContext", _uint, [_pointer, _pointer]),
    ("eglGetError", _int, []),
)


class NoGraphics(RuntimeError):
    """No OpenGL 4.3 context of the wanted kind can be had on this machine; the text has the reason."""


class GlContext:
    """A headless OpenGL context. It may be used by any thread, but by one at a time: enter :meth:`current` to use it.

    Tried in this order, until one gives a context of the wanted kind: every EGL device, hardware before software; the
    surfaceless platform; the default display. The context has no surface (EGL_KHR_surfaceless_context).

    hardware : True for hardware only, False for software only, None for whatever there is, hardware first.
    renderer, is_hardware : what was found.
    Raises NoGraphics, with all that was tried and the remedy, when there is none.
    """

    renderer: str
    is_hardware: bool

    def __init__(self, hardware: bool | None = None) -> None:
        platform = os.environ.get("PYOPENGL_PLATFORM")
        if platform != "egl":
            raise NoGraphics(f"PYOPENGL_PLATFORM is '{platform}', not 'egl', which needs no display; unset it")
        self._egl = Egl()
        self._lock = threading.RLock()
        self._depth = 0
        reasons = []
        for display in self._egl.displays():
            reason = self._try(display, hardware)
            if reason is None:
                return
            reasons.append(f"{display.description}: {reason}")
        wanted = {True: "hardware ", False: "software ", None: ""}[hardware]
        raise NoGraphics(f"no {wanted}OpenGL 4.3 context ({'; '.join(reasons) or 'EGL knows no device'}). {REMEDY}")

    def _try(self, display: Display, hardware: bool | None) -> str | None:
        """Take the display if it gives a context of the wanted kind; otherwise say why not."""
        if display.software and hardware:
            return "is a software renderer"
        if not self._egl.initialize(display):
            return f"cannot be initialised ({self._egl.error()})"
        self._display, self._context = display, self._egl.create_context(display)
        try:
            if self._context is None:
                raise NoGraphics(f"has no OpenGL 4.3 ({self._egl.error()})")
            with self.current():
                self.renderer = renderer_name()
            self.is_hardware = not any(name in self.renderer.lower() for name in SOFTWARE_RENDERERS)
            if hardware is not None and self.is_hardware != hardware:
                raise NoGraphics(f"{self.renderer} is {'hardware' if self.is_hardware else 'software'}")
        except NoGraphics as error:
            self.close()
            return str(error)
        return None

    @contextmanager
    def current(self) -> Iterator[None]:
        """Make the context current on this thread for the duration; other threads wait. May be nested."""
        with self._lock:
            if self._depth == 0:
                self._take()
            self._depth += 1
            try:
                yield
            finally:
                self._depth -= 1
                if self._depth == 0:
                    self._egl.make_current(self._display, None)

    def _take(self) -> None:
        if self._context is None:
            raise NoGraphics("the OpenGL context is closed")
        self._egl.choose_opengl()
        if not self._egl.make_current(self._display, self._context):
            raise NoGraphics(f"its context cannot be made current ({self._egl.error()})")

    def close(self) -> None:
        """Destroy the context; it cannot be used afterwards. Closing twice is harmless."""
        with self._lock:
            if self._context is not None:
                self._egl.destroy(self._display, self._context)
            self._context = None


def renderer_name() -> str:
    """Return the name of the renderer of the current context."""
    try:
        from OpenGL import GL
    except ImportError as error:
        raise NoGraphics(f"PyOpenGL cannot be imported ({error}); pip install PyOpenGL") from None
    return GL.glGetString(GL.GL_RENDERER).decode(errors="replace")


@dataclass(frozen=True)
class Display:
    """Something that may offer OpenGL; ``software`` where that is known to be all it offers."""

    handle: int
    description: str
    software: bool = False


class Egl:
    """The EGL library. Raises NoGraphics when it is not installed."""

    def __init__(self) -> None:
        try:
            self._library = ctypes.CDLL("libEGL.so.1", mode=ctypes.RTLD_GLOBAL)
        except OSError:
            raise NoGraphics("libEGL.so.1 is not installed (Debian and Ubuntu: apt install libegl1)") from None
        for name, result, arguments in _SIGNATURES:
            function = getattr(self._library, name)
            function.restype, function.argtypes = result, arguments

    def displays(self) -> list[Display]:
        """List the displays to try, in this order: hardware devices, software devices, the surfaceless platform, the
        default."""
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

    def create_context(self, display: Display) -> int | None:
        """Return a core context of the newest version to be had."""
        for major, minor in GL_VERSIONS:
            pairs = (_MAJOR, major, _MINOR, minor, _PROFILE_MASK, _CORE_PROFILE, _NONE)
            attributes = (_int * len(pairs))(*pairs)
            context = self._library.eglCreateContext(display.handle, None, None, attributes)
            if context:
                return context
        return None

    def make_current(self, display: Display, context: int | None) -> bool:
        """Make a context current on this thread, without a surface; None to release it."""
        return bool(self._library.eglMakeCurrent(display.handle, None, None, context))

    def destroy(self, display: Display, context: int) -> None:
        self._library.eglDestroyContext(display.handle, context)

    def error(self) -> str:
        """Return the name of this thread's last error."""
        code = self._library.eglGetError()
        return _ERRORS.get(code, f"EGL error 0x{code:x}")

    def _devices(self) -> Iterator[tuple[bool, int]]:
        """List every device: whether it is a software renderer, and its handle."""
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
