"""A background that was good once: what is noticed when the room, the light or the camera is no longer the same."""

import datetime

import numpy as np
import pytest

from camera_client.background.model import BackgroundLearner, Provenance, read_background
from camera_client.background.watch import BackgroundFit, BackgroundWatch, age_h, concerns, unfit
from camera_client.settings import BackgroundSettings, BackgroundWatchSettings
from camera_client.silhouettes.pipeline import SilhouettePipeline
from camera_client.sources.footage_reader import open_footage
from capture_rig.verdict import REDO

SETTINGS = BackgroundWatchSettings()
NOISE = 1.5  # grey levels, of the scene's images
PERIOD_NS = 500_000_000


def learned(images):
    learner = BackgroundLearner()
    for image in images:
        learner.add(image)
    return learner.model("test")


class Room:
    """The empty scene learned, and a watch that sees what is done to it, two frames a second."""

    def __init__(self, scene, colour=False):
        self.background = learned(scene.empty(60, colour=colour))
        self.limits = self.background.limits(BackgroundSettings())
        self.watch = BackgroundWatch(self.background, self.limits, SETTINGS)
        self.frames, self.k = scene.empty(20, seed=7, colour=colour), 0

    def see(self, seconds, change=lambda image, second: image):
        for _ in range(round(2 * seconds)):
            self.k += 1
            self.watch.update(change(self.frames[self.k % 20].copy(), self.k / 2), 1 + self.k * PERIOD_NS)
        return self.watch.found

    def concerns(self):
        return lines(self.background.provenance, {}, self.watch.found, SETTINGS, self.background.shape)


def lines(*given, **more):
    """What the concerns say, each of which has a code."""
    found = concerns(*given, **more)
    assert all(finding.code for finding in found)
    return tuple(finding.line for finding in found)


def brighter(factor):
    return lambda image, second: np.clip(np.rint(image * factor), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("colour", [False, True])
def test_unchanged_room_gives_no_concern_for_ten_minutes(scene, colour):
    room = Room(scene, colour)
    found = room.see(600)
    assert abs(found.gain_drift) < 0.002 and found.static_share == 0.0
    assert room.concerns() == ()


@pytest.mark.parametrize("factor", [0.96, 1.02, 1.05])
def test_drift_of_the_light_is_measured(scene, factor):
    found = Room(scene).see(120, brighter(factor))
    assert found.gain_drift == pytest.approx(factor - 1, abs=0.003)


def test_drift_is_told_when_it_has_used_up_half_of_what_the_noise_bears(scene):
    room = Room(scene)
    half_of_all = room.see(1).tolerance  # 3.9 sigma of 1.5 grey levels at 130: 4.5 %
    assert half_of_all == pytest.approx(3.89 * NOISE / 130, rel=0.15)
    room.see(60, brighter(1 + 0.35 * half_of_all))
    assert room.concerns() == ()
    room.see(60, brighter(1 + 0.75 * half_of_all))
    assert len(room.concerns()) == 1
    assert "the light changed by +3." in room.concerns()[0] and "run sagoma background" in room.concerns()[0]


def test_drift_that_is_followed_is_no_concern(scene):
    background = learned(scene.empty(60))
    pipeline = SilhouettePipeline(scene.camera(), background)
    watch = BackgroundWatch(background, background.limits(BackgroundSettings()), SETTINGS)
    for k in range(200):
        image, stamp_ns = brighter(1 + 0.3 * k / 200)(scene.empty(1, seed=k % 5)[0], 0), 1 + 2 * k * PERIOD_NS
        pipeline.run(image, stamp_ns)
        watch.update(image, stamp_ns, pipeline.gain, pipeline.background_pixels)
    assert pipeline.gain == pytest.approx(1.3, rel=0.01) and watch.found.static_share == 0
    assert lines(background.provenance, {}, watch.found, SETTINGS, background.shape, corrected=pipeline.gain) == ()


def test_drift_of_a_background_that_follows_nothing_names_the_rule_that_does(scene):
    provenance, beyond = learned(scene.empty(5)).provenance, BackgroundFit(gain_drift=0.1, tolerance=0.05)
    (said,) = lines(provenance, {}, beyond, SETTINGS, (120, 160))
    assert "the light changed by +10.0 %" in said and "background_model.rule: adaptive" in said


def test_somebody_who_walks_about_is_neither_drift_nor_furniture(scene):
    def walk(image, second):
        column = int(80 + 70 * np.sin(second / 3))
        shadowed = slice(max(column - 25, 0), column + 25)
        image[90:, shadowed] = image[90:, shadowed] * 0.7
        return scene.with_person(image, np.roll(scene.person_mask(), column - 80, axis=1))

    room = Room(scene)
    found = room.see(900, walk)
    assert abs(found.gain_drift) < 0.01 and found.static_share == 0.0
    assert room.concerns() == ()


def test_somebody_who_moves_on_the_spot_is_no_furniture(scene):
    def jog(image, second):
        mask, clothes = scene.person_mask() > 0, 60 + 40 * np.sin(9 * second + np.arange(scene.width) / 3)
        image[mask] = np.broadcast_to(clothes, mask.shape)[mask]
        return image

    room = Room(scene)
    assert room.see(600, jog).static_share == 0.0
    assert room.concerns() == ()


def test_somebody_who_stands_still_for_two_minutes_is_no_furniture(scene):
    room = Room(scene)
    assert room.see(120, lambda image, second: scene.with_person(image)).static_share == 0.0
    assert room.concerns() == ()


def test_chair_that_was_left_in_the_room_is_told_after_five_minutes_with_its_place(scene):
    def chair(image, second):
        image[80:110, 100:130] = 20
        return image

    room = Room(scene)
    room.see(240, chair)
    assert room.concerns() == ()
    found = room.see(120, chair)
    assert found.static_share == pytest.approx(30 * 30 / (160 * 120), rel=0.25)
    place = found.static_places[0]
    assert abs(place.left - 100) <= 3 and abs(place.right - 129) <= 3 and abs(place.top - 80) <= 3
    assert "lower right" in room.concerns()[0] and "5 minutes" in room.concerns()[0]
    room.see(60)
    assert room.concerns() == ()  # taken away again


def test_person_near_the_camera_does_not_pass_for_a_change_of_light(scene):
    def close(image, second):
        image[:, :110] = 60
        return image

    found = Room(scene).see(60, close)
    assert found.gain_drift is None


LEARNED_AT = Provenance("camera", 100, 1.5, camera_serial="4711", exposure_us="5000", gain="0")


@pytest.mark.parametrize(
    "now, text",
    [
        (
            {"exposure_us": "8000"},
            "the exposure is 8000 us, the background was learned at 5000 us (corrected by x 1.60)",
        ),
        ({"gain": "6"}, "the gain is 6, the background was learned at 0 (corrected by x 1.60)"),
    ],
)
def test_setting_that_it_was_not_learned_at_is_named_with_the_correction(now, text):
    (said,) = lines(LEARNED_AT, now, BackgroundFit(), SETTINGS, (120, 160), corrected=1.6)
    assert said.startswith(text) and "sagoma background" in said
    (said,) = lines(LEARNED_AT, now, BackgroundFit(), SETTINGS, (120, 160))
    assert "corrected" not in said
    assert unfit(LEARNED_AT, now) is None


@pytest.mark.parametrize(
    "now, code",
    [
        ({"camera_serial": "4712"}, "background.other_camera"),  # the next one of the series
        ({"exposure_us": "21000"}, "background.other_exposure"),
        ({"exposure_us": "1200"}, "background.other_exposure"),
    ],
)
def test_background_that_cannot_be_corrected_is_unfit(now, code):
    reason = unfit(LEARNED_AT, now)
    assert (reason.grade, reason.code) == (REDO, code) and "sagoma background" in reason.line


@pytest.mark.parametrize("now", [{}, {"exposure_us": "5000.02"}, {"gain": "0.005"}, {"camera_serial": "4711"}])
def test_settings_that_are_the_same_or_unknown_are_no_concern(now):
    assert concerns(LEARNED_AT, now, BackgroundFit(), SETTINGS, (120, 160)) == () and unfit(LEARNED_AT, now) is None
    unknown, other = Provenance("video", 100, 1.5), {"camera_serial": "1", "gain": "6", "exposure_us": "90000"}
    assert concerns(unknown, other, BackgroundFit(), SETTINGS, ()) == () and unfit(unknown, other) is None


def test_old_background_of_a_live_camera_is_told_in_hours_and_footage_is_never_old():
    created = datetime.datetime(2026, 3, 1, 8, tzinfo=datetime.UTC)
    provenance = Provenance("camera", 100, 1.5, created=created.isoformat())
    now_s = created.timestamp() + 13 * 3600
    assert age_h(provenance, now_s) == pytest.approx(13.0)
    assert "13 h old" in lines(provenance, {}, BackgroundFit(), SETTINGS, (), now_s)[0]
    assert concerns(provenance, {}, BackgroundFit(), SETTINGS, (), now_s - 2 * 3600) == ()
    assert concerns(provenance, {}, BackgroundFit(), BackgroundWatchSettings(age_h=0.0), (), now_s) == ()
    assert concerns(provenance, {}, BackgroundFit(), SETTINGS, (), None) == ()
    assert age_h(Provenance("video", 100, 1.5), now_s) is None


def test_clock_that_is_set_back_starts_the_watch_anew_without_an_error(scene):
    room = Room(scene)
    room.see(30)
    room.k = 2
    assert abs(room.see(30).gain_drift) < 0.002


def test_rendered_dance_on_the_spot_for_ten_minutes_raises_no_concern(shared_data):
    folder, settings = shared_data("sessions", "charleston_ring5top"), BackgroundSettings()
    video = open_footage(folder / "cam01.mp4")
    background = read_background(folder / "cam01_background.mp4", video.probe(), settings)
    watch = BackgroundWatch(background, background.limits(settings), SETTINGS)
    frames = []
    while len(frames) < 200 and (image := video.read()) is not None:
        frames.append(image)
    video.close()
    for k in range(1200):
        watch.update(frames[7 * k % len(frames)], 1 + k * PERIOD_NS)
    assert watch.found.gain_drift is not None
    assert concerns(background.provenance, {}, watch.found, SETTINGS, background.shape) == ()
