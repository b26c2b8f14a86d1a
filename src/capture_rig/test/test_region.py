"""The region of a sensor that a volume needs, against points of the volume that are projected one by one."""

from dataclasses import replace

import numpy as np
import pytest

from capture_rig.camera import CameraModel, looking_at
from capture_rig.region import MOST_PIXEL_M, Region, needed_region, of_region, pixel_width_m
from capture_rig.rig import Volume

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
