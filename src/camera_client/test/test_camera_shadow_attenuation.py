"""What a camera says about dark pixels, and where it draws the outline."""

import cv2
import numpy as np
import pytest
from camera_pictures import change_of

from camera_client.background.model import BackgroundModel, Provenance
from camera_client.background.noise import assumed_noise
from camera_client.silhouettes.masks import Box, trim_outline
from camera_client.silhouettes.shadows import AttenuationMarker, Scene
from capture_rig.mask_levels import ATTENUATED_LEVELS, ATTENUATION_EDGES, candidate_level

ALL = Box(0, 0, 120, 160)


def background(scene, colour=False):
    mean = np.mean(scene.empty(20, colour=colour), axis=0, dtype=np.float32)
    return BackgroundModel(mean, np.full_like(mean, 1.5), Provenance("test", 20, 1.5))


def darkened(model, ratio):
    return np.rint(model.mean * ratio).clip(0, 255).astype(np.uint8)


def seen(model, image, box=ALL):
    """The part of the frame ``image`` in the box, before the background as it was learned."""
    change = change_of(image, model.mean)
    return Scene(*(each[box.slices] for each in (image, model.mean, change)), assumed_noise(1.5, 1), box.slices)


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("degree", range(len(ATTENUATED_LEVELS)))
def test_dark_floor_gets_the_degree_of_its_brightness(scene, colour, degree):
    model, marker = background(scene, colour), AttenuationMarker(scene.camera())
    floor = seen(model, darkened(model, (ATTENUATION_EDGES[degree] + ATTENUATION_EDGES[degree + 1]) / 2))
    person, nothing = np.zeros((2, 120, 160), np.uint8)
    person[70:120, 20:140] = 255
    for parts, level in (((person, nothing), ATTENUATED_LEVELS[degree]), ((nothing, person), candidate_level(degree))):
        levels = marker.mark(floor, *parts)
        assert (levels[82:118, 22:138] == level).mean() > 0.95 and not levels[person == 0].any()


def test_what_no_shadow_can_be_stays_the_person(scene):
    model, person = background(scene), np.full((120, 160), 255, np.uint8)
    test, nothing = AttenuationMarker(scene.camera()), np.zeros((120, 160), np.uint8)
    for ratio in (0.2, 1.1, 1.6):
        assert (test.mark(seen(model, darkened(model, ratio)), person, nothing)[82:] == 255).mean() > 0.95
    assert (test.mark(seen(model, darkened(model, 0.6)), person, nothing)[:60] == 255).all()  # above the horizon


def test_a_box_of_the_image_gives_what_the_whole_image_gives(scene):
    model, rng = background(scene), np.random.default_rng(2)
    test, image = AttenuationMarker(scene.camera()), np.rint(model.mean * rng.uniform(0.3, 1.2, (120, 160)))
    person = np.where(cv2.blur(rng.random((120, 160)), (9, 9)) > 0.52, np.uint8(255), np.uint8(0))
    candidates = cv2.bitwise_and(np.roll(person, 7), cv2.bitwise_not(person))
    whole = test.mark(seen(model, image.astype(np.uint8)), person, candidates)
    for box in (Box(60, 30, 120, 160), Box(0, 0, 100, 76), Box(88, 4, 98, 22)):
        part = test.mark(seen(model, image.astype(np.uint8), box), person[box.slices], candidates[box.slices])
        assert np.array_equal(part, whole[box.slices])


@pytest.mark.parametrize("blur_px", [0.8, 1.2])
def test_blurred_edge_is_drawn_nearer_to_where_it_is(blur_px):
    mean, truth = np.full((80, 80), 120, np.uint8), np.zeros((80, 80), np.uint8)
    cv2.rectangle(truth, (25, 20), (54, 59), 255, -1)
    image = np.rint(120 - 80 * cv2.GaussianBlur(truth / 255.0, (0, 0), blur_px)).astype(np.uint8)
    fat = np.where(cv2.absdiff(image, mean) > 4, np.uint8(255), np.uint8(0))
    trimmed = trim_outline(fat, change_of(image, mean), 0.5, colour=False)
    assert np.count_nonzero(trimmed != truth) < 0.65 * np.count_nonzero(fat != truth)
    assert not (trimmed & ~fat).any() and trimmed[truth > 0].all()


def test_untrimmed_outline_is_left_alone_and_thin_limbs_survive():
    mean, image = np.full((40, 40), 120, np.uint8), np.full((40, 40), 120, np.uint8)
    image[10:30, 20] = 60  # one pixel wide
    mask = np.where(image < 100, np.uint8(255), np.uint8(0))
    assert np.array_equal(trim_outline(mask, change_of(image, mean), 0.3, colour=False), mask)
    assert np.array_equal(trim_outline(mask, change_of(image, mean), 0.3, colour=True), mask)
