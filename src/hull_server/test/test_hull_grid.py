"""The voxel grid, the brick format, and the hull's mesh against shapes whose volume is known."""

import numpy as np
import pytest
from hull_scenes import VOLUME, ring_rig
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_rig import InputError, Volume
from hull_server.grid import BrickVolume, VoxelGrid
from hull_server.mesh import surface_mesh, write_ply
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


def test_views_refuse_a_rig_with_one_camera_and_masks_that_do_not_fit():
    rig = ring_rig(3)
    with pytest.raises(InputError, match=r"1 camera\(s\); a visual hull needs 2"):
        RigViews.from_rig(type(rig)(rig.cameras[:1], rig.volume))
    views = RigViews.from_rig(rig)
    with pytest.raises(InputError, match=r"no camera 'cam09'"):
        views.present({"cam09": np.zeros((2, 2), np.uint8)})
    with pytest.raises(InputError, match=r"cam01: the mask is \(2, 2\) uint8"):
        views.present({"cam01": np.zeros((2, 2), np.uint8)})


# --- the mesh ---------------------------------------------------------------------------------------------------------

GRID = VoxelGrid(np.array([-0.5, 0.2, 0.1]), 0.02, (60, 50, 70))
CENTRE_WORLD, RADIUS_M = np.array([0.1, 0.7, 0.8]), 0.3


def ball(grid: VoxelGrid = GRID) -> BrickVolume:
    centres = grid.centres_world(np.indices(grid.shape).reshape(3, -1).T)
    return BrickVolume.from_dense(grid, (np.linalg.norm(centres - CENTRE_WORLD, axis=1) < RADIUS_M).reshape(grid.shape))


@pytest.mark.parametrize("smoothing_voxels", [0.0, 1.0])
def test_mesh_of_a_ball_has_its_volume_and_lies_on_its_surface(smoothing_voxels):
    mesh = surface_mesh(ball(), smoothing_voxels)
    true_litres = 4 / 3 * np.pi * RADIUS_M**3 * 1e3
    assert mesh.litres == pytest.approx(true_litres, rel=0.02)  # positive: the faces look outwards
    distances_m = np.linalg.norm(mesh.vertices_world - CENTRE_WORLD, axis=1)
    assert np.abs(distances_m - RADIUS_M).max() < GRID.voxel_size


def test_mesh_is_closed_even_where_the_hull_ends_with_the_grid():
    everything = BrickVolume.from_dense(GRID, np.ones(GRID.shape, bool))
    mesh = surface_mesh(everything)
    edges = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    _, shared_by = np.unique(edges, axis=0, return_counts=True)
    assert (shared_by == 2).all()
    assert mesh.litres == pytest.approx(everything.litres, rel=0.005)


def test_mesh_of_an_empty_hull_is_refused_with_a_remedy():
    with pytest.raises(InputError, match="empty"):
        surface_mesh(BrickVolume.from_dense(GRID, np.zeros(GRID.shape, bool)))


def test_ply_read_by_trimesh_holds_the_same_vertices_and_faces(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed (requirements-dev.txt)")
    mesh = surface_mesh(ball())
    write_ply(mesh, tmp_path / "folder" / "ball.ply")
    read = trimesh.load_mesh(str(tmp_path / "folder" / "ball.ply"), process=False)
    np.testing.assert_array_equal(read.vertices, mesh.vertices_world.astype(np.float32))
    np.testing.assert_array_equal(read.faces, mesh.faces)
    assert read.is_watertight and 1e3 * read.volume == pytest.approx(mesh.litres, rel=1e-4)
