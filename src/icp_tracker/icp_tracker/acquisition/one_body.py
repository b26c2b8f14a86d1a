"""Several people in the volume, one of them followed: which points of the hull are that person's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rim_rays import NO_RIMS, RimRays
from ..voxel_cloud import VoxelCloud

REACH_M = 0.35  # flesh and half a limb: farther from all 15 reference points is somebody else


@dataclass(frozen=True, eq=False)
class BodyNumbers:
    """Which body of the hull each centerline point (n,) and each voxel sample (m,) belongs to; -1: none.

    The hull server numbers bodies that do not touch; people who touch share a number until they part.
    """

    points: np.ndarray
    voxels: np.ndarray


def of_one_body(
    points_world: np.ndarray,
    sigma: np.ndarray,
    voxels: VoxelCloud | None,
    numbers: BodyNumbers,
    reference_points_world: np.ndarray,
    rims: RimRays = NO_RIMS,
) -> tuple[np.ndarray, np.ndarray, VoxelCloud | None, RimRays]:
    """Points (n, 3), their sigma (n,), voxels and rims of the body that is followed.

    It is the one with most points near the expected reference points (15, 3), not the one with the same number as
    before: numbers may change hands when people touch.
    """
    bodies = np.unique(numbers.points)
    if len(bodies) < 2:
        return points_world, sigma, voxels, rims
    offsets = points_world[:, None] - reference_points_world
    near = np.einsum("npk,npk->np", offsets, offsets).min(axis=1) < REACH_M**2
    chosen = bodies[np.argmax([np.count_nonzero(near & (numbers.points == body)) for body in bodies])]
    kept = numbers.points == chosen
    if voxels is not None:
        mine = numbers.voxels == chosen
        voxels = VoxelCloud(np.ascontiguousarray(voxels.points_world[mine]), voxels.surface[mine])
    return points_world[kept], sigma[kept], voxels, rims.of_body(chosen)
