"""What a rig can show: the region of a sensor that a volume needs, and where a body is seen, by the carver's rule."""

from dataclasses import replace

import numpy as np
import pytest

from capture_rig.camera import CameraModel, looking_at
from capture_rig.rig import Volume
from capture_rig.visibility import (
    CELL_M,
    EVERYWHERE,
    MOST_PIXEL_M,
    Region,
    RigVisibility,
    min_seeing,
    needed_region,
    of_region,
    pixel_width_m,
)
from virtual_studio.rig import ring, tilted, with_camera

VOLUME = Volume(np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 2.0]))
MIDDLE = np.array([0.0, 0.0, 1.0])


def camera_at(centre_world, focal_px=600.0, roll_rad=0.0):
    K = np.array([[focal_px, 0.0, 639.5], [0.0, focal_px, 511.5], [0.0, 0.0, 1.0]])
    D = np.array([-0.1, 0.01, 0.0, 0.0, 0.0])
    return CameraModel("cam01", 1280, 1024, K, "plumb_bob", D, looking_at(np.array(centre_world), MIDDLE, roll_rad))


def seen_pixels(camera, volume=VOLUME, count=20000):
    points = np.random.default_rng(0).uniform(volume.low, volume.high, (count, 3))
    pixels = camera.project(points)
    inside = ((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5)).all(axis=1)
    return pixels[inside]


@pytest.mark.parametrize(
    "camera",
    [
        camera_at([5.0, 1.0, 1.5]),
        camera_at([5.0, -3.0, 2.5], roll_rad=1.2),
        camera_at([1.5, 0.2, 1.0]),  # part of the volume lies beside the picture
        camera_at([0.5, 0.5, 1.5]),  # inside of the volume
    ],
    ids=["beside", "rolled", "near", "inside"],
)
def test_region_holds_every_pixel_of_the_volume_and_little_more(camera):
    region = needed_region(camera, VOLUME)
    part, seen = of_region(camera, region), seen_pixels(camera)
    kept = seen_pixels(part)
    assert len(kept) == len(seen)
    spare_px = 0.012 * camera.width + 16 + 4
    assert (seen.min(axis=0) - [region.offset_x, region.offset_y] < spare_px + 8).all()
    assert ([region.offset_x + region.width, region.offset_y + region.height] - seen.max(axis=0) < spare_px + 8).all()


@pytest.mark.parametrize(
    "region", [Region(1, 100, 60, 800, 700), Region(2, 16, 32, 500, 400), Region(4, 0, 0, 320, 256)]
)
def test_picture_of_a_region_shows_each_point_where_its_pixels_were(region):
    camera = camera_at([5.0, 1.0, 1.5])
    points = np.random.default_rng(1).uniform(VOLUME.low, VOLUME.high, (50, 3))
    corners = camera.project(points) + 0.5  # from the corner of the first pixel
    expected = corners / region.binning - [region.offset_x, region.offset_y] - 0.5
    np.testing.assert_allclose(of_region(camera, region).project(points), expected, atol=1e-9)


def test_binning_leaves_pixels_as_wide_as_the_hull_needs():
    fine = camera_at([5.0, 1.0, 1.5], focal_px=1500.0)
    region = needed_region(fine, VOLUME)
    assert region.binning == 3
    assert pixel_width_m(of_region(fine, region), VOLUME) <= MOST_PIXEL_M < 4 * pixel_width_m(fine, VOLUME)


def test_whole_picture_is_kept_where_the_volume_is_not_in_view():
    away = camera_at([5.0, 1.0, 1.5])
    turned = replace(away, T_camera_world=np.diag([-1.0, 1.0, -1.0, 1.0]) @ away.T_camera_world)
    assert needed_region(turned, VOLUME) == Region(1, 0, 0, 1280, 1024)


# --- where a rig can show a body --------------------------------------------------------------------------------------

RING = ring(3, ceiling=False)
VISIBILITY = RigVisibility(with_camera(RING, 2, tilted(RING.cameras[2], 0.24)))
FEET, CHEST = np.array([[0.0, 0.0, 0.02]]), np.array([[0.0, 0.0, 1.2]])


def random_places(count=2000):
    rng = np.random.default_rng(1)
    return rng.uniform(VISIBILITY.volume.low - 0.3, VISIBILITY.volume.high + 0.3, (count, 3))


def test_tilted_camera_does_not_see_the_floor_near_it():
    near = 0.5 * VISIBILITY.rig.cameras[2].centre_world[:2] / np.linalg.norm(VISIBILITY.rig.cameras[2].centre_world[:2])
    feet = np.array([[*near, 0.02]])
    assert VISIBILITY.seen_by(feet).tolist() == [[True, True, False]]
    assert not VISIBILITY.shows(feet)[0] and VISIBILITY.shows(CHEST)[0]


def test_camera_that_more_than_the_rest_need_may_miss_a_place():
    six = ring(5)
    five_see = RigVisibility(with_camera(six, 2, tilted(six.cameras[2], 0.5)))
    assert five_see.seen_by(FEET).sum() == 5 and five_see.needed == 4 and five_see.shows(FEET)[0]
    assert not RigVisibility(five_see.rig, requested_seeing=6).shows(FEET)[0]


def test_seen_by_is_the_projection_with_the_lens():
    places = random_places(300)
    for number, camera in enumerate(VISIBILITY.rig.cameras):
        pixels = camera.project(places)
        inside = ((pixels > 1.0) & (pixels < [camera.width - 2.0, camera.height - 2.0])).all(axis=1)
        outside = ~((pixels > -2.0) & (pixels < [camera.width + 1.0, camera.height + 1.0])).all(axis=1)
        seen = VISIBILITY.seen_by(places)[:, number]
        assert seen[inside].all() and not seen[outside].any() and inside.any() and outside.any()


def test_cells_are_unseen_where_any_place_in_them_is():
    places, cells = random_places(), VISIBILITY.unseen_cells
    places = places[places[:, 2] > cells.low[2]]
    unseen = cells.at(places)
    assert unseen[~VISIBILITY.shows(places)].all()
    assert np.array_equal(cells.rows_outside(places), np.flatnonzero(~unseen))
    assert not unseen.all() and np.mean(unseen != ~VISIBILITY.shows(places)) < 0.15  # the cells at the border


def test_below_the_floor_nothing_is_unseen_and_beside_the_volume_all_is():
    low, high = VISIBILITY.volume.low, VISIBILITY.volume.high
    assert not VISIBILITY.unseen_cells.at(np.array([[0.0, 0.0, low[2] - 0.2]]))[0]
    beside = np.array([[high[0] + 0.1, 0.0, 1.0], [0.0, low[1] - 0.1, 1.0], [0.0, 0.0, high[2] + 0.1]])
    assert VISIBILITY.unseen_cells.at(beside).all()
    assert not EVERYWHERE.at(beside).any()


def test_widened_map_reaches_one_cell_farther():
    cells = VISIBILITY.unseen_cells
    wide = cells.widened()
    assert (wide.unseen | ~cells.unseen).all() and wide.unseen.sum() > cells.unseen.sum()
    places = random_places(500)
    beside = places + np.random.default_rng(2).choice([-CELL_M, CELL_M], places.shape) * 0.99
    held = (places[:, 2] > cells.low[2]) & (beside[:, 2] > cells.low[2])
    assert wide.at(beside[held])[cells.at(places[held])].all()
    assert EVERYWHERE.widened() is EVERYWHERE


@pytest.mark.parametrize(
    ("cameras", "needed"), [(1, 2), (2, 2), (3, 3), (4, 3), (5, 3), (6, 4), (7, 5), (8, 5), (10, 6), (16, 10)]
)
def test_seeing_cameras_that_a_hull_needs(cameras, needed):
    assert min_seeing(cameras) == needed


def test_requested_seeing_cameras_are_lowered_to_those_present_but_never_below_two():
    assert [min_seeing(n, 4) for n in (6, 4, 3, 2, 1)] == [4, 4, 3, 2, 2]
    assert min_seeing(6, 1) == 2
