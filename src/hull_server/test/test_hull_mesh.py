"""The hull's mesh, against shapes whose volume is known."""

import numpy as np
import pytest

from capture_rig import InputError
from hull_server.grid import BrickVolume, VoxelGrid
from hull_server.mesh import Mesh, surface_mesh, write_ply

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
        surface_mesh(BrickVolume.empty(GRID))


def test_ply_read_by_trimesh_holds_the_same_vertices_and_faces(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed (requirements-dev.txt)")
    mesh = surface_mesh(ball())
    write_ply(mesh, tmp_path / "folder" / "ball.ply")
    read = trimesh.load_mesh(str(tmp_path / "folder" / "ball.ply"), process=False)
    np.testing.assert_array_equal(read.vertices, mesh.vertices_world.astype(np.float32))
    np.testing.assert_array_equal(read.faces, mesh.faces)
    assert read.is_watertight and 1e3 * read.volume == pytest.approx(mesh.litres, rel=1e-4)


def test_ply_of_a_mesh_without_faces_is_a_header_alone(tmp_path):
    write_ply(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), tmp_path / "none.ply")
    header = (tmp_path / "none.ply").read_bytes()
    assert b"element vertex 0\n" in header and b"element face 0\n" in header and header.endswith(b"end_header\n")


def test_ply_that_cannot_be_written_says_where(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        write_ply(surface_mesh(ball()), tmp_path / "file" / "ball.ply")
