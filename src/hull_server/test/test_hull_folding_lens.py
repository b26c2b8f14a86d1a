"""Cameras whose lens model folds inside the image: they are blind there, which vetoes nothing, and carving is exact."""

from dataclasses import replace

import numpy as np
import pytest
from hull_scenes import capsule_person, carve_brute_force, ring_rig, silhouettes

from capture_rig import Rig
from hull_server.carving import make_backend
from hull_server.grid import VoxelGrid
from hull_server.views import RigViews

VOXEL_M = 0.04
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


def folding_rig() -> Rig:
    """Five cameras, about 100 degrees across, that stand near: a body at the volume's edge reaches folded corners."""
    rig = ring_rig(5, size=(322, 243), focal_px=209.0, seed=4)
    D = np.array([-0.4, 0.15, 3e-4, -3e-4, -0.03])
    cameras = []
    for camera in rig.cameras:
        T = camera.T_camera_world.copy()
        T[:3, 3] -= [0.0, 0.0, 1.6]  # 1.6 m nearer along the axis
        cameras.append(replace(camera, D=D, T_camera_world=T))
    return Rig(tuple(cameras), rig.volume)


def test_views_are_blind_exactly_beyond_the_fold():
    rig = folding_rig()
    views = RigViews.from_rig(rig)
    for camera, seen in zip(rig.cameras, views.seen, strict=True):
        assert camera.unused_share > 0.04
        rows, columns = np.nonzero(seen)
        K = camera.undistorted_view().camera.K
        off_axis = np.arctan(np.hypot((columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1]))
        assert off_axis.max() < camera.reach_rad
        assert off_axis.max() > camera.reach_rad - np.deg2rad(1.0)  # some corner of the image is beyond


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.7, -0.6)])
def test_carving_is_exact_and_a_folded_corner_vetoes_nothing(place):
    rig = folding_rig()
    masks = silhouettes(rig, capsule_person(0.4, *place))
    backend = make_backend("cpu", RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, VOXEL_M)).backend
    carved = backend.carve(masks, 2).to_dense()
    backend.close()
    assert np.array_equal(carved, carve_brute_force(rig, masks, VOXEL_M, 2))
    # the body's own points stay, though cameras do not see some of them
    points = np.concatenate([np.linspace(start, end, 9) for start, end, _ in capsule_person(0.4, *place)])
    inside = ((points > rig.volume.low + VOXEL_M) & (points < rig.volume.high - VOXEL_M)).all(axis=1)
    voxel = ((points[inside] - rig.volume.low) / VOXEL_M).astype(int)
    pixels = np.stack([camera.project(points[inside]) for camera in rig.cameras])
    size = np.array([322, 243])
    with np.errstate(invalid="ignore"):
        seeing = ((pixels > 1) & (pixels < size - 2)).all(axis=2).sum(axis=0)
    assert (seeing < 5).any() or place == (0.0, 0.0)
    assert carved[tuple(voxel[seeing >= 3].T)].mean() > 0.97
