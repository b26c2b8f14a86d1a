"""The CPU backend in every corner: exact to the voxel, whatever the rig, and the same whatever the order."""

from dataclasses import replace

import numpy as np
import pytest
from hull_scenes import capsule_person, carve_brute_force, look_at, ring_rig, silhouettes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from capture_rig import Rig, Volume
from hull_server.carving.cpu_carver import CpuCarver
from hull_server.carving.silhouette_tables import BACKGROUND, BLIND, FOREGROUND, SURE, UNSURE, Tabulator
from hull_server.grid import VoxelGrid
from hull_server.views import RigViews

some_examples = settings(max_examples=50, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


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
        return np.where(rng.random(shape) < rng.choice([0.02, 0.5, 0.98]), rng.integers(1, 256), 0).astype(np.uint8)
    mask = np.full(shape, rng.choice([0, 255, 255]), np.uint8)
    for _ in range(6):
        (top, left), side = rng.integers(0, shape), rng.integers(1, max(shape) // 2)
        mask[top : top + side, left : left + side] = rng.choice([0, rng.integers(1, 256)])
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
    for lost in (0, int(rng.integers(0, cameras))):  # the second frame set finds what the first one left behind
        shapes = {c.name: c.undistorted_view().seen.shape for c in rig.cameras[lost:]}
        masks = {name: random_mask(rng, shape) for name, shape in shapes.items()}
        found = carver.carve(masks, needed)
        assert np.array_equal(found.to_dense(), carve_brute_force(rig, masks, voxel, needed))
        assert np.all(np.diff(found.index.astype(np.int64)) > 0) and found.leaves.any(axis=1).all()


@pytest.mark.parametrize("voxel", [0.02, 0.07])
def test_cpu_carve_of_a_person_is_exact_for_small_and_large_voxels(voxel):
    rig = ring_rig(5, size=(320, 240), focal_px=235.0, seed=8)
    masks = silhouettes(rig, capsule_person(0.9, 0.1, -0.2))
    expected = carve_brute_force(rig, masks, voxel, 3)
    assert 60 < expected.sum() * voxel**3 * 1e3 < 160  # litres
    carver = CpuCarver(RigViews.from_rig(rig), VoxelGrid.covering(rig.volume, voxel))
    assert np.array_equal(carver.carve(masks, 3).to_dense(), expected)


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


def test_tabulator_labels_and_sums_the_last_silhouette_of_each_camera():
    rng = np.random.default_rng(5)
    height, width = 40, 96
    seen = np.where(rng.random((2, height, width)) < 0.8, 255, 0).astype(np.uint8)
    seen[1, :, 64:] = 0  # a smaller canvas, padded
    tabulator = Tabulator(seen)
    for _ in range(4):
        for camera, columns in ((0, 96), (1, 64)):
            mask = random_mask(rng, (height, columns))
            filled = tabulator.tabulate(camera, mask)
            expected = np.zeros((height, width), np.uint8)
            expected[:, :columns] = np.where(seen[camera, :, :columns] > 0, mask, 0)
            assert_tabulated(tabulator, camera, expected, seen[camera] > 0, filled)


def assert_tabulated(tabulator, camera, evidence, seen, filled):
    """Labels and sums agree with plain NumPy."""
    labels = tabulator.labels[camera, :-8].reshape(seen.shape)
    certain = np.where(evidence > 127, FOREGROUND, np.where(evidence > 0, BLIND, BACKGROUND))
    assert np.array_equal(labels, np.where(seen, certain, BLIND))
    u0, v0, u1, v1 = tabulator.box[camera]
    counts = np.where(evidence > 127, SURE, np.where(evidence > 0, UNSURE, 0))
    inside = counts[v0:v1, u0:u1]
    assert filled == inside.sum() == counts.sum()
    assert tabulator.uncertain[camera] == (inside == UNSURE).any()
    table = tabulator.table[camera, : (v1 - v0 + 1) * (u1 - u0 + 1)].reshape(v1 - v0 + 1, u1 - u0 + 1)
    assert np.array_equal(table[1:, 1:], inside.cumsum(axis=0).cumsum(axis=1))
    assert not table[0].any() and not table[:, 0].any()
