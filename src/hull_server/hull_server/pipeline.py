"""Silhouettes of one instant in, hull, centerline and voxel samples out."""

from __future__ import annotations

import time
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import FrameSet, Rig

from .backends import make_backend
from .bricks import BrickVolume
from .centerline import Centerline, find_centerline
from .grid import VoxelGrid
from .settings import HullSettings
from .slicer import slice_blobs
from .views import RigViews, min_seeing
from .voxels import VoxelSamples, sample_voxels

Mask = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class HullResult:
    """The hull of one frame set.

    stamp_ns : capture stamp of the set. cameras, missing : cameras that had a say, and those that delivered nothing.
    blank : cameras whose silhouette is empty; they empty the hull wherever they see.
    min_seeing : how many cameras had to see a voxel. stage_ms : time spent in each stage.
    """

    stamp_ns: int
    volume: BrickVolume
    centerline: Centerline
    voxels: VoxelSamples
    cameras: tuple[str, ...]
    missing: tuple[str, ...]
    blank: tuple[str, ...]
    min_seeing: int
    backend: str
    stage_ms: dict[str, float]

    @property
    def empty(self) -> bool:
        return len(self.volume.index) == 0


class HullPipeline:
    """The hull server's core (thesis chapter 3). Not for two threads at a time."""

    def __init__(self, rig: Rig, settings: HullSettings) -> None:
        """Compute what depends on the calibration only; InputError for a rig or a setting that cannot be used."""
        self.settings = settings
        self.views = RigViews.from_rig(rig)
        self.grid = VoxelGrid.covering(rig.volume, settings.voxel_size_m)
        choice = make_backend(settings.backend, self.views, self.grid)
        self.backend, self.backend_reason = choice.backend, choice.reason

    def run(self, frame_set: FrameSet[Mask]) -> HullResult:
        """The hull of the frame set's canvas masks (h, w) uint8, 255 = foreground, 0 where unseen.

        An empty silhouette, or too few cameras, gives an empty hull. InputError for a mask of the wrong size.
        """
        masks = frame_set.frames
        watch = _StageWatch()
        # voxels of which every camera that sees them has foreground, and enough cameras see them (3.1.4)
        seeing = min_seeing(len(masks), self.settings.min_seeing)
        volume = self.backend.carve(masks, seeing)
        watch.lap("carve")
        # connected components of all slices along x, y and z (3.2)
        blobs = slice_blobs(volume, self.settings.blob.erosion_voxels)
        watch.lap("slice")
        # centroids of the blobs that are large, round and convex enough (3.2)
        centerline = find_centerline(blobs, self.grid, self.settings.blob)
        watch.lap("filter")
        voxels = sample_voxels(volume, self.settings.max_voxels)
        watch.lap("sample")
        return HullResult(
            stamp_ns=frame_set.stamp_ns,
            volume=volume,
            centerline=centerline,
            voxels=voxels,
            cameras=tuple(masks),
            missing=frame_set.missing,
            blank=tuple(name for name, mask in masks.items() if not cv2.countNonZero(mask)),
            min_seeing=seeing,
            backend=self.backend.name,
            stage_ms=watch.laps_ms,
        )

    def warm_up(self) -> None:
        """Carve a small made-up body once, so that the first real frame set does not wait for compilers."""
        centre_world = np.append(self.grid.centres_world(np.array(self.grid.shape) / 2.0 - 0.5), 1.0)
        masks = {}
        for name, P, (width, height) in zip(self.views.names, self.views.P, self.views.sizes, strict=True):
            u, v, w = P @ centre_world
            mask = np.zeros((height, width), np.uint8)
            if w > 0:
                radius = min(width, height) // 8
                cv2.circle(mask, (round(u / w), round(v / w)), radius, 255, -1)
            masks[name] = mask
        self.run(FrameSet(0, masks, dict.fromkeys(masks, 0), ()))

    def close(self) -> None:
        """Release the backend."""
        self.backend.close()


class _StageWatch:
    """Milliseconds between laps."""

    def __init__(self) -> None:
        self.laps_ms: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.laps_ms[stage] = (now - self._last) * 1e3
        self._last = now
