"""Creates an OpenGL context without a display, through EGL, the same for Mesa and for NVIDIA.

The environment variable PYOPENGL_PLATFORM must say ``egl`` before anything imports OpenGL: this module sees to it.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "software rasterizer", "swiftshader")
REMEDY = (
    "Install the graphics driver's EGL part (Mesa: libegl-mesa0, libgl1-mesa-dri; NVIDIA: libnvidia-gl) and let this "
    "user open /dev/dri/renderD* (group render); in a container, pass the GPU with its graphics capability."
)

GL_VERSION = (4, 3)  # with it came compute shaders and storage buffers
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

    def __init__(self, hardware: bool | None = None) -> None:
        platform = os.environ.get("PYOPENGL_PLATFORM")
        if platform != "egl":
            raise NoGraphics(f"PYOPENGL_PLATFORM is '{platform}', not 'egl', which needs no display; unset it")
        try:
            from OpenGL import EGL
        except (ImportError, AttributeError, TypeError) as error:  # the others: how PyOpenGL says that it found no EGL
            remedy = "pip install PyOpenGL; Debian and Ubuntu: apt install libegl1"
            raise NoGraphics(f"libEGL.so.1 or PyOpenGL is not installed ({error}; {remedy})") from None
        self._EGL, self._lock, self._context = EGL, threading.Lock(), None
        reasons = []
        for description, find in self._displays(hardware):
            try:
                self._display = find()
                self._context = self._create()
                with self.current():
                    self.renderer = self._renderer()
                self.is_hardware = not any(name in self.renderer.lower() for name in SOFTWARE_RENDERERS)
                if hardware in (None, self.is_hardware):
                    return
                reasons.append(f"{description}: {self.renderer} is {'hardware' if self.is_hardware else 'software'}")
            except NoGraphics as error:
                reasons.append(f"{description}: {error}")
            except EGL.EGLError as error:
                reasons.append(f"{description}: has no OpenGL 4.3 without a surface ({error.err})")
            self.close()
        wanted = {True: "hardware ", False: "software ", None: ""}[hardware]
        raise NoGraphics(
            f"no {wanted}OpenGL 4.3 context ({'; '.join(reasons) or 'EGL knows no such device'}). {REMEDY}"
        )

    @contextmanager
    def current(self) -> Iterator[None]:
        """Make the context current on this thread for the duration; other threads wait. Raises NoGraphics if closed."""
        with self._lock:
            if self._context is None:
                raise NoGraphics("the OpenGL context is closed")
            self._make_current(self._context)
            try:
                yield
            finally:
                self._make_current(None)

    def close(self) -> None:
        """Destroy the context; it cannot be used afterwards. Closing twice is harmless."""
        with self._lock:
            if self._context is not None:
                self._destroy()
            self._context = None

    # --- EGL

    def _displays(self, hardware: bool | None) -> Iterator[tuple[str, Callable[[], Any]]]:
        """Yield what finds the displays: of hardware devices, software devices, the surfaceless platform, the default.

        None where there is only software, which would take memory to say so, and hardware is wanted.
        """
        from OpenGL.EGL.EXT import device_base, platform_base, platform_device

        EGL, get_display = self._EGL, platform_base.eglGetPlatformDisplayEXT
        devices, count = (EGL.EGLDeviceEXT * MAX_DEVICES)(), EGL.EGLint()
        query = device_base.eglQueryDevicesEXT
        known = list(devices[: count.value]) if query and query(MAX_DEVICES, devices, count) else []

        def is_software(device: Any) -> bool:
            return b"EGL_MESA_device_software" in (
                device_base.eglQueryDeviceStringEXT(device, EGL.EGL_EXTENSIONS) or b""
            )

        if hardware and known and all(map(is_software, known)):
            return
        if get_display:
            for number, device in enumerate(sorted(known, key=is_software)):
                of_device = platform_device.EGL_PLATFORM_DEVICE_EXT
                yield f"EGL device {number}", partial(get_display, of_device, device, None)
            yield "surfaceless EGL", partial(get_display, PLATFORM_SURFACELESS_MESA, None, None)
        yield "default EGL display", partial(EGL.eglGetDisplay, None)

    def _create(self) -> Any:
        EGL = self._EGL
        EGL.eglInitialize(self._display, None, None)
        EGL.eglBindAPI(EGL.EGL_OPENGL_API)
        version = (EGL.EGL_CONTEXT_MAJOR_VERSION, GL_VERSION[0], EGL.EGL_CONTEXT_MINOR_VERSION, GL_VERSION[1])
        profile = (EGL.EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL.EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL.EGL_NONE)
        return EGL.eglCreateContext(self._display, None, None, [*version, *profile])

    def _make_current(self, context: Any) -> None:
        self._EGL.eglBindAPI(self._EGL.EGL_OPENGL_API)  # OpenGL, not OpenGL ES; every thread has to say so itself
        self._EGL.eglMakeCurrent(self._display, None, None, context)

    def _destroy(self) -> None:
        self._EGL.eglDestroyContext(self._display, self._context)

    def _renderer(self) -> str:
        from OpenGL import GL

        return str(GL.glGetString(GL.GL_RENDERER).decode(errors="replace"))
