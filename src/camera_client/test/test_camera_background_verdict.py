"""The verdict on a background that was just learned."""

import numpy as np
import pytest
from camera_pictures import learned

from camera_client.background.model import BackgroundLearner
from camera_client.background.training_verdict import changed_regions, describe_background, judge_background
from capture_rig.verdict import GOOD, REDO, USABLE


def verdict_on(images, before=None):
    learner = BackgroundLearner()
    for image in images:
        learner.add(image)
    return judge_background(learner.model("test camera"), learner.brightness, before)


def scaled(images, factors):
    return [np.clip(np.rint(i * f), 0, 255).astype(np.uint8) for i, f in zip(images, factors, strict=True)]


@pytest.mark.parametrize("colour", [False, True])
def test_quiet_scene_is_good(scene, colour):
    images = scene.empty(60, colour=colour)
    verdict = verdict_on(images)
    assert (verdict.grade, verdict.findings, str(verdict)) == (GOOD, (), "good")
    model = learned(images, "test camera").with_provenance(verdict=str(verdict))
    assert describe_background(model).startswith("good; 60 frames of test camera, mean noise 1.5")


def walk(image, k):
    image[70:110, 5 + k // 2 : 15 + k // 2] = 240  # sweeps columns 5..43 of rows 70..109


def blink(image, k):
    image[10:16, 140:150] = 250 * (k % 2)  # a lamp of 60 of 19200 pixels


def shake(image, k):
    chessboard = np.kron(np.random.default_rng(0).integers(0, 2, (30, 40)), np.ones((4, 4))) * 120 + 60
    image[:] = np.roll(chessboard, k % 3 - 1, axis=1)


@pytest.mark.parametrize(
    "change, grade, text",
    [
        (walk, REDO, "something moved: lower left at 5..43, 70..109: 8."),
        (blink, USABLE, "upper right at 140..149, 10..15: 0.3 %"),
        (shake, REDO, "see that the camera stands firm"),
    ],
)
def test_movement_is_located_and_graded_by_its_size(scene, change, grade, text):
    images = scene.empty(60)
    for k, image in enumerate(images):
        change(image, k)
    verdict = verdict_on(images)
    assert verdict.grade == grade and text in str(verdict) and "clear the scene" in str(verdict)


def cap(scene):
    rng = np.random.default_rng(0)
    return [rng.integers(0, 5, (120, 160), dtype=np.uint8) for _ in range(30)]


FLICKER = 1 + 0.04 * np.sin(np.arange(60) * 1.9)  # standard deviation 2.8 %


def white(rows):
    """The scene with a window of so many rows, of 120."""
    return lambda scene: [np.vstack([np.full((rows, 160), 255, np.uint8), image[rows:]]) for image in scene.empty(30)]


JUDGED = {
    "enough": (lambda scene: scene.empty(25), GOOD, []),
    "few": (lambda scene: scene.empty(5), USABLE, ["too few pictures"]),
    "white line": (white(1), GOOD, []),
    "white window": (white(12), USABLE, []),
    "half white": (white(60), REDO, []),
    "lens cap": (cap, REDO, ["lens cap"]),
    "dim": (lambda scene: scaled(scene.empty(30), [0.2] * 30), USABLE, ["dim, 26 grey levels", "exposure"]),
    "noisy": (lambda scene: scene.empty(40, noise=9.0), USABLE, ["noise is high, 8.9"]),
    "mains": (lambda scene: scaled(scene.empty(60), FLICKER), USABLE, ["flickers by 2.8 %", "10 ms at 50 Hz"]),
    "warming up": (lambda scene: scaled(scene.empty(60), np.linspace(1, 1.06, 60)), USABLE, ["changed by +5."]),
}


@pytest.mark.parametrize("images, grade, texts", JUDGED.values(), ids=JUDGED)
def test_frames_light_and_noise_are_judged_with_a_remedy(scene, images, grade, texts):
    verdict = verdict_on(images(scene))
    assert verdict.grade == grade and all(text in str(verdict) for text in texts)
    assert ("flickers" in str(verdict)) == ("flickers by 2.8 %" in texts)


# --- Was the room empty? The background that is to be replaced tells.


@pytest.mark.parametrize("colour", [False, True])
def test_somebody_who_stood_still_all_the_time_is_found_by_the_background_before(scene, colour):
    before = learned(scene.empty(30, colour=colour), created="2026-03-01T08:00:00+00:00")
    statue = [scene.with_person(image) for image in scene.empty(30, seed=4, colour=colour)]
    verdict = verdict_on(statue, before)
    assert verdict.grade == USABLE
    assert "something else than in the background of 2026-03-01T08:00:00+00:00: in the middle at 6" in str(verdict)
    assert "clear the room and learn again" in str(verdict)
    place = changed_regions(learned(statue), before)[0]
    rows, columns = np.nonzero(scene.person_mask())
    assert abs(place.left - columns.min()) <= 4 and abs(place.right - columns.max()) <= 4
    assert abs(place.top - rows.min()) <= 4 and abs(place.bottom - rows.max()) <= 4
    assert place.share == pytest.approx((scene.person_mask() > 0).mean(), rel=0.2)


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.3])
def test_empty_room_under_other_light_is_good(scene, factor):
    before = learned(scene.empty(30))
    again = [np.clip(np.rint(image * factor), 0, 255).astype(np.uint8) for image in scene.empty(30, seed=4)]
    assert str(verdict_on(again, before)) == "good"


def test_background_that_was_read_and_never_judged_is_judged_when_it_is_described(scene):
    model = learned([image // 6 for image in scene.empty(60)], "empty.mp4")
    assert describe_background(model).startswith("usable: the image is dim")


def test_camera_that_was_bumped_a_little_is_no_sign_of_somebody(scene):
    before = learned(scene.empty(30))
    bumped = learned([np.roll(image, 1, axis=1) for image in scene.empty(30, seed=4)])
    assert changed_regions(bumped, before) == []
