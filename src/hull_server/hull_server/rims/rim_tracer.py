"""From the silhouettes of one instant and their hull to rays that touch the body."""

from __future__ import annotations

from dataclasses import asdict

import cv2
import numpy as np
import numpy.typing as npt

from ..bricks import BrickVolume
from ..grid import VoxelGrid
from ..settings import RimSettings
from ..slicing.slicer import HullRuns, slice_hull
from ..views import Masks, RigViews
from .edges import RADIUS_PX, weights
from .grazes import PAD, widen
from .rim_rays import Camera, Hull, Rules, Scratch, trace_rims
from .rim_table import NO_RIMS, RimTable

Mask = npt.NDArray[np.uint8]


class RimTracer:
    """Finds the rim rays of one frame set after another. Not for two threads at a time: it keeps scratch memory."""

    def __init__(self, views: RigViews, grid: VoxelGrid, settings: RimSettings) -> None:
        self._views, self._grid = views, grid
        self._weights = weights()
        self._cameras = [_camera(P, seen) for P, seen in zip(views.P, views.seen, strict=True)]
        self._rules = Rules(**asdict(settings))
        height, width = views.seen.shape[1:]
        cracks = 4 * (height * width // 2 + 1)  # a chessboard has most
        path, along, ends = np.empty((cracks, 2), np.int16), np.empty(cracks), np.empty(cracks // 4, np.int32)
        self._scratch = Scratch(np.zeros((height, width), np.uint8), ends, path, along, 0)

    def trace(self, masks: Masks, runs: HullRuns, levels: Masks | None = None) -> RimTable:
        """The rims of binary canvas masks (h, w) uint8, nonzero is foreground, that touch the hull carved from them.

        levels : the same silhouettes as the cameras sent them, of the levels of ``capture_rig.mask_levels``; rims in
        doubt have a larger sigma. At most ``per_camera`` rays a camera, evenly along the outlines; the same ones every
        time. InputError for a camera that is not in the rig, and for a mask of the wrong size.
        """
        present = self._views.present(masks)
        if not len(runs.starts) or not self._rules.per_camera:
            return NO_RIMS
        hull = _hull(runs, self._grid)
        tables = []
        for index in present:
            name = self._views.names[index]
            tables.append(self._trace(index, masks[name], (levels or masks)[name], hull))
        camera = np.repeat(present.astype(np.int32), [len(table) for table in tables])
        return RimTable(np.concatenate(tables), camera)

    def _trace(self, index: int, mask: Mask, levels: Mask, hull: Hull) -> npt.NDArray[np.float64]:
        self._scratch = self._scratch._replace(stamp=self._scratch.stamp % 255 + 1)
        if self._scratch.stamp == 1:  # every mark has been used
            self._scratch.marks[:] = 0
        mask, levels = np.ascontiguousarray(mask), np.ascontiguousarray(levels)
        return trace_rims(mask, levels, self._cameras[index], hull, self._weights, self._rules, self._scratch)


def find_rims(masks: Masks, views: RigViews, volume: BrickVolume, grid: VoxelGrid, settings: RimSettings) -> RimTable:
    """:meth:`RimTracer.trace` of a hull that has not been sliced yet."""
    return RimTracer(views, grid, settings).trace(masks, slice_hull(volume).runs)


def _hull(runs: HullRuns, grid: VoxelGrid) -> Hull:
    wide, size = widen(runs.words, runs.starts, runs.ends, runs.first)
    corner = grid.origin + (runs.low - PAD) * grid.voxel_size
    lines = runs.starts, runs.ends, runs.first, runs.part, runs.words.shape
    return Hull(wide, size, corner, grid.voxel_size, lines, bool(runs.part.any()))


def _camera(P: npt.NDArray[np.float64], seen: npt.NDArray[np.uint8]) -> Camera:
    pixel_to_ray = np.linalg.inv(P[:, :3]).astype(np.float64)
    window = np.ones((2 * RADIUS_PX + 1, 2 * RADIUS_PX + 1), np.uint8)
    clear = cv2.erode(seen, window, borderType=cv2.BORDER_CONSTANT, borderValue=[0.0])
    return Camera(P, pixel_to_ray, -pixel_to_ray @ P[:, 3], np.asarray(clear, np.uint8))
