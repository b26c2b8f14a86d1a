"""Carves as the thesis does (3.1.3, 3.1.4): a plane sweep of one textured quad per slice, then read-back. The baseline.

Every silhouette is a texture, projected onto the plane of the slice; the product of all of them is the slice. The
quad is drawn so that one pixel of the frame buffer is one voxel, and glReadPixels reads it back. Unlike in the thesis,
the factor of a camera that does not see the voxel is one, and a second channel counts the cameras that see it, so that
the image border does not cut the body. It tests every voxel, so it is slow, and simple enough to trust: the other
backends are compared with it.
"""

from __future__ import annotations

import ctypes

import numpy as np

from capture_rig.mask_levels import SHADOW_CANDIDATE

from .carving.pixel_boxes import pixel_projections
from .grid import BrickVolume, VoxelGrid
from .opengl.carve_shaders import PROJECT_EXACTLY
from .opengl.egl import GlContext, NoGraphics
from .opengl.gl_buffers import GL, StorageBuffer, check_cameras, make_program
from .views import Boxes, Masks, RigViews

# axis swept: (axis along the frame buffer's columns, along its rows)
SLICE_AXES = {0: (1, 2), 1: (0, 2), 2: (0, 1)}

VERTEX = """#version 430
uniform vec2 size;         // voxels of a slice
uniform float slice;
uniform ivec3 axes;        // which grid axis is column, row, slice
out vec3 voxel;
void main() {              // a quad that covers the slice, half a voxel beyond the outermost centres
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    vec3 at = vec3(0.0);
    at[axes.x] = corner.x * size.x - 0.5;
    at[axes.y] = corner.y * size.y - 0.5;
    at[axes.z] = slice;
    voxel = at;
    gl_Position = vec4(2.0 * corner - 1.0, 0.0, 1.0);
}
"""

FRAGMENT = """
uniform sampler2DArray silhouettes;                  // r: foreground, g: seen
uniform uint present;
uniform int min_seeing;
in vec3 voxel;
out float slice_value;
void main() {
    ivec3 at = ivec3(round(voxel));                  // the interpolated coordinates, rid of their rounding
    float product = 1.0;
    int seeing = 0;
    for (int camera = 0; camera < CAMERAS && product > 0.0; camera++) {
        ivec2 pixel;                                 // projective texture coordinates of this voxel
        if ((present >> camera & 1u) == 0u || !project_exactly(camera, at, pixel)) continue;
        vec2 texel = texelFetch(silhouettes, ivec3(pixel, camera), 0).rg;
        product *= texel.g > 0.5 ? texel.r : 1.0;    // MODULATE, where the camera sees
        seeing += texel.g > 0.5 ? 1 : 0;
    }
    slice_value = seeing >= min_seeing ? product : 0.0;
}
"""


class PlaneSweepCarver:
    """Carves by sweeping a plane along z. Any thread may call :meth:`carve`, one at a time.

    Raises NoGraphics when there is no OpenGL 4.3 context, InputError for more than 32 cameras.
    """

    name = "sweep"

    def __init__(self, views: RigViews, grid: VoxelGrid, hardware: bool | None = None) -> None:
        check_cameras(len(views.names))
        self.views, self.grid = views, grid
        self._context = GlContext(hardware)
        self.device = self._context.renderer
        try:
            with self._context.current():
                self._program = make_program(vertex=VERTEX, fragment=self._fragment_source())
                self._make_textures()
                self._make_target()
                self._set_calibration()
        except NoGraphics:
            self.close()
            raise

    def carve(self, masks: Masks, min_seeing: int, boxes: Boxes | None = None) -> BrickVolume:
        """Carve as :meth:`hull_server.carving.cpu_carver.CpuCarver.carve`."""
        slices = self.sweep(masks, min_seeing, axis=2)
        return BrickVolume.from_dense(self.grid, slices.transpose(2, 1, 0) > 0)

    def sweep(self, masks: Masks, min_seeing: int, axis: int) -> np.ndarray:
        """Sweep along an axis (0 = x, 1 = y, 2 = z): slices (slices, rows, columns) uint8, nonzero = occupied."""
        present = self.views.present(masks)
        columns, rows = SLICE_AXES[axis]
        width, height, count = (self.grid.shape[a] for a in (columns, rows, axis))
        slices = np.empty((count, height, width), np.uint8)
        with self._context.current():
            self._upload(masks, present)
            GL.glUniform1ui(self._at("present"), sum(1 << int(camera) for camera in present))
            GL.glUniform1i(self._at("min_seeing"), min_seeing)
            GL.glUniform3i(self._at("axes"), columns, rows, axis)
            GL.glUniform2f(self._at("size"), width, height)
            GL.glViewport(0, 0, width, height)
            location = self._at("slice")
            for number in range(count):
                GL.glUniform1f(location, number)
                GL.glDrawArrays(GL.GL_TRIANGLE_STRIP, 0, 4)
                address = ctypes.c_void_p(slices[number].ctypes.data)
                GL.glReadPixels(0, 0, width, height, GL.GL_RED, GL.GL_UNSIGNED_BYTE, address)
        return slices

    def close(self) -> None:
        """Release the context and everything in it."""
        self._context.close()

    def _fragment_source(self) -> str:
        cameras, height, width = self.views.seen.shape
        sizes = f"#define CAMERAS {cameras}\n#define WIDTH {width}\n#define HEIGHT {height}\n"
        return "#version 430\n" + sizes + PROJECT_EXACTLY + FRAGMENT

    def _at(self, uniform: str) -> int:
        return GL.glGetUniformLocation(self._program, uniform)

    def _make_textures(self) -> None:
        cameras, height, width = self.views.seen.shape
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, int(GL.glGenTextures(1)))
        GL.glTexStorage3D(GL.GL_TEXTURE_2D_ARRAY, 1, GL.GL_RG8, width, height, cameras)
        for key in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
            GL.glTexParameteri(GL.GL_TEXTURE_2D_ARRAY, key, GL.GL_NEAREST)

    def _make_target(self) -> None:
        """Make a frame buffer as large as the largest slice of any axis."""
        shape = self.grid.shape
        width = max(shape[columns] for columns, _ in SLICE_AXES.values())
        height = max(shape[rows] for _, rows in SLICE_AXES.values())
        target = int(GL.glGenRenderbuffers(1))
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, target)
        GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_R8, width, height)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, int(GL.glGenFramebuffers(1)))
        GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, GL.GL_COLOR_ATTACHMENT0, GL.GL_RENDERBUFFER, target)
        GL.glBindVertexArray(int(GL.glGenVertexArrays(1)))

    def _set_calibration(self) -> None:
        """Upload the projections."""
        StorageBuffer(pixel_projections(self.views, self.grid)).bind(0)
        GL.glUseProgram(self._program)
        GL.glUniform1i(self._at("silhouettes"), 0)

    def _upload(self, masks: Masks, present: np.ndarray) -> None:
        _, height, width = self.views.seen.shape
        for camera in present:
            mask, texels = masks[self.views.names[camera]], np.zeros((height, width, 2), np.uint8)
            foreground, own = mask > SHADOW_CANDIDATE, texels[: mask.shape[0], : mask.shape[1]]
            seen = self.views.seen[camera, : mask.shape[0], : mask.shape[1]]
            own[..., 0] = np.where(foreground, 255, 0)
            own[..., 1] = np.where(foreground | (mask == 0), seen, 0)  # certain
            GL.glTexSubImage3D(
                GL.GL_TEXTURE_2D_ARRAY, 0, 0, 0, int(camera), width, height, 1, GL.GL_RG, GL.GL_UNSIGNED_BYTE, texels
            )
