"""Blobs of all slices against OpenCV's components and plain moments; samples; which blobs become centerline points."""

import cv2
import numpy as np
import pytest
from hull_scenes import distance_to_axes, ring_rig, silhouettes, volume_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from capture_rig import Volume
from hull_server.carving import make_backend
from hull_server.grid import VoxelGrid
from hull_server.settings import BlobSettings
from hull_server.slicing.skeletonisation import GROWTH_STEP_M, BlobTable, find_centerline, shape_of, slice_hull
from hull_server.slicing.voxel_runs import sample_runs
from hull_server.views import RigViews


def sample_voxels(volume, max_voxels):
    return sample_runs(slice_hull(volume)[1], volume.grid, max_voxels)


def oracle_blobs(dense: np.ndarray) -> np.ndarray:
    """(n, 8) axis, i, j, k, area, uu, vv, uv of all blobs, found slice by slice with OpenCV and plain sums."""
    found = []
    for axis in range(3):
        for number in range(dense.shape[axis]):
            image = np.ascontiguousarray(dense.take(number, axis=axis), np.uint8)
            count, labels = cv2.connectedComponents(image, connectivity=8)
            for label in range(1, count):
                u, v = np.nonzero(labels == label)
                centroid = np.insert([u.mean(), v.mean()], axis, number)
                moments = [u.var(), v.var(), ((u - u.mean()) * (v - v.mean())).mean()]
                found.append([axis, *centroid, len(u), *moments])
    return np.array(found, float).reshape(-1, 8)


def in_order(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort(np.round(rows, 6).T[::-1])]


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    shape=st.tuples(st.integers(1, 90), st.integers(1, 20), st.integers(1, 20)),
    share=st.sampled_from([0.02, 0.3, 0.6, 0.97]),
    turned=st.booleans(),
    seed=st.integers(0, 99),
)
def test_blobs_equal_opencv_components_and_moments_on_random_volumes(shape, share, turned, seed):
    dense = np.random.default_rng(seed).random(shape[::-1] if turned else shape) < share
    blobs = slice_hull(volume_of(dense))[0]
    rows = np.column_stack([blobs.axis, blobs.centroid, blobs.area, blobs.covariance])
    np.testing.assert_allclose(in_order(rows), in_order(oracle_blobs(dense)), atol=1e-9)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    shape=st.tuples(st.integers(1, 90), st.integers(1, 20), st.integers(1, 20)),
    share=st.sampled_from([0.3, 0.6, 0.97]),
    step=st.integers(1, 3),
    seed=st.integers(0, 99),
)
def test_growth_equals_that_of_labelled_slices(shape, share, step, seed):
    """The blob under the rounded centroid, ``step`` slices to either side, found in images of labels."""
    dense = np.random.default_rng(seed).random(shape) < share
    blobs = slice_hull(volume_of(dense, GROWTH_STEP_M / step))[0]
    labels = [label_slices(dense, axis) for axis in range(3)]
    for axis, area, centroid, growth in zip(blobs.axis, blobs.area, blobs.centroid, blobs.growth, strict=True):
        place = np.floor(centroid + 0.5).astype(int)
        areas = []
        for move in (-step, step):
            place[axis] = round(centroid[axis]) + move
            inside = 0 <= place[axis] < dense.shape[axis]
            found = labels[axis][tuple(place)] if inside else 0
            areas.append((labels[axis].take(place[axis], axis=axis) == found).sum() if found else np.inf)
        assert growth == pytest.approx(max(areas) / area)


def label_slices(dense: np.ndarray, axis: int) -> np.ndarray:
    """Labels of 8-connected components, slice by slice, 0 where empty."""
    slices = [cv2.connectedComponents(np.ascontiguousarray(s, np.uint8))[1] for s in np.moveaxis(dense, axis, 0)]
    return np.stack(slices, axis=axis)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    shape=st.tuples(st.integers(1, 70), st.integers(1, 20), st.integers(1, 20)),
    share=st.sampled_from([0.03, 0.1, 0.3]),
    seed=st.integers(0, 99),
)
def test_parts_equal_scipy_components(shape, share, seed):
    dense = np.random.default_rng(seed).random(shape) < share
    volume = volume_of(dense)
    near = np.abs(np.indices((3, 3, 3)) - 1)
    expected, count = ndimage.label(dense, (near[1] == 0) | (near[2] == 0))  # in a slice across y or z
    samples = sample_voxels(volume, dense.size)
    assert len(samples) == dense.sum()
    voxels = np.round((samples.points_world - volume.grid.origin) / 0.02 - 0.5).astype(int)
    pairs = set(zip(expected[tuple(voxels.T)].tolist(), samples.body.tolist(), strict=True))
    assert len(pairs) == count == len({part for _, part in pairs})
    label_of_part = {part: label for label, part in pairs}
    blobs = slice_hull(volume)[0]
    for axis in range(3):  # the label of any voxel of a blob's slice at its part is one of that part
        for part, centroid, area in zip(
            *(c[blobs.axis == axis] for c in (blobs.part, blobs.centroid, blobs.area)), strict=True
        ):
            if area == 1:
                assert expected[tuple(np.round(centroid).astype(int))] == label_of_part[part]


@pytest.mark.parametrize(("a", "b", "turn"), [(20, 20, 0), (40, 20, 0.5), (30, 12, 1.2), (6, 6, 0)])
def test_elongation_and_fill_of_an_ellipse(a, b, turn):
    """One slice with half axes a, b (voxels)."""
    x, y = np.meshgrid(np.arange(121) - 60.3, np.arange(121) - 59.6, indexing="ij")
    u, v = x * np.cos(turn) + y * np.sin(turn), -x * np.sin(turn) + y * np.cos(turn)
    blobs = slice_hull(volume_of(((u / a) ** 2 + (v / b) ** 2 <= 1)[:, :, None]))[0]
    index = np.flatnonzero(blobs.axis == 2)[0]
    elongation, fill = shape_of(blobs.area[index], *blobs.covariance[index])
    assert elongation == pytest.approx(a / b, rel=0.03)
    assert fill == pytest.approx(1.0, abs=0.02)
    assert blobs.centroid[index] == pytest.approx([60.3, 59.6, 0], abs=0.1)


def ball(radius: float = 11.0) -> np.ndarray:
    i, j, k = np.indices((30, 30, 30))
    return (i - 15) ** 2 + (j - 14) ** 2 + (k - 13) ** 2 <= radius**2


def test_samples_are_voxels_of_the_hull_and_say_which_lie_on_its_surface():
    dense = ball()
    volume = volume_of(dense)
    samples = sample_voxels(volume, 10**6)
    voxels = np.round((samples.points_world - volume.grid.origin) / 0.02 - 0.5).astype(int)
    assert np.array_equal(np.unique(voxels, axis=0), np.argwhere(dense))
    on_surface = dense & ~ndimage.binary_erosion(dense)
    assert np.array_equal(samples.surface, on_surface[tuple(voxels.T)])


@pytest.mark.parametrize("count", [300, -1, -100, 0])
def test_samples_are_limited_different_and_spread_out(count):
    """Negative: so many fewer than there are."""
    dense = ball()
    volume, wanted = volume_of(dense), count if count >= 0 else int(dense.sum()) + count
    samples = sample_voxels(volume, wanted)
    assert len(np.unique(samples.points_world, axis=0)) == len(samples) == wanted
    if count == 300:
        assert samples.surface.sum() == 200
    centre = volume.grid.centres_world([15, 14, 13])
    for part in (samples.surface, ~samples.surface):  # the mean is the ball's centre, no octant is empty
        if part.any():
            offsets = samples.points_world[part] - centre
            assert np.linalg.norm(offsets.mean(axis=0)) < 0.02
            assert np.unique(offsets > 0, axis=0).shape[0] == 8


EVERYTHING = BlobSettings(min_area_m2=0.0, max_elongation=1e9, min_fill=0.0, max_growth=0.0)
SHAPE_ALONE = BlobSettings(max_elongation=2.0, max_growth=0.0)


def test_centerline_of_an_upright_cylinder_is_its_axis():
    x, y = np.meshgrid(np.arange(40), np.arange(40), indexing="ij")
    volume = volume_of(np.repeat(((x - 19.5) ** 2 + (y - 21.5) ** 2 <= 7.0**2)[:, :, None], 60, axis=2))
    line = find_centerline(slice_hull(volume)[0], volume.grid, BlobSettings())
    assert (line.axis == 2).all()  # cut lengthwise it is four times as long as wide
    axis_world = volume.grid.centres_world([[19.5, 21.5, k] for k in range(1, 59)])  # all but the ends
    np.testing.assert_allclose(line.points_world, axis_world, atol=1e-9)
    assert line.area_m2 == pytest.approx(np.pi * 0.14**2, rel=0.03)  # radius 7 voxels of 20 mm
    assert line.sigma == pytest.approx(0.008, abs=5e-4)


def test_centerline_filters_drop_small_long_and_concave_blobs():
    dense = np.zeros((120, 60, 1), bool)
    dense[0:10, 0:10] = True  # a limb: 400 cm2
    dense[20:22, 0:2] = True  # 16 cm2: too small
    dense[30:32, 0:3] = True  # 24 cm2: large enough, 1.5 long
    dense[40:70, 0:10] = True  # three times as long as wide
    dense[80:110, 0:4] = dense[80:84, 0:30] = True  # an L
    volume = volume_of(dense)
    blobs = slice_hull(volume)[0]
    flat = BlobTable(*(column[blobs.axis == 2] for column in blobs))
    line = find_centerline(flat, volume.grid, SHAPE_ALONE)
    np.testing.assert_allclose(line.points_world, volume.grid.centres_world([[4.5, 4.5, 0], [30.5, 1, 0]]), atol=1e-9)
    assert len(find_centerline(flat, volume.grid, EVERYTHING)) == 5


@pytest.mark.parametrize("voxel", [0.02, 0.01])
def test_slices_off_a_ball_are_dropped_by_growth_and_not_by_shape(voxel):
    """A head: slices near its sides are round, convex and large enough, and lie far from its middle."""
    size = round(0.30 / voxel)
    i, j, k = np.indices((size, size, size)) - (size - 1) / 2
    volume = volume_of(i**2 + j**2 + k**2 <= (0.095 / voxel) ** 2, voxel)
    middle = volume.grid.centres_world(np.full(3, (size - 1) / 2))
    blobs = slice_hull(volume)[0]
    by_shape, by_growth = (find_centerline(blobs, volume.grid, f) for f in (SHAPE_ALONE, BlobSettings()))
    farthest = [np.linalg.norm(line.points_world - middle, axis=1).max() for line in (by_shape, by_growth)]
    assert farthest[0] >= 0.0799 and farthest[1] <= farthest[0] - 0.015
    assert len(by_growth) > len(by_shape) / 2


def test_centerline_of_carved_limbs_lies_on_their_axes_within_sigma():
    """An upright, a level and a slanted limb, far apart, seen by eight cameras: points on the axes, sigma honest."""
    limbs = [
        (np.array([0.0, 0.0, 0.2]), np.array([0.0, 0.0, 1.0]), 0.07),
        (np.array([-0.4, 0.35, 1.5]), np.array([0.4, 0.35, 1.5]), 0.05),
        (np.array([0.3, -0.5, 0.5]), np.array([0.6, -0.5, 1.1]), 0.05),
    ]
    rig = ring_rig(8, size=(640, 480), focal_px=470.0, volume=Volume(np.full(3, -1.0), np.array([1.0, 1.0, 2.1])))
    grid = VoxelGrid.covering(rig.volume, 0.02)
    backend = make_backend("cpu", RigViews.from_rig(rig), grid)[0]
    line = find_centerline(slice_hull(backend.carve(silhouettes(rig, limbs), 5))[0], grid, BlobSettings())
    gaps = distance_to_axes(line.points_world, limbs)
    nearest, gap = gaps.argmin(axis=0), gaps.min(axis=0)
    assert gap.mean() < 0.008 and (gap > 0.06).mean() < 0.03
    good = gap < 0.06
    assert 0.3 < np.sqrt((gap[good] ** 2 / line.sigma[good] ** 2).mean() / 2) < 1.5
    for limb, (start, end, _) in enumerate(limbs):
        mine = line.points_world[nearest == limb]
        reach = (mine - start) @ (end - start) / ((end - start) @ (end - start))
        assert np.diff(np.sort(np.concatenate([[0.0], reach, [1.0]]))).max() * np.linalg.norm(end - start) < 0.1
