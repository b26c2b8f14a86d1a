"""Slow changes of the light are followed; people, however long they stand, and switched lights are not."""

import numpy as np
import pytest

from camera_client.background.model import BackgroundLearner
from camera_client.settings import BackgroundSettings, LightDriftSettings
from camera_client.silhouettes.pipeline import FULL, SilhouettePipeline
from camera_client.sources.frame_checks import LIGHTS, FrameChecks

SECOND_NS = 1_000_000_000
SLOW = BackgroundSettings(drift=LightDriftSettings(mode="slow"))


def learned(images):
    learner = BackgroundLearner()
    for image in images:
        learner.add(image)
    return learner.model("test")


def lit(image, factor):
    return np.clip(np.rint(image * factor), 0, 255).astype(np.uint8)


class Room:
    """A camera on an empty room whose clock runs in steps of a second."""

    def __init__(self, scene, colour=False, settings=SLOW):
        self.scene = scene
        self.background = learned(scene.empty(60, colour=colour))
        self.empty = scene.empty(20, seed=9, colour=colour)
        self.pipeline = SilhouettePipeline(scene.camera(), self.background, None, settings)
        self.frames = 0

    def see(self, light=1.0, person=None, **changes):
        image = lit(self.empty[self.frames % len(self.empty)].astype(float), light)
        if person is not None:
            image = self.scene.with_person(image, person)
        for change in changes.values():
            image = change(image)
        self.frames += 1
        return self.pipeline.run(image, self.frames * SECOND_NS)

    def noise(self, light=1.0):
        """Share of the pixels of an empty frame that leave the limits."""
        image = lit(self.empty[0].astype(float), light)
        return float((self.pipeline.limits.subtract(image) > 0).mean())


def iou(mask, truth):
    return ((mask == 255) & (truth > 0)).sum() / ((mask == 255) | (truth > 0)).sum()


@pytest.mark.parametrize("colour", [False, True])
def test_lights_that_dim_a_fifth_in_five_minutes_leave_the_masks_clean(scene, colour):
    room, still = Room(scene, colour), Room(scene, colour, BackgroundSettings())
    for light in np.linspace(1.0, 0.8, 300):
        silhouette = room.see(light)
        assert silhouette.foreground_fraction < 0.001
    assert room.pipeline.gain == pytest.approx(0.8, rel=0.02)
    assert iou(room.see(0.8, scene.person_mask()).image_mask, scene.person_mask()) > 0.95
    assert room.noise(0.8) < 0.01 < 0.5 < still.noise(0.8)


def test_person_who_stands_still_for_ten_minutes_stays_whole_and_leaves_no_ghost(scene):
    room, person = Room(scene), scene.person_mask()
    for _ in range(50):
        room.see()
    first = iou(room.see(1.0, person).image_mask, person)
    scores = [iou(room.see(1.0, person).image_mask, person) for _ in range(600)]
    assert first > 0.97 and min(scores) > first - 0.02
    assert room.see().foreground_fraction == 0


def test_person_who_stands_still_while_the_light_dims_stays_whole(scene):
    room, person = Room(scene), scene.person_mask()
    scores = [iou(room.see(light, person).image_mask, person) for light in np.linspace(1.0, 0.8, 300)]
    assert min(scores[20:]) > 0.93
    assert room.see(0.8).foreground_fraction < 0.001  # the place behind the person dimmed, too


def test_sunlight_that_creeps_over_a_wall_is_followed_up_to_the_bound(scene):
    room = Room(scene)

    def sun(by):
        return lambda image: np.where(np.arange(160) < 50, np.clip(image + by, 0, 255), image).astype(np.uint8)

    for by in np.linspace(0, 10, 600):  # a grey level a minute
        assert room.see(sun=sun(by)).foreground_fraction < 0.002
    for by in np.linspace(10, 60, 300):
        last = room.see(sun=sun(by))
    assert last.foreground_fraction > 0.2  # beyond 12 grey levels it is a thing, not a drift


def test_lights_switched_off_are_flagged_and_not_absorbed(scene):
    room = Room(scene)
    checks = FrameChecks(None, room.background.mean)
    for _ in range(60):
        room.see()
    for _ in range(120):
        silhouette = room.see(0.45)
        assert silhouette.flags == (FULL,)
    assert room.pipeline.gain == pytest.approx(1.0, rel=0.01)
    dark = lit(room.empty[0].astype(float), 0.45)
    assert checks.check(dark, 0, room.pipeline.gain) == (LIGHTS,)
    assert room.see().foreground_fraction == 0  # switched on again, all is as before


def test_thing_put_down_beside_the_person_stays_foreground(scene):
    room = Room(scene)
    for _ in range(50):
        room.see()
    thing = np.zeros((120, 160), np.uint8)
    thing[85:110, 100:120] = 255
    for _ in range(300):
        silhouette = room.see(1.0, thing)
    assert iou(silhouette.image_mask, thing) > 0.9


def test_without_following_the_limits_stay_as_learned(scene):
    room = Room(scene, settings=BackgroundSettings())
    expected = room.background.limits(BackgroundSettings())
    for light in np.linspace(1.0, 0.8, 60):
        room.see(light)
    assert np.array_equal(room.pipeline.limits.lo, expected.lo)
    assert np.array_equal(room.pipeline.limits.hi, expected.hi)
    assert room.pipeline.gain == 1.0


def test_frames_without_stamps_are_not_followed(scene):
    room = Room(scene)
    for _ in range(50):
        room.pipeline.run(lit(room.empty[0].astype(float), 0.95))
    assert room.pipeline.gain == 1.0


def test_same_stamps_give_the_same_masks_and_a_clock_set_back_does_no_harm(scene):
    one, two = Room(scene), Room(scene)
    for light in np.linspace(1.0, 0.95, 100):
        assert np.array_equal(one.see(light).image_mask, two.see(light).image_mask)
    gain, one.frames = one.pipeline.gain, 0
    assert one.see(0.95).foreground_fraction < 0.001
    assert one.pipeline.gain == pytest.approx(gain, rel=1e-3)


def test_a_frame_costs_a_band_of_rows_and_not_the_whole_image(scene):
    """Counted in rows whose limits may change, at 60 frames a second; time is measured by the benchmark."""
    room = Room(scene)
    room.pipeline.run(room.empty[0], 0)
    before = room.pipeline.limits.lo.copy()
    room.pipeline._drift.gain = 0.9
    room.pipeline.run(room.empty[1], SECOND_NS // 60)
    assert 0 < (before != room.pipeline.limits.lo).any(axis=1).sum() <= 3
