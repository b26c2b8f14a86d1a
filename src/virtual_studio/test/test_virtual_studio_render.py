"""Silhouettes against a brute-force oracle; shadow, room and sensor."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from capture_rig.rig import Rig
from stick_figure.body import Body
from virtual_studio.motions.catalogue import tour
from virtual_studio.people import OUTFITS, VolumetricBody
from virtual_studio.rendering.camera import ExactSilhouettes, Sensor, VirtualCamera
from virtual_studio.rendering.capsules import CELL_M, DARKNESS, HALF_WIDTH_M, LAMP_POINTS, LAMPS_WORLD, floor_shadow
from virtual_studio.rig import DOOR_HEIGHT_M, DOOR_Y_M, open_door, ring, view_room
from virtual_studio.rig import HALF_WIDTH_M as HALF_ROOM_M

BODY = Body.from_stature(1.72)
PERSON = VolumetricBody(BODY)


@cache
def motion():
    return tour(BODY, seconds=10.5, fps=4)


@cache
def cameras():
    """Two around, and one on the ceiling."""
    return [VirtualCamera(camera) for camera in ring(2, ceiling=True).cameras]


def clearance(origin, rays, starts, ends, radii):
    """Oracle (n, P): least distance of each line to each part's surface, negative where it enters.

    A part is the union of spheres between its two ends; line-to-centre distance less radius is convex along the axis,
    so a ternary search finds its minimum.
    """
    rays, starts, ends = rays[:, None], starts[None], ends[None]

    def depth(u):
        centres = starts + u[..., None] * (ends - starts) - origin
        across = centres - (centres * rays).sum(-1, keepdims=True) * rays
        return np.linalg.norm(across, axis=-1) - (radii[:, 0] + u * (radii[:, 1] - radii[:, 0]))

    low, high = np.zeros((len(rays), radii.shape[0])), np.ones((len(rays), radii.shape[0]))
    for _ in range(48):
        a, b = low + (high - low) / 3, high - (high - low) / 3
        first = depth(a) < depth(b)
        low, high = np.where(first, low, a), np.where(first, b, high)
    return np.minimum(depth(0.5 * (low + high)), np.minimum(depth(low * 0), depth(low * 0 + 1)))


@pytest.mark.parametrize("frame", [0, 17])
def test_mask_equals_brute_force_rays_against_parts(frame):
    camera = cameras()[frame % 3].camera
    capsules = PERSON.place(motion().poses[frame])
    _, mask = cameras()[frame % 3].render(capsules, None)
    edge = cv2.dilate(mask, np.ones((5, 5))) != cv2.erode(mask, np.ones((5, 5)))
    rng = np.random.default_rng(frame)
    near = np.argwhere(edge)
    pixels = np.vstack([near[rng.permutation(len(near))[:900]], rng.integers([480, 640], size=(300, 2))])
    rays = camera.rays_world(pixels[:, ::-1].astype(float))
    least = clearance(camera.centre_world, rays, capsules.starts, capsules.ends, capsules.radii).min(1)
    decided = np.abs(least) > 1e-9
    assert decided.sum() >= 1190
    np.testing.assert_array_equal(mask[tuple(pixels[decided].T)] > 0, least[decided] < 0)


def test_part_around_the_camera_does_not_break_the_picture():
    camera, capsules = cameras()[0], PERSON.place(motion().poses[0])
    shift = 1.2 * camera.camera.centre_world - capsules.starts[0]
    behind = capsules._replace(starts=capsules.starts + shift, ends=capsules.ends + shift)
    light, mask = camera.render(behind, None)
    assert mask.max() == 0
    np.testing.assert_array_equal(light, camera.empty_room())


def test_shadow_falls_where_the_lamps_are_hidden_by_the_strength_given_and_nowhere_far():
    """Independent of the drawing: rays from floor cells to one lamp's points against all parts."""
    capsules = PERSON.place(motion().poses[0])
    shade = floor_shadow(capsules)
    rng = np.random.default_rng(2)
    cells = rng.integers(90, len(shade) - 90, size=(300, 2))
    places = np.column_stack([(cells[:, 1] + 0.5) * CELL_M - HALF_WIDTH_M, (cells[:, 0] + 0.5) * CELL_M - HALF_WIDTH_M])
    blocked = np.zeros(len(cells))
    lamps = (LAMPS_WORLD[:, None] + LAMP_POINTS).reshape(-1, 3)
    for lamp in lamps:  # from the lamp down; every part lies between it and the floor
        rays = np.column_stack([places - lamp[:2], np.full(len(places), -lamp[2])])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        blocked += clearance(lamp, rays, capsules.starts, capsules.ends, capsules.radii).min(1) < 0
    expected = 1.0 - DARKNESS * blocked / len(lamps)
    assert np.abs(expected - shade[tuple(cells.T)]).mean() < 0.02  # the blur moves only the edges
    assert np.corrcoef(expected, shade[tuple(cells.T)])[0, 1] > 0.9
    far = np.hypot(*(np.mgrid[: len(shade), : len(shade)] * CELL_M - HALF_WIDTH_M)) > 3.8
    np.testing.assert_allclose(shade[far], 1.0, atol=1e-3)
    np.testing.assert_allclose(1.0 - floor_shadow(capsules, 0.5), 0.5 * (1.0 - shade), atol=1e-6)


def test_room_in_colour_has_the_light_of_the_grey_one_and_a_brown_floor():
    camera = cameras()[0]
    colour, floor = camera.empty_room_colour(), np.isfinite(camera._view.floor_xy[..., 0])
    np.testing.assert_allclose(colour.mean(axis=2), camera.empty_room(), atol=1e-5)
    blue, green, red = colour[floor].mean(axis=0)
    assert blue < green < red


@pytest.mark.parametrize("name", OUTFITS)
def test_clothes_change_the_light_of_the_person_and_nothing_else(name):
    camera, capsules, outfit = cameras()[0], PERSON.place(motion().poses[0]), OUTFITS[name]
    shadow = floor_shadow(capsules)
    light, mask = camera.render(outfit.dress(capsules), shadow)
    colour, same = camera.render_colour(capsules, outfit.albedo_bgr(capsules), shadow)
    usual, exact = camera.render(capsules, shadow)
    np.testing.assert_array_equal(mask, exact)
    np.testing.assert_array_equal(same, exact)
    np.testing.assert_array_equal(light[exact == 0], usual[exact == 0])
    np.testing.assert_allclose(colour.mean(axis=2), light, atol=1e-5)
    body = exact > 0
    contrast = light[body].mean() / camera.empty_room()[body].mean()
    low, high = {"dark": (0, 0.4), "middle": (0.4, 0.8), "light": (1.1, 2), "room": (0.8, 1.1)}[name]
    assert low < contrast < high


def test_open_door_is_dark_and_as_large_as_a_door():
    camera = ring(4, ceiling=False).cameras[2]  # sees the whole of it
    view = view_room(camera)
    opened = open_door(camera, view)
    changed = opened.grey != view.grey
    assert (opened.grey[changed] < view.grey[changed]).all()
    y, x = np.nonzero(changed)
    pixels = camera.project(np.array([[HALF_ROOM_M, y, z] for y in DOOR_Y_M for z in (0.0, DOOR_HEIGHT_M)]))
    assert (pixels >= 0).all() and (pixels < [640, 480]).all()
    np.testing.assert_allclose([[x.min(), y.min()], [x.max(), y.max()]], [pixels.min(0), pixels.max(0)], atol=6.0)
    np.testing.assert_array_equal(open_door(camera, view, 0.0).grey, view.grey)


@pytest.mark.parametrize("shape", [(480, 640), (1200, 1920, 3)])
def test_sensor_adds_the_stated_noise_anew_in_every_frame_and_repeats_itself(shape):
    sensor, light = Sensor(noise=3.0, flicker=0.0, seed=7), np.full(shape, 0.5, np.float32)
    picture = sensor.expose(light, 2, 5)
    assert picture.astype(np.float32).std() == pytest.approx(3.0, rel=0.02)
    np.testing.assert_array_equal(picture, Sensor(noise=3.0, flicker=0.0, seed=7).expose(light, 2, 5))
    for other in (sensor.expose(light, 3, 5), sensor.expose(light, 2, 6), replace(sensor, seed=8).expose(light, 2, 5)):
        difference = picture.astype(np.float32) - other
        assert difference.std() == pytest.approx(3.0 * np.sqrt(2.0), rel=0.01)  # uncorrelated to 0.02


def test_lamps_flicker_by_the_stated_share_and_bright_light_saturates_instead_of_wrapping():
    flickering, light = Sensor(noise=0.0, flicker=0.01, seed=1), np.full((9, 9), 0.5, np.float32)
    means = [flickering.expose(light, 0, frame).mean() / 120.0 for frame in range(300)]
    assert np.std(means) == pytest.approx(0.01, rel=0.2)
    assert Sensor(noise=30.0).expose(3.0 * light, 0, 0).min() > 200


# --- Silhouettes without pictures equal those of the rendered sessions.


def test_bare_silhouettes_equal_the_rendered_ones():
    rig = ring(1)
    capsules = PERSON.place(motion().poses[17])
    masks = ExactSilhouettes(rig).render(capsules)
    assert list(masks) == list(rig.names)
    for camera in rig.cameras:
        rendered = VirtualCamera(camera).render(capsules, None)[1]
        expected = camera.undistorted_view().undistort_mask(rendered)
        assert expected.any()
        np.testing.assert_array_equal(masks[camera.name], expected)


def test_rows_of_a_rolling_shutter_show_the_body_at_their_time_and_cameras_at_theirs():
    rig = ring(1)
    first, ceiling = rig.cameras
    rolling = replace(first, line_time_s=15e-3 / first.height)
    eyes = ExactSilhouettes(Rig((rolling, ceiling), rig.volume))
    poses = tour(BODY, 6.0, 200.0).poses
    asked_s = []

    def capsules_at(time_s):
        asked_s.append(time_s)
        return PERSON.place(poses[round(200 * time_s)])

    masks = eyes.expose(capsules_at, 4.0, {"cam01": 0.0, "cam02": 0.01})
    assert asked_s[-1] == 4.01 and 3.9925 < min(asked_s) < 3.994 and 4.006 < max(asked_s[:-1]) < 4.0075
    np.testing.assert_array_equal(masks["cam02"], eyes.render(capsules_at(4.01))["cam02"])
    early, late = (eyes.render(capsules_at(time_s))["cam01"] for time_s in (asked_s[0], asked_s[-3]))
    rows = len(masks["cam01"])
    np.testing.assert_array_equal(masks["cam01"][: rows // 10], early[: rows // 10])
    assert (masks["cam01"] != early).any() and (masks["cam01"] != late).any()
