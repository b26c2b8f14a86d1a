"""The CPU backend: the exact hierarchical carve in float64. Needs no graphics hardware or driver."""

from __future__ import annotations

import numpy as np

from ..bricks import BrickVolume
from ..grid import VoxelGrid
from ..views import Masks, RigViews
from .boxes import block_boxes, pixel_projections, rows_within_reach, summed_area
from .carve_backend import Immediate
from .carve_kernels import BRICK_EDGE, COARSE_EDGE, Work, carve
from .carve_octants import octant_steps
from .carve_scene import Scene, Tabulator
from .carve_votes import voxel_steps


class CpuCarver(Immediate):
    """Carves on one core; the tables of the calibration are computed once, here. Not for two threads at a time."""

    name = "cpu"
    device = "one CPU core"

    def __init__(self, views: RigViews, grid: VoxelGrid) -> None:
        self.views, self.grid = views, grid
        projections, seen_table = pixel_projections(views, grid), summed_area(views.seen)
        self._coarse = block_boxes(views, grid, COARSE_EDGE, seen_table)
        self._bricks = block_boxes(views, grid, BRICK_EDGE, seen_table)
        self._tabulator = Tabulator(views.seen, rows_within_reach(self._bricks, views.seen.shape))
        self._scene = Scene(
            projections=projections,
            voxel_steps=voxel_steps(projections),
            octant_steps=octant_steps(projections),
            sizes=views.sizes,
            seen_table=seen_table,
            labels=self._tabulator.labels,
            stride=views.seen.shape[2],
            foreground_box=self._tabulator.box,
            foreground_table=self._tabulator.table,
            present=np.empty(0, np.int64),
            min_seeing=0,
            shape=np.array(grid.shape, np.int64),
        )
        self._index = np.empty(grid.brick_count, np.uint32)
        self._leaves = np.empty((grid.brick_count, BRICK_EDGE), np.uint64)
        self._work = Work.make(len(views.names), self._coarse.sight.shape[1])

    def carve(self, masks: Masks, min_seeing: int) -> BrickVolume:
        """The hull of the silhouettes of one frame set, by the rule of :mod:`hull_server.views`.

        masks : one canvas mask (h, w) uint8 a camera, nonzero = foreground; absent cameras have no say.
        Raises InputError for an unknown camera or a mask of another size.
        """
        present = self.views.present(masks)
        filled = [self._tabulator.tabulate(camera, masks[self.views.names[camera]]) for camera in present]
        smallest_first = present[np.argsort(filled, kind="stable")]  # who sees little foreground empties most blocks
        scene = self._scene._replace(present=smallest_first, min_seeing=min_seeing)
        found = carve(scene, self._coarse, self._bricks, self._index, self._leaves, self._work)
        return BrickVolume(self.grid, self._index[:found].copy(), self._leaves[:found].copy())

    def close(self) -> None:
        """Nothing to release."""
