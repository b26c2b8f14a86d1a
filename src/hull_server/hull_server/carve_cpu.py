"""The CPU backend: the exact hierarchical carve in float64. Needs no graphics hardware or driver."""

from __future__ import annotations

import cv2
import numpy as np

from .boxes import block_boxes, pixel_projections, summed_area
from .bricks import BrickVolume
from .carve_kernels import BRICK_EDGE, COARSE_EDGE, carve
from .carve_scene import BACKGROUND, BLIND, Scene, foreground_bounds
from .grid import VoxelGrid
from .views import Masks, RigViews


class CpuCarver:
    """Carves on one core; the tables of the calibration are computed once, here. Not for two threads at a time."""

    name = "cpu"
    device = "one CPU core"

    def __init__(self, views: RigViews, grid: VoxelGrid) -> None:
        self.views, self.grid = views, grid
        self._projections = pixel_projections(views, grid)
        self._seen_table = summed_area(views.seen)
        self._coarse = block_boxes(views, grid, COARSE_EDGE, self._seen_table)
        self._bricks = block_boxes(views, grid, BRICK_EDGE, self._seen_table)
        self._countable = np.minimum(views.seen, 1)  # 1 where seen
        self._background = np.full((len(views.names), views.seen[0].size + 1), BLIND, np.uint8)
        self._background[:, :-1][views.seen.reshape(len(views.names), -1) > 0] = BACKGROUND
        self._labels = self._background.copy()
        self._foreground_table = np.zeros_like(self._seen_table)
        self._foreground_box = np.zeros((len(views.names), 4), np.int64)
        self._index = np.empty(grid.brick_count, np.uint32)
        self._leaves = np.empty((grid.brick_count, BRICK_EDGE), np.uint64)

    def carve(self, masks: Masks, min_seeing: int) -> BrickVolume:
        """The hull of the silhouettes of one frame set, by the rule of :mod:`hull_server.views`.

        masks : one canvas mask (h, w) uint8 a camera, nonzero = foreground; absent cameras have no say.
        Raises InputError for an unknown camera or a mask of another size.
        """
        present = self.views.present(masks)
        for camera in present:
            self._tabulate(camera, masks[self.views.names[camera]])
        found = carve(self._scene(present, min_seeing), self._coarse, self._bricks, self._index, self._leaves)
        order = np.argsort(self._index[:found])
        return BrickVolume(self.grid, self._index[:found][order], self._leaves[:found][order])

    def close(self) -> None:
        """Nothing to release."""

    def _tabulate(self, camera: int, mask: np.ndarray) -> None:
        """Labels and summed areas of one silhouette, touching only a box that holds its foreground.

        For one person that is a tenth of the image; the labels of the frame before are cleared in the same way.
        """
        shape = self.views.seen[camera].shape
        labels, background = (a[camera, :-1].reshape(shape) for a in (self._labels, self._background))
        u0, v0, u1, v1 = self._foreground_box[camera]
        labels[v0:v1, u0:u1] = background[v0:v1, u0:u1]
        u0, v0, u1, v1 = foreground_bounds(np.ascontiguousarray(mask).view(np.uint64))
        self._foreground_box[camera] = u0, v0, u1, v1
        if u1 == 0:
            return
        foreground = cv2.min(mask[v0:v1, u0:u1], self._countable[camera, v0:v1, u0:u1])
        labels[v0:v1, u0:u1] |= foreground
        cv2.integral(foreground, self._foreground_table[camera, : v1 - v0 + 1, : u1 - u0 + 1], cv2.CV_32S)

    def _scene(self, present: np.ndarray, min_seeing: int) -> Scene:
        return Scene(
            projections=self._projections,
            sizes=self.views.sizes,
            seen_table=self._seen_table,
            labels=self._labels,
            stride=self.views.seen.shape[2],
            foreground_box=self._foreground_box,
            foreground_table=self._foreground_table,
            present=present,
            min_seeing=min_seeing,
            shape=np.array(self.grid.shape, np.int64),
        )
