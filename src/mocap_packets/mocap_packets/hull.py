"""Products of the hull server for the tracker: centerline, voxel samples and contour rays of one frame set.

Each type has a table (``LAYOUT``), which is also published as a point cloud for other subscribers. Rows carry the
number of their body: the hull server numbers bodies that do not touch; people who touch share a number until they part;
-1 is no body. World frame (map), metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from stick_figure.least_squares.keypoint_factor import NO_KEYPOINTS, Keypoints

from .table import NO_AGES, ZEROS, Columns, Flags, Numbers, SetAges


@dataclass(frozen=True, eq=False)
class Centerline(Columns):
    """Centerline points (n) of one hull: centroids of slices that are cross sections of a limb (thesis 3.2).

    points_world : (n, 3). sigma : (n,) standard deviation of the point from the limb's axis, in each direction across
    it. axis : (n,) 0 = x, 1 = y, 2 = z, the axis that the slice was perpendicular to. area_m2, elongation, fill : (n,)
    of the slice. body : (n,) int32.
    """

    points_world: Annotated[np.ndarray, "x y z"]
    sigma: np.ndarray
    axis: Annotated[np.ndarray, np.uint8]
    area_m2: Annotated[np.ndarray, "area"]
    elongation: np.ndarray
    fill: np.ndarray
    body: Numbers

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

    points_world: Annotated[np.ndarray, "x y z"]
    surface: Flags
    body: Numbers = ZEROS

    def surface_points(self, count: int) -> np.ndarray:
        """Return at most ``count`` samples (m, 3) of the surface, evenly spread over the rows; always the same ones."""
        rows = np.flatnonzero(self.surface)
        return self.points_world.take(rows[_spread(len(rows), count)], axis=0)

    def hull_points(self, count: int) -> np.ndarray:
        """Return at most ``count`` samples (m, 3) of surface and interior, evenly spread over the rows."""
        return self.points_world.take(_spread(len(self), count), axis=0)


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

    points_world: Annotated[np.ndarray, "x y z"]
    directions: Annotated[np.ndarray, "dx dy dz"]
    normals: Annotated[np.ndarray, "nx ny nz"]
    half_lengths: Annotated[np.ndarray, "half"]
    sigma: np.ndarray
    camera: Numbers = ZEROS
    body: Numbers = ZEROS
    time_s: Annotated[np.ndarray, "time"] = ZEROS

    def thinned(self, count: int) -> ContourRays:
        """Return at most ``count`` rays, evenly spread over the rows, which follow the outlines; always the same."""
        return self.chosen(_spread(len(self), count))


PARTS: dict[str, Any] = {"centerline": Centerline, "voxels": VoxelSamples, "contour_rays": ContourRays}
"""The parts of `HullProducts`, in its order."""
NO_CENTERLINE = Centerline.of_points(np.empty((0, 3)))
NO_VOXELS = VoxelSamples(np.empty((0, 3)), np.empty(0, dtype=np.bool_))
NO_CONTOUR_RAYS = ContourRays(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))


@dataclass(frozen=True, eq=False)
class HullProducts:
    """Hull products of one frame set, of all bodies in the volume, and the ages of the set.

    keypoints : detections in the set's images, if any; they reach the tracker separately.
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
        """Return the same without centerline points that are not finite, and the number of these."""
        line = self.centerline
        good = np.isfinite(line.points_world).all(axis=1) & np.isfinite(line.sigma)
        return (self, 0) if good.all() else (replace(self, centerline=line.chosen(good)), int((~good).sum()))

    def numbers(self) -> list[int]:
        """Return the numbers of the bodies that have rows, in order."""
        counts = [np.bincount(getattr(self, name).body + 1) for name in PARTS]  # rows of no body have number -1
        return sorted({int(row) - 1 for count in counts for row in np.flatnonzero(count)} - {-1})

    def of_body(self, number: int) -> HullProducts:
        """Return the rows of one body."""
        return self.of_rows(*(getattr(self, name).body == number for name in PARTS))

    def of_rows(self, line: np.ndarray, voxels: np.ndarray, contour_rays: np.ndarray) -> HullProducts:
        """Return some rows of each kind, by masks."""
        rows = zip(PARTS, (line, voxels, contour_rays), strict=True)
        return replace(self, **{name: getattr(self, name).chosen(own) for name, own in rows})

    def renumbered(self, number_of: Callable[[np.ndarray], np.ndarray]) -> HullProducts:
        """Return the same rows; ``number_of`` maps their bodies (n,) int32 to others."""
        parts = {name: getattr(self, name) for name in PARTS}
        return replace(self, **{name: replace(part, body=number_of(part.body)) for name, part in parts.items()})

    def as_one_body(self) -> HullProducts:
        """Return the same rows, all numbered as those of body 0."""
        return self.renumbered(np.zeros_like)


def _spread(available: int, count: int) -> np.ndarray:
    """Return at most ``count`` of the rows, evenly spread."""
    return np.arange(count) * available // count if available > count else np.arange(available)
