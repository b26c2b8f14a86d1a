"""The hull's voxels as the tracker takes them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .contour_rays import NO_CONTOUR_RAYS, ContourRays


@dataclass(frozen=True, eq=False)
class VoxelCloud:
    """Samples of the hull. points_world (m, 3) m; surface (m,) bool, True where a neighbour of the voxel is empty."""

    points_world: np.ndarray
    surface: np.ndarray

    def __len__(self) -> int:
        return len(self.surface)

    @staticmethod
    def checked(points_world: np.ndarray, surface: np.ndarray) -> VoxelCloud:
        """The samples whose coordinates are finite, as contiguous arrays."""
        points = np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
        finite = np.isfinite(points).all(axis=1)
        return VoxelCloud(np.ascontiguousarray(points[finite]), np.asarray(surface, dtype=np.bool_)[finite])

    def surface_points(self, count: int) -> np.ndarray:
        """At most ``count`` samples (m, 3) of the surface, evenly spread over the rows; the same ones every time."""
        return _thinned(self.points_world[self.surface], count)

    def hull_points(self, count: int) -> np.ndarray:
        """At most ``count`` samples (m, 3) of surface and interior, evenly spread over the rows."""
        return _thinned(self.points_world, count)


def _thinned(points: np.ndarray, count: int) -> np.ndarray:
    if len(points) > count:
        points = points[np.arange(count) * len(points) // count]
    return np.ascontiguousarray(points)


NO_VOXELS = VoxelCloud(np.empty((0, 3)), np.empty(0, dtype=np.bool_))


# --- What the hull shows of one frame set, and which of it belongs to the body that is followed.

ONLY_BODY = 0
REACH_M = 0.35  # flesh and half a limb: farther from all 15 reference points is somebody else


@dataclass(frozen=True, eq=False)
class BodyNumbers:
    """Which body of the hull each centerline point (n,) and each voxel sample (m,) belongs to; -1: none.

    The hull server numbers bodies that do not touch; people who touch share a number until they part.
    """

    points: np.ndarray
    voxels: np.ndarray


@dataclass(frozen=True, eq=False)
class HullProducts:
    """What the hull server publishes of one frame set: everybody in the volume.

    points_world (n, 3) m with noise ``sigma_m`` (n,) or one for all: the centerline; voxels: samples of the hull;
    numbers: whose points and voxels they are, None for a single body; rims: rays that touch the bodies.
    """

    stamp_ns: int
    points_world: np.ndarray
    sigma_m: np.ndarray | float = 0.0
    voxels: VoxelCloud = NO_VOXELS
    numbers: BodyNumbers | None = None
    contour_rays: ContourRays = NO_CONTOUR_RAYS

    def finite(self) -> tuple[HullProducts, int]:
        """The same with the points that are finite numbers, as contiguous arrays, and how many were not."""
        points = np.asarray(self.points_world, dtype=np.float64).reshape(-1, 3)
        sigma = np.broadcast_to(np.asarray(self.sigma_m, dtype=np.float64), (len(points),))
        good = np.isfinite(points).all(axis=1) & np.isfinite(sigma)
        numbers = self.numbers and BodyNumbers(self.numbers.points[good], self.numbers.voxels)
        points, sigma = np.ascontiguousarray(points[good]), np.ascontiguousarray(sigma[good])
        return replace(self, points_world=points, sigma_m=sigma, numbers=numbers), int((~good).sum())

    def voxels_of_bodies(self) -> dict[int, np.ndarray]:
        """The voxels (m, 3) of each body, m, by its number."""
        points = self.voxels.points_world
        if self.numbers is None or len(self.numbers.voxels) != len(points):
            return {ONLY_BODY: points}
        bodies = np.unique(self.numbers.voxels)
        bodies = bodies[bodies >= 0] if (bodies >= 0).any() else bodies
        return {int(body): points[self.numbers.voxels == body] for body in bodies} or {ONLY_BODY: points}

    def of_body(self, number: int) -> HullProducts:
        """The same without anybody else."""
        if self.numbers is None:
            return self
        voxels, kept = self.voxels, self.numbers.points == number
        if len(self.numbers.voxels) == len(voxels):
            mine = self.numbers.voxels == number
            voxels = VoxelCloud(np.ascontiguousarray(voxels.points_world[mine]), voxels.surface[mine])
        sigma = np.broadcast_to(self.sigma_m, kept.shape)[kept]
        return HullProducts(
            self.stamp_ns, self.points_world[kept], sigma, voxels, None, self.contour_rays.of_body(number)
        )

    def of_body_at(self, reference_points_world: np.ndarray) -> HullProducts:
        """The same without anybody but the body that is expected at the reference points (15, 3).

        It is the one with most points near them, not the one with the same number as before: numbers may change hands
        when people touch.
        """
        bodies = np.empty(0) if self.numbers is None else np.unique(self.numbers.points)
        if self.numbers is None or len(bodies) < 2:
            return self
        offsets = self.points_world[:, None] - reference_points_world
        near = np.einsum("npk,npk->np", offsets, offsets).min(axis=1) < REACH_M**2
        return self.of_body(
            int(bodies[np.argmax([np.count_nonzero(near & (self.numbers.points == body)) for body in bodies])])
        )
