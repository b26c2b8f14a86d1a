"""An OpenGL context without a display, through EGL. PyOpenGL is used for OpenGL itself only.

The environment variable PYOPENGL_PLATFORM must say ``egl`` before anything imports OpenGL: this module sees to it.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from .egl_library import Display, Egl, NoGraphics

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

__all__ = ["GlContext", "NoGraphics"]

SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "software rasterizer", "swiftshader")
REMEDY = (
    "Install the graphics driver's EGL part (Mesa: libegl-mesa0, libgl1-mesa-dri; NVIDIA: libnvidia-gl) and let this "
    "user open /dev/dri/renderD* (group render); in a container, pass the GPU with its graphics capability."
)


class GlContext:
    """A headless OpenGL context. It may be used by any thread, but by one at a time: enter :meth:`current` to use it.

    Tried in this order, until one gives a context of the wanted kind: every EGL device, hardware before software; the
    surfaceless platform; the default display. On each, a context that needs no surface is tried before one that is
    given a small off-screen surface.

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
        self._display = display
        problem = self._open(None)
        config = self._egl.pbuffer_config(display) if problem else None
        if config is not None:
            problem = self._open(config)
        if problem is None and hardware is not None and self.is_hardware != hardware:
            problem = f"{self.renderer} is {'hardware' if self.is_hardware else 'software'}"
            self.close()
        return problem

    def _open(self, config: int | None) -> str | None:
        """Make the context, without a surface when there is no ``config``; otherwise say why that cannot be done."""
        self._surface = None if config is None else self._egl.create_pbuffer(self._display, config)
        self._context = self._egl.create_context(self._display, config)
        try:
            if self._context is None:
                raise NoGraphics(f"has no OpenGL 4.3 ({self._egl.error()})")
            with self.current():
                self.renderer = renderer_name()
        except NoGraphics as error:
            self.close()
            return str(error)
        self.is_hardware = not any(name in self.renderer.lower() for name in SOFTWARE_RENDERERS)
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
                    self._egl.make_current(self._display, None, None)

    def _take(self) -> None:
        if self._context is None:
            raise NoGraphics("the OpenGL context is closed")
        self._egl.choose_opengl()
        if not self._egl.make_current(self._display, self._surface, self._context):
            raise NoGraphics(f"its context cannot be made current ({self._egl.error()})")

    def close(self) -> None:
        """Destroy the context; it cannot be used afterwards. Closing twice is harmless."""
        with self._lock:
            self._egl.destroy(self._display, self._surface, self._context)
            self._surface = self._context = None


def renderer_name() -> str:
    """What the current context draws with."""
    try:
        from OpenGL import GL
    except ImportError as error:
        raise NoGraphics(f"PyOpenGL cannot be imported ({error}); pip install PyOpenGL") from None
    return GL.glGetString(GL.GL_RENDERER).decode(errors="replace")
