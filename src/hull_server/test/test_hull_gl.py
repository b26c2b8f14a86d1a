"""The compute carve: the same bytes as the CPU and the sweep on anything, exact as float64."""

from functools import cache

import numpy as np
import pytest
from hull_graphics import NO_GL, needs_gl
from hull_scenes import capsule_person, carve_brute_force, look_at, ring_rig, silhouettes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from capture_rig import InputError, Rig, Volume
from hull_server.carving.cpu_carver import CpuCarver
from hull_server.grid import VoxelGrid
from hull_server.opengl.egl import NoGraphics
from hull_server.views import RigViews

pytestmark = needs_gl
if not NO_GL:
    from hull_server.opengl import gl_buffers
    from hull_server.opengl.gl_carver import GlCarver
    from hull_server.thesis_plane_sweep import PlaneSweepCarver


def same_bytes(one, other):
    return one.index.tobytes() == other.index.tobytes() and one.leaves.tobytes() == other.leaves.tobytes()


@cache
def scene(poses=6):
    """A rig of five cameras, a grid that ends inside its bricks, and silhouettes of a person who moves and turns."""
    rig = ring_rig(5, size=(256, 200), focal_px=188.0)
    grid = VoxelGrid.covering(rig.volume, 0.043)
    assert all(count % 8 for count in grid.shape)
    return rig, grid, [silhouettes(rig, capsule_person(0.5 * i, 0.1 * i - 0.3, 0.2)) for i in range(poses)]


@cache
def expected():
    rig, grid, frames = scene()
    cpu = CpuCarver(RigViews.from_rig(rig), grid)
    return [cpu.carve(masks, 3) for masks in frames]


@pytest.fixture
def carver():
    rig, grid, _ = scene()
    carver = GlCarver(RigViews.from_rig(rig), grid)
    yield carver
    carver.close()


@settings(max_examples=8, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_gl_cpu_and_sweep_give_the_same_bytes_on_random_rigs_poses_noise_and_cut_views(data):
    """One carver each for a sequence of frame sets, cameras coming and going, so that nothing may be left over."""
    seed = data.draw(st.integers(0, 9999))
    rng = np.random.default_rng(seed)
    cameras = data.draw(st.integers(2, 8))
    focal_px = data.draw(st.sampled_from([110.0, 170.0, 330.0]))  # the longest sees only part of the body
    up = np.array([0.0, 0.0, 1.0])
    volume = Volume(rng.uniform(-1.0, -0.6, 3) + 0.9 * up, rng.uniform(0.5, 0.9, 3) + 1.1 * up)
    rig = ring_rig(cameras, size=(200, 150), focal_px=focal_px, seed=seed, volume=volume)
    if data.draw(st.booleans()):  # one camera inside the volume
        centre = rng.uniform(-0.4, 0.4, 3) + up
        inside = look_at("inside", centre, np.array([0.1, -0.5, 0.8]), 120.0, (192, 150))
        rig = Rig((*rig.cameras, inside), volume)
    views, grid = RigViews.from_rig(rig), VoxelGrid.covering(volume, data.draw(st.sampled_from([0.036, 0.047])))
    backends = [CpuCarver(views, grid), GlCarver(views, grid), PlaneSweepCarver(views, grid)]
    for _ in range(3):
        masks = silhouettes(rig, capsule_person(*rng.uniform(-0.6, 0.6, 3)))
        noise = data.draw(st.sampled_from([0.0, 0.01, 0.3]))
        masks = {name: np.where(rng.random(m.shape) < noise, 255 - m, m).astype(np.uint8) for name, m in masks.items()}
        for name in rng.permutation(rig.names)[: data.draw(st.integers(0, 2))]:
            masks[name] = np.zeros_like(masks[name]) if data.draw(st.booleans()) else np.full_like(masks[name], 2)
        for name in rng.permutation(rig.names)[: data.draw(st.integers(0, cameras - 1))]:
            del masks[name]
        needed = data.draw(st.integers(2, cameras))
        cpu, *others = (backend.carve(masks, needed) for backend in backends)
        assert all(same_bytes(cpu, other) for other in others)
    for backend in backends:
        backend.close()


@pytest.mark.slow
def test_gl_places_every_voxel_as_float64_does_where_single_precision_does_not():
    """Silhouettes of random pixels: a voxel on the wrong side of any pixel border shows."""
    volume = Volume(np.array([-0.6, -0.5, 0.4]), np.array([0.6, 0.5, 1.6]))
    rig = ring_rig(3, size=(1280, 1024), focal_px=2400.0, seed=4, distortion=False, volume=volume)
    views, grid = RigViews.from_rig(rig), VoxelGrid.covering(volume, 0.012)
    rng = np.random.default_rng(1)
    masks = {n: 255 * rng.integers(0, 2, (h, w), np.uint8) for n, (w, h) in zip(views.names, views.sizes, strict=True)}
    centres = np.c_[grid.centres_world(np.indices(grid.shape).reshape(3, -1).T), np.ones(np.prod(grid.shape))]
    h64 = centres @ views.P[0].T
    h32 = centres.astype(np.float32) @ views.P[0].T.astype(np.float32)
    pixel64, pixel32 = np.floor(h64[:, :2] / h64[:, 2:] + 0.5), np.floor(h32[:, :2] / h32[:, 2:] + np.float32(0.5))
    assert (pixel64 != pixel32).any(axis=1).sum() > 20  # single precision alone would not do
    carver = GlCarver(views, grid)
    found = carver.carve(masks, 3).to_dense()
    carver.close()
    wanted = carve_brute_force(rig, masks, 0.012, 3)
    assert 0.02 < wanted.mean() < 0.2 and np.array_equal(found, wanted)


def test_gl_carves_a_full_volume_and_an_empty_one():
    rig, grid, _ = scene()
    views = RigViews.from_rig(rig)
    carver, cpu = GlCarver(views, grid), CpuCarver(views, grid)
    full = {name: np.full((h, w), 255, np.uint8) for name, (w, h) in zip(views.names, views.sizes, strict=True)}
    everything = carver.carve(full, 2)
    assert everything.count > 0.9 * np.prod(grid.shape) and same_bytes(everything, cpu.carve(full, 2))
    assert carver.carve({name: 0 * mask for name, mask in full.items()}, 2).count == 0
    assert carver.carve({}, 2).count == 0
    carver.close()


def test_gl_works_through_lists_that_are_longer_than_one_row_of_work_groups(monkeypatch):
    monkeypatch.setattr("hull_server.opengl.gl_carver.GROUPS_IN_ROW", 3)
    rig, grid, frames = scene()
    carver = GlCarver(RigViews.from_rig(rig), grid)
    assert all(same_bytes(carver.carve(masks, 3), wanted) for masks, wanted in zip(frames, expected(), strict=True))
    carver.close()


def test_masks_may_be_reused_after_each_carve_and_sets_with_fewer_bricks_leave_none_behind(carver):
    _, _, frames = scene()
    few = {name: np.zeros_like(mask) for name, mask in frames[0].items()}
    masks = {name: mask.copy() for name, mask in frames[0].items()}
    for frame, wanted in zip(frames, expected(), strict=True):
        for name, mask in masks.items():
            mask[:] = frame[name]
        assert same_bytes(carver.carve(masks, 3), wanted) and len(wanted.index) > 10
        assert carver.carve(few, 3).count == 0


def test_device_that_does_not_finish_is_no_graphics_and_may_be_asked_again(carver, monkeypatch):
    _, _, frames = scene()
    with monkeypatch.context() as stuck:
        stuck.setattr(gl_buffers.GL, "glClientWaitSync", lambda *args: gl_buffers.GL.GL_TIMEOUT_EXPIRED)
        with pytest.raises(NoGraphics, match=r"did not finish a carve within 10 s; choose backend 'cpu'"):
            carver.carve(frames[2], 3)
    assert same_bytes(carver.carve(frames[2], 3), expected()[2])


def test_grid_or_silhouettes_beyond_the_shaders_limits_are_refused_with_the_remedy(monkeypatch):
    rig, grid, _ = scene()
    views = RigViews.from_rig(rig)
    fine = VoxelGrid(grid.origin, grid.voxel_size, (8 * 200, 8 * 200, 8 * 100))
    monkeypatch.setattr("hull_server.opengl.gl_carver.GL.glGetIntegerv", lambda name: 1 << 27)
    with pytest.raises(InputError, match=r"bytes for a table of the voxels; .* larger voxels"):
        GlCarver(views, fine)
    monkeypatch.setattr("hull_server.opengl.gl_carver.GL.glGetIntegerv", lambda name: 65536)
    with pytest.raises(InputError, match=r"words for all silhouettes; .* allows 65536.*backend 'cpu'"):
        GlCarver(views, VoxelGrid(grid.origin, grid.voxel_size, (16, 16, 16)))
