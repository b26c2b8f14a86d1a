"""Every backend against a float64 brute force of the rule: occupied where all who see agree, and enough see."""

import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hull_graphics import needs_gl
from hull_scenes import capsule_person, carve_brute_force, look_at, ring_rig, silhouettes

from capture_rig import InputError, Rig
from hull_server.carving import make_backend
from hull_server.carving.cpu_carver import CpuCarver
from hull_server.grid import VoxelGrid
from hull_server.opengl.egl import GlContext, NoGraphics
from hull_server.views import RigViews, min_seeing

MAX_DISAGREEMENT = 1e-4  # of the occupied voxels, for backends in single precision


BACKENDS = ["cpu", pytest.param("gl", marks=needs_gl), pytest.param("sweep", marks=needs_gl)]


def carve(kind, rig, masks, voxel, needed):
    backend = make_backend(kind, RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, voxel))[0]
    volume = backend.carve(masks, needed)
    backend.close()
    return volume


def assert_agrees(kind, found, expected):
    wrong = int((found != expected).sum())
    assert wrong <= (0 if kind == "cpu" else MAX_DISAGREEMENT * expected.sum()), f"{wrong} of {expected.sum()}"


@cache
def scene(cameras, seed=0, yaw=0.0, x=0.0, y=0.0):
    """A ring rig and the silhouettes of a person; rendering them is what costs time."""
    rig = ring_rig(cameras, size=(256, 200), focal_px=188.0, seed=seed)
    return rig, silhouettes(rig, capsule_person(yaw, x, y))


@cache
def person_seen_whole():
    rig = ring_rig(6, size=(400, 300), focal_px=292.0)
    masks = silhouettes(rig, capsule_person(0.4))
    return rig, masks, carve_brute_force(rig, masks, 0.025, 4)


@pytest.mark.parametrize("kind", BACKENDS)
def test_carve_agrees_with_brute_force_on_a_person_seen_whole(kind):
    rig, masks, expected = person_seen_whole()
    assert 60 < expected.sum() * 0.025**3 * 1e3 < 120  # litres: it is a person
    assert_agrees(kind, carve(kind, rig, masks, 0.025, 4).to_dense(), expected)


@pytest.mark.parametrize("kind", BACKENDS)
def test_carve_does_not_veto_where_a_camera_is_blind(kind):
    """A camera that sees the legs only must not cut off the arms (unseen is not outside)."""
    rig, masks = scene(5, seed=1)
    tele = look_at("cam06", np.array([3.2, 0.4, 0.6]), np.array([0.0, 0.0, 0.3]), 480.0, (256, 200))
    without = carve(kind, rig, masks, 0.03, 3).to_dense()
    masks = masks | silhouettes(Rig((tele,), rig.volume), capsule_person())
    with_tele = carve(kind, Rig((*rig.cameras, tele), rig.volume), masks, 0.03, 3).to_dense()
    above, below = round((1.2 + 0.05) / 0.03), round((0.9 + 0.05) / 0.03)
    assert with_tele[:, :, above:].sum() == without[:, :, above:].sum() > 0
    assert with_tele[:, :, :below].sum() < without[:, :, :below].sum()  # where it sees, it carves


@pytest.mark.parametrize("kind", BACKENDS)
def test_carve_of_empty_silhouettes_and_of_one_camera_is_empty(kind):
    rig, masks = scene(3)
    blank = {name: np.zeros_like(mask) for name, mask in masks.items()}
    alone = {"cam02": masks["cam02"]}
    for given_masks, needed in ((blank, 2), (alone, min_seeing(1)), ({}, min_seeing(0))):
        volume = carve(kind, rig, given_masks, 0.05, needed)
        assert volume.count == 0 and len(volume.index) == 0 and not volume.to_dense().any()


@needs_gl
def test_sweep_gives_the_same_volume_whichever_axis_it_sweeps_along():
    rig, masks = scene(4, seed=7)
    backend = make_backend("sweep", RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, 0.05))[0]
    across_x, across_y, across_z = (backend.sweep(masks, 3, axis) for axis in range(3))
    assert across_z.sum() > 0
    np.testing.assert_array_equal(across_x.transpose(1, 2, 0), across_z)  # (x, z, y) to (z, y, x)
    np.testing.assert_array_equal(across_y.transpose(1, 0, 2), across_z)  # (y, z, x)
    backend.close()


def backend_of(kind, cameras=2):
    rig = ring_rig(cameras, size=(32, 24), focal_px=25.0, distortion=False)
    return make_backend(kind, RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, 0.1))


def test_without_graphics_auto_falls_back_to_the_cpu_and_a_backend_by_name_refuses_with_the_remedy(monkeypatch):
    def no_gl(self, hardware=None):
        raise NoGraphics("libEGL.so.1 is not installed")

    monkeypatch.setattr(GlContext, "__init__", no_gl)
    backend, reason = backend_of("auto")
    assert isinstance(backend, CpuCarver) and "libEGL.so.1 is not installed" in reason
    for kind in ("gl", "sweep"):
        with pytest.raises(InputError, match=rf"backend = '{kind}' .*libEGL.so.1 is not .* Choose backend 'cpu'"):
            backend_of(kind)


def test_backend_of_an_unknown_name_is_refused():
    with pytest.raises(InputError, match=r"backend = 'cuda' is not known"):
        backend_of("cuda")


def test_carve_counts_more_than_fifteen_cameras():
    """Votes are counted in binary planes of 1, 2, 4 and 8; more must not overflow."""
    rig = ring_rig(18, size=(96, 72), focal_px=75.0, seed=4, distortion=False)
    rig = Rig(tuple(replace(camera, name=f"cam{i + 1:02d}") for i, camera in enumerate(rig.cameras)), rig.volume)
    masks = silhouettes(rig, capsule_person())
    for needed in (15, 16, 17):
        expected = carve_brute_force(rig, masks, 0.05, needed)
        assert expected.sum() > 100
        assert_agrees("cpu", carve("cpu", rig, masks, 0.05, needed).to_dense(), expected)


@needs_gl
@pytest.mark.parametrize("kind", ["gl", "sweep"])
def test_gl_backends_refuse_more_cameras_than_a_shader_word_has_bits(kind):
    with pytest.raises(InputError, match=r"33 cameras .* backend 'cpu'"):
        backend_of(kind, 33)
    assert backend_of("auto", 33)[0].name == "cpu"


def test_auto_falls_back_to_the_cpu_when_pyopengl_finds_no_opengl_library(monkeypatch):
    class WithoutLibrary:
        """Stands for carve_gl where libEGL is there but libOpenGL is not: its import fails as PyOpenGL's does."""

        def __getattr__(self, name):
            if name == "GlCarver":
                raise TypeError("'NoneType' object has no attribute 'glGetError'")
            raise AttributeError(name)

    monkeypatch.setitem(sys.modules, "hull_server.opengl.gl_carver", WithoutLibrary())
    backend, reason = backend_of("auto")
    assert backend.name == "cpu" and "apt install libopengl0" in reason
