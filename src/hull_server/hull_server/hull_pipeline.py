"""From the silhouettes of one instant to hull, centerline, voxel samples, bodies and contour rays.

The stages in the order of the data: consistency (which cameras to use), shadows, carving, slicing, contour rays.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import Rig
from capture_rig.mask_levels import FOREGROUND, SHADOW_CANDIDATE
from capture_rig.stamps import NS_PER_S
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import ContourRays, HullProducts
from mocap_packets.silhouette import ForegroundSupport

from .carving import make_backend
from .consistency.camera_fault_detector import CameraFaultDetector, CameraFaults
from .consistency.foreground_support import SupportReporter
from .contour_rays.contour_tracer import ContourTracer
from .floor_shadows import ShadowResolver
from .grid import BrickVolume, VoxelGrid
from .settings import HullSettings
from .slicing.bodies import Bodies, BodyTracker
from .slicing.skeletonisation import find_centerline, slice_hull
from .slicing.voxel_runs import sample_runs
from .views import RigViews, min_seeing

Mask = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class PendingHull:
    """A carved frame set, passed from :meth:`HullPipeline.begin` to :meth:`HullPipeline.finish`.

    masks : of the cameras that were carved with, shadows resolved. blank : cameras whose silhouette is empty; they
    empty the hull wherever they see. camera_faults : cameras that contradict the others; those left out were not carved
    with. min_seeing : number of cameras that had to see a voxel. stage_ms : time spent in each stage.
    """

    frame_set: FrameSet[Mask]
    masks: dict[str, Mask]
    blank: tuple[str, ...]
    camera_faults: CameraFaults
    min_seeing: int
    volume: BrickVolume
    stage_ms: dict[str, float]

    @property
    def stamp_ns(self) -> int:
        return self.frame_set.stamp_ns

    @property
    def empty(self) -> bool:
        return len(self.volume.index) == 0


@dataclass(frozen=True, eq=False)
class HullResult(PendingHull):
    """The hull of one frame set.

    products : for the tracker. bodies : the parts of the hull large enough to be a person, numbered. support : where
    each camera's foreground can be a body by the other cameras; a few times a second, else empty.
    """

    products: HullProducts
    bodies: Bodies
    support: tuple[ForegroundSupport, ...]


class HullPipeline:
    """Computes hulls (thesis chapter 3) in two halves, so that two threads can overlap two frame sets.

    ``begin`` is for one thread at a time, ``finish`` for one (other or same) thread at a time, in the same order.
    """

    def __init__(self, rig: Rig, settings: HullSettings) -> None:
        """InputError for a rig or a setting that cannot be used."""
        self.settings, self._rig = settings, rig
        self.views = RigViews.from_rig(rig)
        self.grid = VoxelGrid.covering(rig.volume, settings.voxel_size_m)
        self.backend, self.backend_reason = make_backend(settings.backend, self.views, self.grid)
        self._faults = CameraFaultDetector(rig, self.views, settings.camera_fault, settings.min_seeing)
        # faulty cameras must not vote, so without that test there is no report
        self._support = SupportReporter(rig, self.views, settings.min_seeing) if settings.camera_fault.enabled else None
        self._shadows = ShadowResolver(self.views, rig.volume, self.grid)
        self._bodies = BodyTracker(settings.body)
        self._contour = ContourTracer(self.views, self.grid, settings.contour)

    def run(self, frame_set: FrameSet[Mask]) -> HullResult:
        """Compute the hull of canvas masks (h, w) uint8, levels of ``capture_rig.mask_levels``, 0 where unseen.

        An empty silhouette, or too few cameras, gives an empty hull. InputError for a mask of the wrong size.
        """
        return self.finish(self.begin(frame_set))

    def begin(self, frame_set: FrameSet[Mask]) -> PendingHull:
        """Choose the cameras, resolve shadows, and carve: all that needs the silhouettes of all cameras."""
        watch = _StageWatch()
        # pixels behind a camera's occluders count as unseen
        frames = self._faults.occluders.applied(frame_set.frames)
        frame_set = replace(frame_set, frames=frames)
        # leave out cameras that contradict all others
        faults = self._faults.update(frames, frame_set.stamp_ns)
        used = {name: mask for name, mask in frames.items() if name not in faults.left_out}
        seeing = min_seeing(len(used), self.settings.min_seeing)
        watch.lap("consistency")
        # find the dark pixels that may be floor in shadow
        masks = self._shadows.resolve(used)
        watch.lap("shadows")
        # carve: voxels of which every camera that sees them has foreground, and enough cameras see them (3.1.4)
        boxes = self._shadows.boxes(masks)
        volume = self.backend.carve(masks, seeing, boxes)
        watch.lap("carve")
        blank = tuple(name for name, (left, _, right, _) in boxes.items() if left == right)
        return PendingHull(frame_set, masks, blank, faults, seeing, volume, watch.laps_ms)

    def finish(self, pending: PendingHull) -> HullResult:
        """Slice, filter, sample, and trace the contour rays."""
        frame_set, watch = pending.frame_set, _StageWatch()
        # report foreground without support to the camera clients, where moved things become background
        shown = frame_set.frames | pending.masks
        support = self._support.update(shown, pending.masks, frame_set.stamp_ns) if self._support else ()
        watch.lap("support")
        # remove voxels next to the floor that a camera shows as floor in shadow
        volume = self._shadows.without_shadows(pending.volume, pending.masks)
        watch.lap("floor")
        # connected components of all slices along x, y and z (3.2)
        blobs, runs = slice_hull(volume)
        watch.lap("slice")
        bodies = self._bodies.step(frame_set.stamp_ns, runs, self.grid)
        # centroids of the blobs that are cross sections of a limb or trunk (3.2)
        centerline = find_centerline(blobs, self.grid, self.settings.blob)
        watch.lap("filter")
        voxels = sample_runs(runs, self.grid, self.settings.max_voxels * max(len(bodies), 1))
        watch.lap("sample")
        # rays along the silhouettes' contours: where the hull is wider than the body, they are still tangent to it
        contour_rays = self._timed(self._contour.trace(pending.masks, runs, frame_set.frames), frame_set)
        products = HullProducts(frame_set.stamp_ns, centerline, voxels, contour_rays)
        watch.lap("contour_rays")
        products = products.renumbered(bodies.number_of_part.__getitem__)
        done = vars(pending) | {"volume": volume, "stage_ms": pending.stage_ms | watch.laps_ms}
        return HullResult(**done, products=products, bodies=bodies, support=support)

    def _timed(self, rays: ContourRays, frame_set: FrameSet[Mask]) -> ContourRays:
        """Return the rays with their times: those of their cameras, and of their rows where shutters roll."""
        time_s = np.zeros(len(rays))
        for index, camera in enumerate(self._rig.cameras):
            later_s = (frame_set.stamps_ns.get(camera.name, frame_set.stamp_ns) - frame_set.stamp_ns) / NS_PER_S
            if later_s or camera.line_time_s:
                own = rays.camera == index
                rows = camera.project(rays.points_world[own])[:, 1] - 0.5 * (camera.height - 1)
                time_s[own] = later_s + camera.line_time_s * np.nan_to_num(rows)
        return replace(rays, time_s=time_s)

    def warm_up(self) -> None:
        """Carve a small ball amid shadow once, so that the first real frame set does not wait for compilers."""
        centre_world = np.append(self.grid.centres_world(np.array(self.grid.shape) / 2.0 - 0.5), 1.0)
        masks = {}
        for name, P, (width, height) in zip(self.views.names, self.views.P, self.views.sizes, strict=True):
            u, v, w = P @ centre_world
            mask = np.zeros((height, width), np.uint8)
            if w > 0:
                radius = min(width, height) // 8
                cv2.circle(mask, (round(u / w), round(v / w)), 2 * radius, SHADOW_CANDIDATE, -1)
                cv2.circle(mask, (round(u / w), round(v / w)), radius, FOREGROUND, -1)
            masks[name] = mask
        self.run(FrameSet.of_instant(0, masks))

    def close(self) -> None:
        """Release the backend."""
        self.backend.close()


class _StageWatch:
    """Measures the milliseconds of each stage."""

    def __init__(self) -> None:
        self.laps_ms: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.laps_ms[stage] = (now - self._last) * 1e3
        self._last = now
