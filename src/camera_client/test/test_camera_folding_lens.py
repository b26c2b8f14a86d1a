"""A wide lens whose polynomial turns back in the image's corners: floor, silhouettes, movement keep clear of them."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from camera_pictures import learned

from camera_client.alignment import PictureAlignment
from camera_client.silhouettes.pipeline import SilhouettePipeline
from camera_client.silhouettes.shadows import floor_pixels
from virtual_studio.rendering.camera import Sensor
from virtual_studio.rig import VOLUME, ring, view_room

NOISE = 3.0
SENSOR = Sensor(NOISE, 0.005, 4)
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


@cache
def camera(turn_deg=(0.0, 0.0, 0.0)):
    """A camera of the studio with such a lens, turned about its own axes."""
    K = np.array([[418.0, 0.0, 326.8], [0.0, 418.0, 239.4], [0.0, 0.0, 1.0]])
    D, T = np.array([-0.4, 0.15, 0.0, 0.0, -0.03]), np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.radians(np.array(turn_deg)))[0]
    placed = ring(5, False).cameras[1]
    return replace(placed, width=644, height=486, K=K, D=D, T_camera_world=T @ placed.T_camera_world)


@cache
def rayless():
    """(H, W) the pixels beyond the largest radius that the polynomial reaches."""
    r = np.linspace(0.0, 2.0, 20_001)
    y, x = np.mgrid[:486, :644]
    largest = 418.0 * (r * (1 - 0.4 * r**2 + 0.15 * r**4 - 0.03 * r**6)).max()
    return np.hypot(x - 326.8, y - 239.4) > largest + 1.0


@cache
def light(turn_deg=(0.0, 0.0, 0.0)):
    return view_room(camera(turn_deg)).grey


def picture(frame, turn_deg=(0.0, 0.0, 0.0)):
    return SENSOR.expose(light(turn_deg), 1, frame)


@cache
def background():
    return learned(picture(1000 + frame) for frame in range(20))


def test_floor_has_no_pixel_where_the_lens_has_no_ray():
    assert rayless().mean() > 0.05
    for floor in (floor_pixels(camera()), floor_pixels(camera(), VOLUME, 0.3)):
        assert not floor[cv2.erode(rayless().astype(np.uint8), np.ones((17, 17))) > 0].any()
        assert floor[~rayless()].mean() > 0.2 * 255


def test_silhouette_on_the_canvas_has_nothing_of_what_happens_in_a_folded_corner():
    pipeline = SilhouettePipeline(camera(), background())
    image = picture(1)
    image[380:, :60] = image[:60, 600:] = 255
    image[rayless()] = np.random.default_rng(1).integers(0, 256, rayless().sum(), np.uint8)
    shown = pipeline.run(image)
    view = camera().undistorted_view()
    assert shown.mask.shape == view.seen.shape and not shown.mask[~view.seen].any()
    full = view.undistort_mask(np.where(rayless(), np.uint8(255), np.uint8(0)))
    assert not full.any()


@pytest.mark.parametrize("turn_deg", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.4, -1.0, 1.5)])
def test_turn_of_a_camera_with_a_folding_lens_is_measured(turn_deg):
    found = PictureAlignment(camera(), background().mean, NOISE).align(picture(1, turn_deg))
    assert np.degrees(found.turn_rad) == pytest.approx(turn_deg, abs=0.1)
