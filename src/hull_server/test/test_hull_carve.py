"""The CPU's carve against a float64 brute force of the rule: occupied where all who see agree, and enough see; the
choice of a backend, and the sweep. The compute carve is held to the CPU's bytes in test_hull_gl.py."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from hull_graphics import needs_gl
from hull_scenes import capsule_person, carve_brute_force, look_at, ring_rig, silhouettes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from capture_rig import InputError, Rig, Volume
from hull_server.carving import make_backend
from hull_server.carving.cpu_carver import CpuCarver
from hull_server.grid import VoxelGrid
from hull_server.opengl.egl import GlContext, NoGraphics
from hull_server.views import RigViews


@needs_gl
def test_sweep_gives_the_same_volume_whichever_axis_it_sweeps_along():
    rig = ring_rig(4, size=(256, 200), focal_px=188.0, seed=7)
    masks = silhouettes(rig, capsule_person())
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


def test_carve_counts_more_than_fifteen_cameras():
    """Votes are counted in binary planes of 1, 2, 4 and 8; more must not overflow."""
    rig = ring_rig(18, size=(96, 72), focal_px=75.0, seed=4, distortion=False)
    rig = Rig(tuple(replace(camera, name=f"cam{i + 1:02d}") for i, camera in enumerate(rig.cameras)), rig.volume)
    masks = silhouettes(rig, capsule_person())
    carver = CpuCarver(RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, 0.05))
    for needed in (15, 16, 17):
        expected = carve_brute_force(rig, masks, 0.05, needed)
        assert expected.sum() > 100
        assert np.array_equal(carver.carve(masks, needed).to_dense(), expected)


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


some_examples = settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


def tumbled_camera(rng, name, size, spread_m):
    """A camera anywhere within ``spread_m`` of the volume's middle, rolled at will, that looks roughly at it."""
    centre = np.array([0.0, 0.0, 1.0]) + rng.uniform(-spread_m, spread_m, 3)
    target = np.array([0.0, 0.0, 1.0]) + rng.uniform(-0.5, 0.5, 3)
    camera = look_at(name, centre, target, size[0] * rng.uniform(0.4, 2.5), size)
    roll = rng.uniform(-np.pi, np.pi)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]]
    D = np.array([rng.uniform(-0.2, 0.05), 0.0, 1e-3, -1e-3, 0.0]) * rng.integers(0, 2)
    return replace(camera, T_camera_world=turn @ camera.T_camera_world, D=D)


def random_mask(rng, shape):
    """Foreground and uncertain pixels from few to nearly all, in speckles or in boxes."""
    if rng.integers(0, 4) == 0:
        return np.where(rng.random(shape) < rng.choice([0.02, 0.5, 0.98]), rng.integers(2, 256), 0).astype(np.uint8)
    mask = np.full(shape, rng.choice([0, 255, 255]), np.uint8)
    for _ in range(6):
        (top, left), side = rng.integers(0, shape), rng.integers(1, max(shape) // 2)
        mask[top : top + side, left : left + side] = rng.choice([0, rng.integers(2, 256)])
    return mask


@some_examples
@given(seed=st.integers(0, 100_000), cameras=st.integers(2, 9), spread_m=st.sampled_from([0.6, 2.0, 4.0]))
def test_cpu_carve_is_exact_for_any_cameras_and_any_masks(seed, cameras, spread_m):
    """Cameras inside and outside the volume, tumbled, wide and long; masks that no body casts, also where unseen."""
    rng = np.random.default_rng(seed)
    size = (int(rng.integers(40, 130)), int(rng.integers(30, 100)))
    middle = np.array([0.0, 0.0, 1.0])
    volume = Volume(middle - rng.uniform(0.4, 1.2, 3), middle + rng.uniform(0.3, 1.2, 3))
    rig = Rig(tuple(tumbled_camera(rng, f"cam{i:02d}", size, spread_m) for i in range(cameras)), volume)
    voxel, needed = rng.uniform(0.05, 0.12), int(rng.integers(2, cameras // 2 + 2))
    carver = CpuCarver(RigViews.from_rig(rig), VoxelGrid.covering(volume, voxel))
    for lost, vetoes in ((0, 0), (int(rng.integers(0, cameras)), int(rng.integers(0, 2)))):
        # the second frame set finds what the first one left behind
        shapes = {c.name: c.undistorted_view().seen.shape for c in rig.cameras[lost:]}
        masks = {name: random_mask(rng, shape) for name, shape in shapes.items()}
        found = carver.carve(masks, needed, vetoes=vetoes)
        assert np.array_equal(found.to_dense(), carve_brute_force(rig, masks, voxel, needed, vetoes))
        assert np.all(np.diff(found.index.astype(np.int64)) > 0) and found.leaves.any(axis=1).all()


def test_cpu_carve_gives_the_same_bytes_whatever_the_order_and_the_memory_of_the_masks():
    rig = ring_rig(5, size=(192, 150), focal_px=140.0, seed=2)
    masks = silhouettes(rig, capsule_person(0.3))
    carver = CpuCarver(RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, 0.03))
    first = carver.carve(masks, 3)
    kept = first.leaves.copy()
    backwards = {name: np.asfortranarray(masks[name] // 255 * np.uint8(128)) for name in reversed(masks)}
    again = carver.carve(backwards, 3)
    assert first.index.tobytes() == again.index.tobytes() and first.leaves.tobytes() == again.leaves.tobytes()
    carver.carve({name: np.zeros_like(mask) for name, mask in masks.items()}, 3)
    assert np.array_equal(first.leaves, kept) and kept.any()  # a result is not overwritten by later ones


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


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.7, -0.6)])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_carving_is_exact_and_a_folded_corner_vetoes_nothing(place):
    rig = folding_rig()
    masks = silhouettes(rig, capsule_person(0.4, *place))
    carver = CpuCarver(RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, 0.04))
    carved = carver.carve(masks, 2).to_dense()
    assert np.array_equal(carved, carve_brute_force(rig, masks, 0.04, 2))
    # the body's own points stay, though cameras do not see some of them
    points = np.concatenate([np.linspace(start, end, 9) for start, end, _ in capsule_person(0.4, *place)])
    inside = ((points > rig.volume.low + 0.04) & (points < rig.volume.high - 0.04)).all(axis=1)
    voxel = ((points[inside] - rig.volume.low) / 0.04).astype(int)
    pixels = np.stack([camera.project(points[inside]) for camera in rig.cameras])
    size = np.array([322, 243])
    with np.errstate(invalid="ignore"):
        seeing = ((pixels > 1) & (pixels < size - 2)).all(axis=2).sum(axis=0)
    assert (seeing < 5).any() or place == (0.0, 0.0)
    assert carved[tuple(voxel[seeing >= 3].T)].mean() > 0.97
