"""Creates an OpenGL context without a display, through EGL, the same for Mesa and for NVIDIA.

The environment variable PYOPENGL_PLATFORM must say ``egl`` before anything imports OpenGL: this module sees to it.
"""

from __future__ import annotations

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
PLATFORM_SURFACELESS_MESA = 0x31DD  # PyOpenGL lacks it


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
        self._display, self._context = display, None
        try:
            self._context = self._egl.create_context(display)
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
        self._egl.make_current(self._display, self._context)

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
            from OpenGL import EGL
            from OpenGL.EGL.EXT import device_base, platform_base, platform_device
        except (ImportError, AttributeError, TypeError) as error:  # the others: how PyOpenGL says that it found no EGL
            remedy = "pip install PyOpenGL; Debian and Ubuntu: apt install libegl1"
            raise NoGraphics(f"libEGL.so.1 or PyOpenGL is not installed ({error}; {remedy})") from None
        self._EGL, self._devices, self._platforms = EGL, device_base, platform_base
        self._of_device = platform_device.EGL_PLATFORM_DEVICE_EXT

    def displays(self) -> list[Display]:
        """List the displays to try, in this order: hardware devices, software devices, the surfaceless platform, the
        default."""
        devices = sorted(self._query_devices(), key=lambda device: device[0])
        found = [
            (self._platform_display(self._of_device, handle), f"EGL device {number}", software)
            for number, (software, handle) in enumerate(devices)
        ]
        only_software = bool(devices) and all(software for software, _ in devices)
        found.append((self._platform_display(PLATFORM_SURFACELESS_MESA, None), "surfaceless EGL", only_software))
        found.append((self._EGL.eglGetDisplay(None), "default EGL display", only_software))
        return [Display(handle, description, software) for handle, description, software in found if handle]

    def create_context(self, display: Display) -> Any:
        """Return a core context of the newest version to be had. Raises NoGraphics where there is none."""
        EGL, error = self._EGL, "no version"
        try:
            EGL.eglInitialize(display.handle, None, None)
            EGL.eglBindAPI(EGL.EGL_OPENGL_API)
        except EGL.EGLError as failure:
            raise NoGraphics(f"cannot be initialised ({_name(failure)})") from None
        for major, minor in GL_VERSIONS:
            version = [EGL.EGL_CONTEXT_MAJOR_VERSION, major, EGL.EGL_CONTEXT_MINOR_VERSION, minor]
            profile = [EGL.EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL.EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL.EGL_NONE]
            try:
                return EGL.eglCreateContext(display.handle, None, None, version + profile)
            except EGL.EGLError as failure:
                error = _name(failure)
        raise NoGraphics(f"has no OpenGL 4.3 ({error})")

    def make_current(self, display: Display, context: Any) -> None:
        """Make a context current on this thread, without a surface; None to release it. Raises NoGraphics."""
        try:
            self._EGL.eglBindAPI(self._EGL.EGL_OPENGL_API)  # OpenGL, not OpenGL ES; every thread has to say so itself
            self._EGL.eglMakeCurrent(display.handle, None, None, context)
        except self._EGL.EGLError as error:
            raise NoGraphics(f"its context cannot be made current ({_name(error)})") from None

    def destroy(self, display: Display, context: Any) -> None:
        self._EGL.eglDestroyContext(display.handle, context)

    def _query_devices(self) -> Iterator[tuple[bool, Any]]:
        """List every device: whether it is a software renderer, and its handle."""
        EGL, devices = self._EGL, self._devices
        handles, count = (EGL.EGLDeviceEXT * MAX_DEVICES)(), EGL.EGLint()
        if not (devices.eglQueryDevicesEXT and devices.eglQueryDevicesEXT(MAX_DEVICES, handles, count)):
            return
        for handle in handles[: count.value]:
            extensions = devices.eglQueryDeviceStringEXT(handle, EGL.EGL_EXTENSIONS)
            yield b"EGL_MESA_device_software" in (extensions or b""), handle

    def _platform_display(self, platform: int, native: Any) -> Any:
        get_display = self._platforms.eglGetPlatformDisplayEXT
        return get_display(platform, native, None) if get_display else None


def _name(error: Any) -> str:
    """Return the name of an EGLError."""
    return str(error.err)
