"""The scene that the hull's benches carve, and other ways to carve it, which ours is compared with.

Each way takes canvas silhouettes and returns how many voxels it found occupied. Only ours goes on to slices and
points: the others' times are for less work. Where a method has no word for "unseen", every camera has to see a voxel.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np

from capture_rig import Rig, Volume
from hull_server.grid import VoxelGrid
from hull_server.thesis_plane_sweep import PlaneSweepCarver
from hull_server.views import RigViews, min_seeing
from stick_figure.body import Body
from virtual_studio.motions.catalogue import tour
from virtual_studio.people import VolumetricBody
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

Masks = dict[str, np.ndarray]
Method = Callable[[Masks], int]
VOLUME = Volume(np.array([-1.25, -1.25, 0.0]), np.array([1.25, 1.25, 2.2]))
STATURE_M, TOUR_S, TOUR_FPS = 1.75, 12.0, 10.0


@cache
def scene(cameras: int, poses: int) -> tuple[Rig, list[Masks]]:
    """A ring of cameras and one above, 640 x 480 with lens distortion, and exact canvas silhouettes.

    The body moves through ``poses`` poses of the built-in tour.
    """
    rig, body = Rig(ring(cameras - 1).cameras, VOLUME), Body.from_stature(STATURE_M)
    person, eyes, motion = VolumetricBody(body), ExactSilhouettes(rig), tour(body, TOUR_S, TOUR_FPS)
    chosen = np.linspace(0, len(motion.poses) - 1, poses).astype(int)
    return rig, [eyes.render(person.place(motion.poses[index])) for index in chosen]


class PlainNumpy:
    """The rule as one would first write it: every voxel centre, camera by camera, in float64."""

    def __init__(self, views: RigViews, grid: VoxelGrid) -> None:
        self.views, self.grid = views, grid

    def __call__(self, masks: Masks) -> int:
        return int(self.carve(masks).sum())

    def carve(self, masks: Masks) -> np.ndarray:
        """(nx, ny, nz) bool: the reference that every backend is compared with."""
        centres = self.grid.centres_world(np.indices(self.grid.shape).reshape(3, -1).T)
        occupied, seeing = np.ones(len(centres), bool), np.zeros(len(centres), np.uint8)
        for index, name in enumerate(self.views.names):
            P, (width, height) = self.views.P[index], self.views.sizes[index]
            homogeneous = centres @ P[:, :3].T + P[:, 3]
            with np.errstate(divide="ignore", invalid="ignore"):
                u, v = np.floor(homogeneous[:, :2] / homogeneous[:, 2:] + 0.5).T
            inside = np.flatnonzero((homogeneous[:, 2] > 0) & (u >= 0) & (v >= 0) & (u < width) & (v < height))
            row, column = v[inside].astype(int), u[inside].astype(int)
            seen = self.views.seen[index, row, column] > 0
            seeing[inside] += seen
            occupied[inside] &= ~seen | (masks[name][row, column] > 0)
        return (occupied & (seeing >= min_seeing(len(masks)))).reshape(self.grid.shape)


class OpenCvPlanes:
    """A homography for each camera and layer of voxels: warpPerspective draws the silhouette onto the layer."""

    def __init__(self, views: RigViews, grid: VoxelGrid) -> None:
        self._names, (nx, ny, nz) = views.names, grid.shape
        P = grid.projection_from_voxels(views.P)
        self._pixel_from_layer = [[p[:, [0, 1, 3]] + np.outer(k * p[:, 2], (0, 0, 1)) for p in P] for k in range(nz)]
        self._size = nx, ny
        self._drawn = np.empty((ny, nx), np.uint8)

    def __call__(self, masks: Masks) -> int:
        flags, found = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP, 0
        for homographies in self._pixel_from_layer:
            layer: np.ndarray | None = None
            for name, homography in zip(self._names, homographies, strict=True):
                drawn = cv2.warpPerspective(masks[name], homography, self._size, self._drawn, flags)
                layer = drawn.copy() if layer is None else cv2.bitwise_and(layer, drawn, layer)
                if not cv2.hasNonZero(layer):
                    break
            found += cv2.countNonZero(layer)
        return found


class Open3d:
    """Open3D's VoxelGrid.carve_silhouette. It keeps a voxel when any of its corners lies on foreground: a fatter hull.

    Its mask has to be float32: with uint8 it carves everything, and says nothing.
    """

    def __init__(self, views: RigViews, grid: VoxelGrid) -> None:
        import open3d

        self._o3d, self._views, self._grid = open3d, views, grid
        self._cameras = [self._pinhole(P, size) for P, size in zip(views.P, views.sizes, strict=True)]

    def __call__(self, masks: Masks) -> int:
        o3d, size = self._o3d, self._grid.voxel_size
        voxels = o3d.geometry.VoxelGrid.create_dense(
            self._grid.origin.reshape(3, 1), np.zeros((3, 1)), size, *(size * n for n in self._grid.shape)
        )
        for name, camera in zip(self._views.names, self._cameras, strict=True):
            voxels.carve_silhouette(o3d.geometry.Image(masks[name].astype(np.float32)), camera)
        return len(voxels.get_voxels())

    def _pinhole(self, P: np.ndarray, size: np.ndarray) -> object:
        K, R, centre = cv2.decomposeProjectionMatrix(P)[:3]
        K, T_camera_world = K / K[2, 2], np.eye(4)
        T_camera_world[:3, :3], T_camera_world[:3, 3:] = R, -R @ (centre[:3] / centre[3])
        camera = self._o3d.camera.PinholeCameraParameters()
        camera.intrinsic = self._o3d.camera.PinholeCameraIntrinsic(
            int(size[0]), int(size[1]), K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        )
        camera.extrinsic = T_camera_world
        return camera


class ThesisSweep:
    """The thesis's whole method (3.1.3, 3.2): a textured quad a slice, read back, its components found; three axes."""

    def __init__(self, views: RigViews, grid: VoxelGrid) -> None:
        self._sweep = PlaneSweepCarver(views, grid)
        self.device = self._sweep.device

    def __call__(self, masks: Masks) -> int:
        found = 0
        for axis in range(3):
            for image in self._sweep.sweep(masks, min_seeing(len(masks)), axis):
                if cv2.countNonZero(image):
                    statistics = cv2.connectedComponentsWithStats(image, connectivity=8)[2]
                    found += int(statistics[1:, cv2.CC_STAT_AREA].sum())
        return found // 3


BASELINES: dict[str, Callable[[RigViews, VoxelGrid], Method]] = {
    "plain NumPy": PlainNumpy,
    "Open3D carve_silhouette": Open3d,
    "OpenCV warpPerspective": OpenCvPlanes,
    "the thesis's sweep": ThesisSweep,
}
