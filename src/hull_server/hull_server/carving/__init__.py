"""Silhouettes to occupied voxels: on the CPU, in OpenGL compute shaders, or by the thesis's plane sweep."""

from __future__ import annotations

from capture_rig import InputError

from ..grid import VoxelGrid
from ..opengl.egl import NoGraphics
from ..views import CarveBackend, RigViews
from .cpu_carver import CpuCarver


def make_backend(kind: str, views: RigViews, grid: VoxelGrid) -> tuple[CarveBackend, str]:
    """Make backend ``kind``; also return the reason for it, a sentence for the log.

    "auto" is OpenGL compute where hardware offers it, and the CPU otherwise: software OpenGL is several times slower
    than the CPU backend. Raises InputError for "gl" or "sweep" without an OpenGL 4.3 context.
    """
    if kind == "cpu":
        return CpuCarver(views, grid), "the CPU backend was asked for"
    try:
        backend = _make_gl(kind, views, grid)
    except (NoGraphics, InputError) as error:
        if kind == "auto":
            return CpuCarver(views, grid), f"the CPU backend, because of OpenGL: {error}"
        raise InputError(
            f"backend = '{kind}' cannot be used: {error}",
            remedy="Choose backend 'cpu', which needs no OpenGL, or 'auto'.",
        ) from None
    return backend, f"OpenGL on {backend.device}"


def _make_gl(kind: str, views: RigViews, grid: VoxelGrid) -> CarveBackend:
    try:
        from ..opengl.gl_carver import GlCarver
        from ..thesis_plane_sweep import PlaneSweepCarver
    except ImportError as error:
        raise NoGraphics(f"PyOpenGL cannot be imported ({error}); pip install PyOpenGL") from None
    except (AttributeError, TypeError) as error:  # PyOpenGL's exceptions without an OpenGL library
        raise NoGraphics(f"PyOpenGL finds no libOpenGL.so.0 ({error}); apt install libopengl0") from None
    if kind == "sweep":
        return PlaneSweepCarver(views, grid)
    return GlCarver(views, grid, hardware=True if kind == "auto" else None)
