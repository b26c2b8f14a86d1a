"""The voxel grid, the brick format, and the rule how many cameras must see a voxel."""

import numpy as np
import pytest
from hull_scenes import VOLUME, ring_rig
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_rig import InputError, Volume
from hull_server.grid import BrickVolume, VoxelGrid
from hull_server.views import RigViews


def test_grid_covers_the_volume_and_centres_lie_half_a_voxel_inside():
    grid = VoxelGrid.covering(Volume(np.array([-1.0, 0.5, 0.0]), np.array([1.01, 1.5, 0.3])), 0.1)
    assert grid.shape == (21, 10, 3)
    np.testing.assert_allclose(grid.centres_world([[0, 0, 0], [20, 9, 2]]), [[-0.95, 0.55, 0.05], [1.05, 1.45, 0.25]])


def test_grid_refuses_a_voxel_size_that_gives_too_many_voxels():
    with pytest.raises(InputError, match=r"voxel_size_m = 0.001 .* Use larger voxels"):
        VoxelGrid.covering(VOLUME, 0.001)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    shape=st.tuples(*[st.integers(1, 20)] * 3), share=st.sampled_from([0.0, 0.02, 0.5, 1.0]), seed=st.integers(0, 99)
)
def test_bricks_round_trip_dense_occupancy(shape, share, seed):
    grid = VoxelGrid(np.zeros(3), 0.05, shape)
    dense = np.random.default_rng(seed).random(shape) < share
    volume = BrickVolume.from_dense(grid, dense)
    assert np.array_equal(volume.to_dense(), dense)
    assert volume.count == dense.sum()
    assert (np.diff(volume.index.astype(int)) > 0).all() and volume.leaves.any(axis=1).all()


def test_bricks_voxel_centres_are_those_of_the_occupied_cells():
    grid = VoxelGrid(np.array([1.0, 2.0, 3.0]), 0.1, (12, 9, 17))
    dense = np.zeros(grid.shape, bool)
    dense[11, 8, 16] = dense[0, 0, 0] = dense[3, 8, 2] = True
    centres = BrickVolume.from_dense(grid, dense).centres_world()
    expected = grid.origin + (np.argwhere(dense) + 0.5) * 0.1
    np.testing.assert_allclose(np.sort(centres, axis=0), np.sort(expected, axis=0))
    assert BrickVolume.from_dense(grid, dense).litres == pytest.approx(3.0)


def test_views_refuse_a_rig_with_one_camera_and_masks_that_do_not_fit():
    rig = ring_rig(3)
    with pytest.raises(InputError, match=r"1 camera\(s\); a visual hull needs 2"):
        RigViews.from_rig(type(rig)(rig.cameras[:1], rig.volume))
    views = RigViews.from_rig(rig)
    with pytest.raises(InputError, match=r"no camera 'cam09'"):
        views.present({"cam09": np.zeros((2, 2), np.uint8)})
    with pytest.raises(InputError, match=r"cam01: the mask is \(2, 2\) uint8"):
        views.present({"cam01": np.zeros((2, 2), np.uint8)})
