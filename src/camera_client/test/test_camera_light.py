"""Light that changes, slowly, suddenly, unevenly or with the mains, is followed; people who stand still are not."""

import numpy as np
import pytest
from camera_pictures import iou, learned

from camera_client.settings import BackgroundSettings
from camera_client.silhouettes.pipeline import SilhouettePipeline

SECOND_NS = 1_000_000_000
FIXED = BackgroundSettings(rule="tail")


def lit(image, factor):
    return np.clip(np.rint(image * factor), 0, 255).astype(np.uint8)


class Room:
    """A camera on an empty room whose clock runs in steps of a second."""

    def __init__(self, scene, colour=False, settings=None):
        self.scene = scene
        self.background = learned(scene.empty(60, colour=colour))
        self.empty = scene.empty(20, seed=9, colour=colour)
        self.pipeline = SilhouettePipeline(scene.camera(), self.background, None, settings)
        self.frames, self.noise = 0, 0.0  # share of the pixels of the last frame that were not called background

    def see(self, light=1.0, person=None, change=lambda image: image):
        image = lit(self.empty[self.frames % len(self.empty)].astype(float), light)
        if person is not None:
            image = self.scene.with_person(image, person)
        self.frames += 1
        found = self.pipeline.subtract(change(image), self.frames * SECOND_NS)
        self.noise = float((found.distance > self.pipeline.background.threshold).mean())
        return self.pipeline.segment(found)

    @property
    def gain(self):
        return self.pipeline.background.light.brightness


def test_lights_that_dim_a_fifth_in_five_minutes_leave_the_masks_clean(scene):
    room, fixed = Room(scene), Room(scene, settings=FIXED)
    for light in np.linspace(1.0, 0.8, 300):
        assert room.see(light).foreground_fraction < 0.001
    fixed.see(0.8)  # the thesis's rules follow nothing
    assert room.gain == pytest.approx(0.8, rel=0.02) and fixed.gain == 1.0
    assert room.noise < 0.01 < 0.5 < fixed.noise
    assert iou(room.see(0.8, scene.person_mask()).image_mask, scene.person_mask()) > 0.95


@pytest.mark.parametrize(
    "light, colour", [(0.45, False), (0.8, False), (1.25, False), (1.5, False), (0.8, True), (1.5, True)]
)
def test_lights_that_are_switched_cost_no_mask_and_are_told(scene, light, colour):
    room, person = Room(scene, colour), scene.person_mask()
    for _ in range(20):
        assert not room.see(1.0, person).flags
    silhouette = room.see(light, person)
    assert room.pipeline.background.light.switched
    assert iou(silhouette.image_mask, person) > 0.93
    assert room.gain == pytest.approx(light, rel=0.03)


def test_lamp_that_lights_a_part_of_the_room_is_taken_up_within_half_a_second(scene):
    room, person = Room(scene), scene.person_mask()
    v, u = np.indices((120, 160))
    lamp = 1 + 0.4 * np.exp(-((u - 20) ** 2 + (v - 20) ** 2) / (2 * 60.0**2))  # of its place, brightest in a corner
    for _ in range(20):
        room.see(1.0, person)
    scores = [
        iou(room.see(1.0, person, lambda image: np.where(person > 0, image, lit(image, lamp))).image_mask, person)
        for _ in range(5)
    ]
    assert min(scores[1:]) > 0.9
    assert room.pipeline.background.light.field.std() > 0.05


@pytest.mark.parametrize("light", [0.7, 1.6])
def test_lens_that_was_covered_for_a_while_gives_whole_masks_again_also_in_other_light(scene, light):
    room, person, rng = Room(scene), scene.person_mask(), np.random.default_rng(6)
    for covered in (10, 30):
        for _ in range(10):
            room.see(1.0, person)
        for _ in range(covered):
            room.see(1.0, person, lambda image: lit(rng.normal(0, 2, image.shape), 1.0))
        masks = [room.see(light, person).image_mask for _ in range(10)]
        assert iou(masks[-1], person) > 0.93


def test_mains_flicker_of_two_percent_leaves_the_masks_clean(scene):
    room, rng = Room(scene), np.random.default_rng(4)
    for _ in range(60):
        assert room.see(1 + 0.02 * rng.normal()).foreground_fraction < 0.001


def test_white_and_black_places_tell_bounds_only(scene):
    """A window that was white may be any brighter than white; a person in front of it is still seen."""
    images = [image.copy() for image in scene.empty(40)]
    for image in images:
        image[10:50, 100:150] = 255
    background, person = learned(images), scene.person_mask()
    pipeline = SilhouettePipeline(scene.camera(), background)
    for k in range(30):
        frame = lit(scene.empty(1, seed=60 + k)[0].astype(float), 0.85)
        frame[10:50, 100:150] = 235  # would be 217 if it had been 255
        silhouette = pipeline.run(scene.with_person(frame, np.roll(person, 40, axis=1)), k * SECOND_NS)
    assert iou(silhouette.image_mask, np.roll(person, 40, axis=1)) > 0.93


@pytest.mark.parametrize("colour", [False, True])
def test_what_turns_white_in_brighter_light_stays_background(scene, colour):
    """A pale wall of 210 grey levels would be 294 when the lamps are brighter by two fifths."""
    images = scene.empty(60, colour=colour)
    for image in images:
        image[:70, 90:] = image[:70, 90:] // 8 + 194
    person = scene.person_mask()
    pipeline = SilhouettePipeline(scene.camera(), learned(images[:40]))
    for k, image in enumerate(images[40:]):
        frame = lit(image.astype(float), 1.4)
        frame[person > 0] = 40
        assert (frame[:70, 95:] == 255).all()
        assert iou(pipeline.run(frame, k * SECOND_NS).image_mask, person) > 0.95


@pytest.mark.slow
def test_person_who_stands_still_for_ten_minutes_stays_whole_and_leaves_no_ghost_also_when_the_light_dims(scene):
    room, person = Room(scene), scene.person_mask()
    for _ in range(50):
        room.see()
    first = iou(room.see(1.0, person).image_mask, person)
    scores = [iou(room.see(1.0, person).image_mask, person) for _ in range(300)]
    assert first > 0.97 and min(scores) > first - 0.02
    assert room.see().foreground_fraction == 0
    scores = [iou(room.see(light, person).image_mask, person) for light in np.linspace(1.0, 0.8, 300)]
    assert min(scores) > 0.93
    assert room.see(0.8).foreground_fraction < 0.001  # the place behind the person dimmed, too


def test_same_stamps_give_the_same_masks_and_a_clock_set_back_does_no_harm(scene):
    one, two = Room(scene, colour=True), Room(scene, colour=True)
    for light in np.linspace(1.0, 0.95, 75):
        assert np.array_equal(one.see(light).image_mask, two.see(light).image_mask)
    gain, one.frames = one.gain, 0
    assert one.see(0.95).foreground_fraction < 0.001
    assert one.gain == pytest.approx(gain, rel=1e-3)
