"""Which blobs become centerline points, where the points lie, and what sigma says about them."""

import numpy as np
import pytest
from hull_scenes import distance_to_axes, ring_rig, silhouettes, volume_of

from capture_rig import Volume
from hull_server.carving import make_backend
from hull_server.grid import VoxelGrid
from hull_server.settings import BlobSettings
from hull_server.slicing.skeletonisation import BlobTable, find_centerline, slice_hull
from hull_server.views import RigViews

EVERYTHING = BlobSettings(min_area_m2=0.0, max_elongation=1e9, min_fill=0.0, max_growth=0.0)
SHAPE_ALONE = BlobSettings(max_elongation=2.0, max_growth=0.0)


def across(blobs: BlobTable, axis: int) -> BlobTable:
    """The blobs of the slices across one axis."""
    return BlobTable(*(column[blobs.axis == axis] for column in vars(blobs).values()))


def upright_cylinder(radius: float = 7.0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(40), np.arange(40), indexing="ij")
    return np.repeat(((x - 19.5) ** 2 + (y - 21.5) ** 2 <= radius**2)[:, :, None], 60, axis=2)


def test_centerline_of_an_upright_cylinder_is_its_axis():
    volume = volume_of(upright_cylinder())
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
    flat = across(slice_hull(volume)[0], 2)
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


def test_growth_drops_a_stump_on_a_wide_block_and_the_end_of_a_limb():
    dense = np.zeros((30, 30, 40), bool)
    dense[:, :, :10] = True  # 3600 cm2
    dense[12:18, 12:18, 10:30] = True  # 144 cm2
    volume = volume_of(dense)
    kept = find_centerline(across(slice_hull(volume)[0], 2), volume.grid, BlobSettings())
    layers = np.round((kept.points_world[:, 2] - 0.5) / 0.02 - 0.5).astype(int)
    assert layers.tolist() == [*range(1, 10), *range(11, 29)]


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
