"""What bench/body_builds.py is made of: rays along an outline touch the mesh, and the table is the one that is read."""

import body_builds
import mesh_outline_rays as outline
import numpy as np
import pytest

from stick_figure import build


def test_rays_touch_a_sphere_tangentially_and_point_outward() -> None:
    random, centre, radius = np.random.default_rng(1), np.array([0.3, -0.2, 1.0]), 0.2
    vertices = outline.hull_of_spheres(centre, centre + np.array([0.0, 0.0, 1e-12]), radius, radius)
    points, directions, normals = outline.ring_of_rays(vertices, outline.SPHERE_TRIANGLES, 4, 50, random)
    off = points - centre
    distances = np.linalg.norm(np.cross(off, directions), axis=1)
    assert len(points) == 200
    assert distances == pytest.approx(radius, abs=0.009)  # the sphere has 20 corners around: flat by 2.5 mm, and pixels
    assert (np.einsum("ki,ki->k", off, normals) / distances > 0.98).all()


def test_table_is_read_as_it_was_written(tmp_path, monkeypatch) -> None:
    there = build.builds()
    columns = [there.of_length.reshape(80, 1), there.of_stature.reshape(80, 1), there.slopes.reshape(80, -1)]
    body_builds.write(tmp_path / "builds.csv", there.mean, [*columns, there.modes.reshape(80, -1)])
    assert (tmp_path / "builds.csv").read_text() == build.TABLE.read_text()
