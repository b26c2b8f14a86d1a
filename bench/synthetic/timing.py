"""What one frame set costs at full size: 500 points and 1500 voxels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_packets.hull import VoxelSamples
from virtual_studio.people import Capsules, VolumetricBody

from .clips import Clip, clouds
from .trackers import chain, track

POINTS, VOXELS = 500, 1500
VOXEL_M = 0.02


def times_ms(clip: Clip) -> dict[str, float]:
    """Median CPU time of fit and filter, ms, with the defaults and as many voxels as asked for."""
    method, body = chain(), VolumetricBody(clip.body)
    volume = replace(method.icp.articulated.volume, samples=VOXELS)
    method = replace(method, icp=replace(method.icp, articulated=replace(method.icp.articulated, volume=volume)))
    points = clouds(clip, 3, POINTS)
    voxels = [surface_voxels(body.place(pose), np.random.default_rng(k)) for k, pose in enumerate(clip.poses)]
    run = track(method, clip, points, clip.sigma_m, voxels)
    icp_ms, ekf_ms = float(np.median(run.icp_ms)), float(np.median(run.ekf_ms))
    sizes = f"{len(points[0])} points and {len(voxels[0].points_world)} voxels"
    print(f"\none frame set of {sizes}: fit {icp_ms:.2f} ms, filter {ekf_ms:.3f} ms (medians, CPU time of one thread)")
    return {"icp_ms": round(icp_ms, 3), "ekf_ms": round(ekf_ms, 3)}


def surface_voxels(capsules: Capsules, rng: np.random.Generator) -> VoxelSamples:
    """`VOXELS` surface voxels of a body: random points on the capsules' skins that no other one covers."""
    area = np.linalg.norm(capsules.ends - capsules.starts, axis=1) * capsules.radii.sum(1)
    part = rng.choice(len(area), 8 * VOXELS, p=area / area.sum())
    u, radii = rng.random(len(part)), capsules.radii[part]
    axis = (capsules.ends - capsules.starts)[part]
    across = np.cross(axis, rng.normal(size=axis.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    skin = (
        capsules.starts[part] + u[:, None] * axis + (radii @ [1.0, 0.0] * (1 - u) + radii[:, 1] * u)[:, None] * across
    )
    outside = np.ones(len(skin), bool)
    for start, end, (r0, r1) in zip(capsules.starts, capsules.ends, capsules.radii, strict=True):
        along = end - start
        v = np.clip((skin - start) @ along / (along @ along), 0.0, 1.0)
        distance = np.linalg.norm(skin - start - v[:, None] * along, axis=1)
        outside &= distance > r0 + v * (r1 - r0) - 1e-3
    voxels = np.unique((skin[outside] / VOXEL_M).astype(int), axis=0) * VOXEL_M
    chosen = rng.permutation(voxels)[:VOXELS]
    return VoxelSamples.checked(chosen, np.ones(len(chosen)))
