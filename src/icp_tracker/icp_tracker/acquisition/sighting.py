"""What one frame set shows while no body is followed yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..voxel_cloud import NO_VOXELS, VoxelCloud
from .one_body import BodyNumbers

ONLY_BODY = 0


@dataclass(frozen=True, eq=False)
class Sighting:
    """Centerline points and voxels of everybody in the volume.

    points_world (n, 3) m; voxels : the hull's samples, or None where there are none; numbers : whose points and voxels
    they are, or None for a single body.
    """

    stamp_ns: int
    points_world: np.ndarray
    voxels: VoxelCloud | None = None
    numbers: BodyNumbers | None = None

    def voxels_of_bodies(self) -> dict[int, np.ndarray]:
        """The voxels (m, 3) of each body, m, by its number."""
        points = (self.voxels or NO_VOXELS).points_world
        if self.numbers is None or len(self.numbers.voxels) != len(points):
            return {ONLY_BODY: points}
        bodies = np.unique(self.numbers.voxels)
        bodies = bodies[bodies >= 0] if (bodies >= 0).any() else bodies
        return {int(body): points[self.numbers.voxels == body] for body in bodies} or {ONLY_BODY: points}

    def of_body(self, number: int) -> Sighting:
        """The same without anybody else."""
        if self.numbers is None:
            return self
        voxels = self.voxels
        if voxels is not None and len(self.numbers.voxels) == len(voxels):
            mine = self.numbers.voxels == number
            voxels = VoxelCloud(np.ascontiguousarray(voxels.points_world[mine]), voxels.surface[mine])
        return Sighting(self.stamp_ns, self.points_world[self.numbers.points == number], voxels)
