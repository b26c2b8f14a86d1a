"""Boxes, the search for dense foreground, and undistortion of a box: the same result as for the whole image."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from camera_pictures import change_of, learned
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from camera_client.background.fixed import FixedBackground
from camera_client.background.kernels import BLOCK_PX
from camera_client.background.training_verdict import HAND
from camera_client.settings import BackgroundSettings, SilhouetteSettings
from camera_client.silhouettes.components import PeopleRule, keep_people
from camera_client.silhouettes.masks import (
    Box,
    BoxUndistorter,
    ForegroundLocator,
    majority,
    majority_count,
    trim_outline,
)
from camera_client.silhouettes.pipeline import SilhouettePipeline
from camera_client.silhouettes.shadows import ColourShadow, FloorShadow, Scene
from capture_rig.mask_levels import FOREGROUND, SHADOW_CANDIDATE, UNCERTAIN
from capture_rig.rig import Volume
from capture_rig.stamps import NS_PER_S
from mocap_packets.silhouette import BODY, NOBODY, ForegroundSupport

THESIS = BackgroundSettings(rule="tail")


def holds(box, mask):
    outside = mask.copy()
    outside[box.slices] = 0
    return not outside.any()


def test_box_grows_to_multiples_within_the_image_and_holds_every_pixel():
    assert Box(10, 20, 30, 40).grown(3, (100, 100), 8) == Box(0, 16, 40, 48)
    assert Box(2, 2, 98, 99).grown(3, (100, 100)) == Box(0, 0, 100, 100)
    mask = np.zeros((50, 60), np.uint8)
    assert Box.around(mask).empty
    mask[7, 9] = mask[40, 20] = 255
    assert Box.around(mask) == Box(7, 9, 41, 21)


@given(st.integers(0, 2**32 - 1), st.sampled_from([3, 5, 7]), st.sampled_from([(61, 83), (64, 80), (40, 97)]))
@settings(max_examples=60, deadline=None)
def test_everything_that_survives_the_majority_filter_lies_in_the_box(seed, side, shape):
    rng = np.random.default_rng(seed)
    mask = np.where(rng.random(shape) < rng.choice([0.0, 0.002, 0.05, 0.3]), np.uint8(255), np.uint8(0))
    x, y = rng.integers(0, shape[1]), rng.integers(0, shape[0])
    cv2.ellipse(mask, (int(x), int(y)), (int(rng.integers(1, 15)), int(rng.integers(1, 15))), 0, 0, 360, 255, -1)
    search = ForegroundLocator(shape, 0, majority_count(side))
    assert holds(search.find(mask, 127).grown(side // 2, shape), majority(mask, side))


def test_scattered_noise_does_not_widen_the_box():
    rng = np.random.default_rng(0)
    mask = np.where(rng.random((480, 640)) < 0.01, np.uint8(255), np.uint8(0))
    mask[200:400, 300:360] = 255
    search = ForegroundLocator(mask.shape, 46, majority_count(5))
    box = search.find(mask, 127)
    assert holds(box, np.where(cv2.erode(mask, np.ones((9, 9))) > 0, 255, 0))
    assert (box.bottom - box.top) <= 200 + 4 * BLOCK_PX and (box.right - box.left) <= 60 + 4 * BLOCK_PX


@pytest.mark.parametrize("distortion", [(0.0, 0.0, 0.0, 0.0, 0.0), (-0.35, 0.12, 0.001, -0.002, 0.0)])
def test_undistorting_a_box_equals_undistorting_the_image(scene, distortion):
    view = scene.camera(distortion=distortion).undistorted_view()
    undistorter, rng = BoxUndistorter(view), np.random.default_rng(1)
    for _ in range(40):
        rows, columns = np.sort(rng.integers(0, 121, 2)), np.sort(rng.integers(0, 161, 2))
        box, mask = Box(rows[0], columns[0], rows[1], columns[1]), np.zeros((120, 160), np.uint8)
        mask[box.slices] = rng.choice(np.array([0, 127, 255], np.uint8), mask[box.slices].shape)
        assert np.array_equal(undistorter.undistort(mask, box), view.undistort_mask(mask))


def whole_image(camera, background, image, settings):
    """The chain step by step on the whole image, by the thesis's rule: slow, and plain enough to be believed."""
    raw = majority(FixedBackground(background, THESIS).distance(image, image))
    change, at = change_of(image, background.mean), (slice(0, None), slice(0, None))
    scene = Scene(image, background.mean, change, FixedBackground(background, THESIS).noise, at)
    shadow = (ColourShadow if image.ndim == 3 else FloorShadow)(camera).shadow(scene, raw)
    height = len(image)
    side, area = 2 * round(settings.closing * height / 2) + 1, height**2
    person = cv2.morphologyEx(cv2.subtract(raw, shadow), cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    person = keep_people(person, PeopleRule(HAND * area, settings.near * height, settings.max_hole * area))
    person = trim_outline(person, change, settings.outline_contrast, colour=image.ndim == 3)
    return np.maximum(person, np.minimum(shadow, SHADOW_CANDIDATE))


def larger(camera, factor):
    K = camera.K * [[factor], [factor], [1]]
    return replace(camera, width=camera.width * factor, height=camera.height * factor, K=K)


@pytest.mark.parametrize("colour", [False, True])
def test_working_in_a_box_gives_the_silhouette_of_the_whole_image(scene, colour):
    settings, rng = SilhouetteSettings(), np.random.default_rng(3)
    empty = scene.empty(40, colour=colour)
    model = learned(cv2.resize(image, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST) for image in empty)
    camera = larger(scene.camera(distortion=(-0.2, 0.05, 0, 0, 0)), 3)
    pipeline = SilhouettePipeline(camera, model, settings, THESIS)
    for k in range(12):
        shift = int(rng.integers(-90, 90))  # over the border, too
        person = np.roll(scene.person_mask(), shift, axis=1)
        image = scene.empty(1, seed=50 + k, colour=colour)[0]
        image[90:112, 20:75] = np.rint(image[90:112, 20:75] * 0.7)
        image = cv2.resize(scene.with_person(image, person), None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST)
        silhouette = pipeline.run(image)
        expected = whole_image(camera, model, image, settings)
        levels = silhouette.image_mask
        assert np.array_equal(levels > SHADOW_CANDIDATE, expected == 255)
        assert np.array_equal((levels > UNCERTAIN) & (levels <= SHADOW_CANDIDATE), expected == SHADOW_CANDIDATE)
        assert (expected == 255).any() and (expected == SHADOW_CANDIDATE).any()
        assert silhouette.foreground_fraction == pytest.approx((expected == 255).mean())
        assert silhouette.candidate_fraction == pytest.approx((expected == SHADOW_CANDIDATE).mean())


# --- Which parts of a raw mask are kept.


def blank():
    return np.zeros((240, 320), np.uint8)


def keep(mask, min_area_px=20, near_px=20, max_hole_px=30):
    return keep_people(mask, PeopleRule(min_area_px, near_px, max_hole_px))


@pytest.mark.parametrize(
    "piece",
    [(slice(40, 50), slice(161, 190)), (slice(60, 64), slice(145, 149))],
    ids=["21 px off", "16 px of area beside the person"],
)
def test_small_piece_is_dropped_that_is_far_from_everything_or_a_speck(piece):
    mask = blank()
    mask[40:120, 100:140] = 255
    expected = mask.copy()
    mask[piece] = 255
    assert np.array_equal(keep(mask), expected)


def test_second_person_far_from_the_first_survives_with_a_foot_of_its_own():
    mask = blank()
    mask[40:200, 60:120] = 255
    mask[60:120, 250:270] = 255  # an eighth of the first one's area
    mask[130:136, 252:262] = 255
    assert np.array_equal(keep(mask), mask)


@pytest.mark.parametrize("width", [64, 67])
def test_holes_and_what_is_in_them_are_those_that_labelling_finds(width):
    """Holes share edges, foreground also corners; a small hole is filled with the speck in it, a large one stays."""
    rng = np.random.default_rng(6)
    mask = cv2.GaussianBlur(rng.random((70, width)).astype(np.float32), (0, 0), 2.0)
    mask = np.where(mask > np.median(mask), np.uint8(255), np.uint8(0))
    kept = keep(mask, min_area_px=0, near_px=1e3, max_hole_px=30)
    background, _ = ndimage.label(np.pad(mask == 0, 1, constant_values=True))
    assert (kept[mask > 0] == 255).all() and (mask == 0).any()
    small = 0
    for hole in range(1, background.max() + 1):
        if hole == background[0, 0]:
            continue
        inside = ndimage.binary_fill_holes(background == hole, np.ones((3, 3)))[1:-1, 1:-1]
        filled = kept[(background == hole)[1:-1, 1:-1]]
        assert (filled == filled[0]).all()
        assert filled[0] == (255 if inside.sum() < 30 else 0)
        small += inside.sum() < 30
    assert small >= 2


def person():
    """Head, trunk, an arm held out with its hand, two legs with feet, as a camera 3 m away would see them."""
    mask = blank()
    cv2.circle(mask, (120, 30), 12, 255, -1)
    mask[42:120, 100:140] = 255
    mask[50:60, 140:200] = 255
    mask[120:215, 102:115] = mask[120:215, 125:138] = 255
    mask[215:222, 92:115] = mask[215:222, 125:148] = 255
    return mask


LIMBS = {
    "hand cut off by a thin strip in the background's colour": (slice(48, 62), slice(182, 187)),
    "head separated by a bright collar": (slice(40, 49), slice(95, 145)),
    "forearm hidden behind a pole": (slice(48, 62), slice(155, 170)),
    "foot beyond the shadow that was taken off the shin": (slice(188, 214), slice(95, 145)),
    "legs below shorts as dark as the floor": (slice(115, 142), slice(95, 145)),
}


@pytest.mark.parametrize("cut", LIMBS.values(), ids=LIMBS)
def test_limb_survives_that_is_cut_off_as(cut):
    mask = person()
    mask[cut] = 0
    settings = SilhouetteSettings()
    area = mask.shape[0] ** 2
    kept = keep_people(mask, PeopleRule(HAND * area, settings.near * mask.shape[0], settings.max_hole * area))
    assert cv2.connectedComponents(mask)[0] > 2  # it is cut off
    assert np.array_equal(kept, mask)


def test_camera_has_no_vote_where_a_thing_keeps_still_that_no_other_camera_sees(scene):
    camera = scene.camera()
    pipeline = SilhouettePipeline(camera, learned(scene.empty(40)), SilhouetteSettings(shadow="keep"))
    canvas, cell = camera.undistorted_view().camera, 8
    cells = np.full((-(-canvas.height // cell), canvas.width // cell), NOBODY, np.uint8)
    cells[:, 64 // cell : 96 // cell] = BODY
    thing = (slice(30, 70), slice(112, 150))  # nearer to the person than a foot that is cut off
    for frame, image in enumerate(scene.empty(12, seed=7)):
        image[thing] = 230
        pipeline.add_support(ForegroundSupport(frame * NS_PER_S // 5, camera.name, cell, cells))
        levels = pipeline.run(scene.with_person(image), frame * NS_PER_S // 5).image_mask
        assert (levels[scene.person_mask() > 0] == FOREGROUND).mean() > 0.95
        if frame == 0:
            assert (levels[thing] == FOREGROUND).all()
    assert (levels[thing] == UNCERTAIN).mean() > 0.95 and pipeline.moved.absorbed == 0


@pytest.mark.parametrize("side", [1, 3, 5, 7])
def test_majority_equals_the_median_of_a_mask(side):
    rng = np.random.default_rng(side)
    mask = np.where(rng.random((97, 131)) < 0.45, np.uint8(255), np.uint8(0))
    assert np.array_equal(majority(mask, side), mask if side == 1 else cv2.medianBlur(mask, side))


@pytest.mark.parametrize("colour", [False, True])
def test_pictures_finer_than_the_hull_are_looked_at_in_half_of_the_size(scene, colour):
    camera = larger(scene.camera(), 3)
    model = learned(cv2.resize(image, None, fx=3, fy=3) for image in scene.empty(40, colour=colour))
    near = Volume(camera.centre_world - 1, camera.centre_world + 1)
    truth = cv2.resize(scene.person_mask(), None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST) > 0
    image = cv2.resize(scene.with_person(scene.empty(1, seed=7, colour=colour)[0]), None, fx=3, fy=3)
    pipeline = SilhouettePipeline(camera, model, SilhouetteSettings(), volume=near)
    found = pipeline.run(image)
    assert pipeline.scale == 2 and found.image_mask.shape == truth.shape
    assert found.mask.shape == camera.undistorted_view().image_shape
    person, around = (found.image_mask > SHADOW_CANDIDATE).astype(np.uint8), np.ones((5, 5), np.uint8)
    inner, outer = cv2.erode(truth.astype(np.uint8), around), cv2.dilate(truth.astype(np.uint8), around)
    assert ((inner > person) | (person > outer)).sum() < 0.005 * truth.sum()  # two pixels beside the outline at most
