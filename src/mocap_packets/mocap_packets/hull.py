"""What the hull server hands to the tracker: centerline, voxel samples and contour rays of one frame set.

Each type knows its table (``LAYOUT``), which is also published as a point cloud, for whoever listens. Rows carry
the number of the body that they belong to: the hull server numbers bodies that do not touch; people who touch share a
number until they part; -1 is nobody. World frame (map), metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from stick_figure.least_squares.keypoint_factor import NO_KEYPOINTS, Keypoints

from .table import NO_AGES, Columns, SetAges

_UNSET = np.empty(0, np.int32)

Rows = TypeVar("Rows", "Centerline", "VoxelSamples", "ContourRays")


def _number_one_body(packet: VoxelSamples | ContourRays) -> None:
    if len(packet.body) != len(packet):
        object.__setattr__(packet, "body", np.zeros(len(packet), np.int32))


@dataclass(frozen=True, eq=False)
class Centerline(Columns):
    """Centerline points (n) of one hull: centroids of the slices that look like a limb cut across (thesis 3.2).

    points_world : (n, 3). sigma : (n,) standard deviation of the point from the limb's axis, in each direction across
    it. axis : (n,) 0 = x, 1 = y, 2 = z, the axis that the slice was perpendicular to. area_m2, elongation, fill : (n,)
    of the slice. body : (n,) int32.
    """

    COLUMNS = "points_world: x y z; sigma; axis; area_m2: area; elongation; fill; body"
    KINDS: ClassVar = {"axis": np.uint8, "body": np.int32}

    points_world: np.ndarray
    sigma: np.ndarray
    axis: np.ndarray
    area_m2: np.ndarray
    elongation: np.ndarray
    fill: np.ndarray
    body: np.ndarray

    @classmethod
    def of_points(
        cls, points_world: np.ndarray, sigma: np.ndarray | float = 0.0, body: np.ndarray | None = None
    ) -> Centerline:
        """Points (n, 3) that do not come from slices, with noise (n,) or one for all; of one body unless given."""
        points = np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
        n = len(points)
        sigma = np.broadcast_to(np.asarray(sigma, dtype=np.float64), (n,))
        body = np.zeros(n, np.int32) if body is None else np.asarray(body)
        return cls(points, sigma, np.zeros(n, np.uint8), np.zeros(n), np.ones(n), np.ones(n), body)


@dataclass(frozen=True, eq=False)
class VoxelSamples(Columns):
    """Voxels (m) of the hull: centres (m, 3); surface (m,) bool, True where a neighbour is empty; body (m,) int32.

    Without ``body``, all of one body, number 0.
    """

    COLUMNS = "points_world: x y z; surface; body"
    KINDS: ClassVar = {"surface": np.bool_, "body": np.int32}

    points_world: np.ndarray
    surface: np.ndarray
    body: np.ndarray = field(default_factory=lambda: _UNSET)

    def __post_init__(self) -> None:
        _number_one_body(self)

    @classmethod
    def checked(cls, points_world: np.ndarray, surface: np.ndarray) -> VoxelSamples:
        """Return the samples of one body whose coordinates are finite, as contiguous arrays."""
        points = np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
        finite = np.isfinite(points).all(axis=1)
        return cls(np.ascontiguousarray(points[finite]), np.asarray(surface, dtype=np.bool_)[finite])

    def surface_points(self, count: int) -> np.ndarray:
        """Return at most ``count`` samples (m, 3) of the surface, evenly spread over the rows; always the same ones."""
        return _thinned(self.points_world, count, np.flatnonzero(self.surface))

    def hull_points(self, count: int) -> np.ndarray:
        """Return at most ``count`` samples (m, 3) of surface and interior, evenly spread over the rows."""
        return _thinned(self.points_world, count)


@dataclass(frozen=True, eq=False)
class ContourRays(Columns):
    """Rays (n) through the silhouettes' contours, by camera, then along each outline.

    A point on a silhouette's contour is the view of a ray that touches the body's surface somewhere without entering
    it. Where on the ray it touches is not known, only that it is where the ray grazes the hull.

    points_world (n, 3) : the middle of the longest stretch of the ray along the hull; half_lengths (n,) : half that
    stretch. directions (n, 3) : unit, away from the camera. normals (n, 3) : unit, across the ray and out of the
    silhouette: the normal of the plane through the camera and the contour's tangent, and so of the body's surface where
    the ray touches it. sigma (n,) : standard deviation of the ray along its normal, at that stretch. body (n,) int32.
    camera (n,) int32 : the camera's place in the rig. time_s (n,) : when the ray's pixel was exposed, after the set's
    stamp. Without ``body``, ``camera`` and ``time_s``, all 0.
    """

    COLUMNS = "points_world: x y z; directions: dx dy dz; normals: nx ny nz; half_lengths: half;"
    COLUMNS += " sigma; camera; body; time_s: time"
    KINDS: ClassVar = {"camera": np.int32, "body": np.int32}

    points_world: np.ndarray
    directions: np.ndarray
    normals: np.ndarray
    half_lengths: np.ndarray
    sigma: np.ndarray
    body: np.ndarray = field(default_factory=lambda: _UNSET)
    camera: np.ndarray = field(default_factory=lambda: _UNSET)
    time_s: np.ndarray = field(default_factory=lambda: _UNSET)

    def __post_init__(self) -> None:
        _number_one_body(self)
        for name, kind in (("camera", np.int32), ("time_s", np.float64)):
            if len(getattr(self, name)) != len(self.sigma):
                object.__setattr__(self, name, np.zeros(len(self.sigma), kind))

    def thinned(self, count: int) -> ContourRays:
        """Return at most ``count`` rays, evenly spread over the rows, which follow the outlines; always the same."""
        if len(self) <= count:
            return self
        return self.chosen(np.arange(count) * len(self) // count)

    def chosen(self, rows: np.ndarray) -> ContourRays:
        """Return some rows, by number or mask."""
        return _rows(self, rows)


PARTS: dict[str, Any] = {"centerline": Centerline, "voxels": VoxelSamples, "contour_rays": ContourRays}
"""The parts of `HullProducts`, in its order."""
NO_CENTERLINE = Centerline.of_points(np.empty((0, 3)))
NO_VOXELS = VoxelSamples(np.empty((0, 3)), np.empty(0, dtype=np.bool_))
NO_CONTOUR_RAYS = ContourRays(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))


@dataclass(frozen=True, eq=False)
class HullProducts:
    """What the hull server hands on of one frame set: everything in the volume, of all bodies; how old the set is.

    keypoints : what detectors found in the set's images, where there are any. They come to the tracker on their own.
    """

    LAYOUTS: ClassVar[dict[str, np.dtype]] = {
        **{name: kind.LAYOUT for name, kind in PARTS.items()},
        "ages": SetAges.LAYOUT,
    }

    stamp_ns: int
    centerline: Centerline
    voxels: VoxelSamples = NO_VOXELS
    contour_rays: ContourRays = NO_CONTOUR_RAYS
    ages: SetAges = NO_AGES
    keypoints: Keypoints = NO_KEYPOINTS

    @classmethod
    def of_points(
        cls,
        stamp_ns: int,
        points_world: np.ndarray,
        sigma: np.ndarray | float = 0.0,
        voxels: VoxelSamples = NO_VOXELS,
        contour_rays: ContourRays = NO_CONTOUR_RAYS,
    ) -> HullProducts:
        """Products of one body whose centerline is any cloud of points (n, 3)."""
        return cls(stamp_ns, Centerline.of_points(points_world, sigma), voxels, contour_rays)

    def to_tables(self) -> dict[str, np.ndarray]:
        """Return the tables of :data:`LAYOUTS`."""
        return {name: getattr(self, name).to_table() for name in PARTS} | {"ages": self.ages.to_table()}

    @classmethod
    def from_tables(cls, stamp_ns: int, tables: Mapping[str, np.ndarray]) -> HullProducts:
        """Return the inverse of :meth:`to_tables`. Raises InputError for ages that are not one row."""
        line, voxels, rays = (kind.from_table(tables[name]) for name, kind in PARTS.items())
        return cls(stamp_ns, line, voxels, rays, SetAges.from_table(tables["ages"]))

    def finite(self) -> tuple[HullProducts, int]:
        """Return the same with the centerline points that are finite numbers, and how many were not."""
        line = self.centerline
        if np.isfinite(line.points_world).all() and np.isfinite(line.sigma).all():
            return self, 0
        good = np.isfinite(line.points_world).all(axis=1) & np.isfinite(line.sigma)
        return replace(self, centerline=_rows(line, good)), int((~good).sum())

    def numbers(self) -> list[int]:
        """Return the numbers of the bodies that rows belong to, in order; nobody's rows are no body's."""
        packets = (self.centerline, self.voxels, self.contour_rays)
        counts = [np.bincount(packet.body + 1) for packet in packets]  # nobody's rows have number -1
        return sorted({int(row) - 1 for count in counts for row in np.flatnonzero(count)} - {-1})

    def of_body(self, number: int) -> HullProducts:
        """Return the rows of one body."""
        line, voxels, rays = self.centerline, self.voxels, self.contour_rays
        return self.of_rows(line.body == number, voxels.body == number, rays.body == number)

    def of_rows(self, line: np.ndarray, voxels: np.ndarray, contour_rays: np.ndarray) -> HullProducts:
        """Return some rows of each kind, by masks."""
        return HullProducts(
            self.stamp_ns,
            _rows(self.centerline, line),
            _rows(self.voxels, voxels),
            _rows(self.contour_rays, contour_rays),
            keypoints=self.keypoints,
        )

    def renumbered(self, number_of: Callable[[np.ndarray], np.ndarray]) -> HullProducts:
        """Return the same rows; ``number_of`` maps their bodies (n,) int32 to others."""
        line, voxels, rays = self.centerline, self.voxels, self.contour_rays
        return replace(
            self,
            centerline=replace(line, body=number_of(line.body)),
            voxels=replace(voxels, body=number_of(voxels.body)),
            contour_rays=replace(rays, body=number_of(rays.body)),
        )

    def as_one_body(self) -> HullProducts:
        """Return the same rows, all numbered as those of body 0."""
        return self.renumbered(np.zeros_like)


def _rows(packet: Rows, rows: np.ndarray) -> Rows:
    """Return the chosen rows of every column, contiguous."""
    if rows.dtype == np.bool_:
        rows = np.flatnonzero(rows)  # to take rows by number is several times faster than by mask
    return replace(packet, **{name: values.take(rows, axis=0) for name, values in vars(packet).items()})


def _thinned(points: np.ndarray, count: int, rows: np.ndarray | None = None) -> np.ndarray:
    """Return at most ``count`` of the points (of the given rows), evenly spread, contiguous."""
    available = len(points) if rows is None else len(rows)
    if available > count:
        chosen = np.arange(count) * available // count
        rows = chosen if rows is None else rows[chosen]
    return np.ascontiguousarray(points if rows is None else points.take(rows, axis=0))
