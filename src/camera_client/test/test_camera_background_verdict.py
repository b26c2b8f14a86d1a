"""The verdict on a background that was just learned."""

from dataclasses import replace

import numpy as np
import pytest

from camera_client.background.model import BackgroundLearner, BackgroundModel, load_background
from camera_client.background.training import TrainingReport, TrainingRun, describe, training_report
from camera_client.background.verdict import changed_regions
from capture_rig.verdict import GOOD, REDO, USABLE


def learn(images):
    learning = TrainingRun(len(images), "test camera")
    for image in images:
        learning.add(image)
    assert learning.done
    return learning


def scaled(images, factors):
    return [np.clip(np.rint(i * f), 0, 255).astype(np.uint8) for i, f in zip(images, factors, strict=True)]


@pytest.mark.parametrize("colour", [False, True])
def test_quiet_scene_is_good(scene, colour):
    learning = learn(scene.empty(60, colour=colour))
    assert (learning.verdict.grade, learning.verdict.findings) == (GOOD, ())
    assert str(learning.verdict) == "good"
    assert describe(learning.model).startswith("good; 60 frames of test camera, mean noise 1.5")


def test_somebody_walking_through_is_refused_and_located(scene):
    images = scene.empty(60)
    for k, image in enumerate(images):
        image[70:110, 5 + k // 2 : 15 + k // 2] = 240  # sweeps columns 5..43 of rows 70..109
    learning = learn(images)
    assert learning.verdict.grade == REDO and learning.model is None
    assert "something moved: lower left at 5..43, 70..109: 8." in learning.refusal
    assert "clear the scene" in learning.refusal


def test_small_movement_is_usable_and_located(scene):
    images = scene.empty(60)
    for k, image in enumerate(images):
        image[10:16, 140:150] = 250 * (k % 2)  # a blinking lamp of 60 of 19200 pixels
    learning = learn(images)
    assert learning.verdict.grade == USABLE
    assert "upper right at 140..149, 10..15: 0.3 %" in str(learning.verdict)
    assert learning.model.provenance.verdict == str(learning.verdict)


def test_camera_that_shakes_is_refused(scene):
    base = np.kron(np.random.default_rng(0).integers(0, 2, (30, 40)), np.ones((4, 4))) * 120 + 60
    learning = learn([np.roll(base, k % 3 - 1, axis=1).astype(np.uint8) for k in range(30)])
    assert learning.verdict.grade == REDO
    assert "something moved: " in learning.refusal and "stands firm" in learning.refusal


@pytest.mark.parametrize("frames, grade", [(5, USABLE), (25, GOOD)])
def test_few_frames_are_usable_only(scene, frames, grade):
    assert learn(scene.empty(frames)).verdict.grade == grade


def test_lens_cap_is_refused():
    rng = np.random.default_rng(0)
    learning = learn([rng.integers(0, 5, (120, 160), dtype=np.uint8) for _ in range(30)])
    assert learning.verdict.grade == REDO and "lens cap" in learning.refusal


@pytest.mark.parametrize("rows, grade", [(1, GOOD), (12, USABLE), (60, REDO)])
def test_white_parts_are_weighed_by_their_size(scene, rows, grade):
    images = scene.empty(30)
    for image in images:
        image[:rows] = 255
    assert learn(images).verdict.grade == grade


def test_dim_scene_is_usable_with_a_remedy(scene):
    learning = learn(scaled(scene.empty(30), [0.2] * 30))
    assert learning.verdict.grade == USABLE
    assert "dim, 26 grey levels" in str(learning.verdict) and "exposure" in str(learning.verdict)


def test_high_and_absent_noise_are_noticed(scene):
    assert "noise is high, 8.9" in str(learn(scene.empty(40, noise=9.0)).verdict)
    assert "suspiciously low, 0.00" in str(learn([scene.empty(1)[0]] * 30).verdict)


def test_flicker_of_the_mains_is_measured(scene):
    beat = 1 + 0.04 * np.sin(np.arange(60) * 1.9)  # standard deviation 2.8 %
    learning = learn(scaled(scene.empty(60), beat))
    assert learning.verdict.grade == USABLE
    assert "flickers by 2.8 %" in str(learning.verdict) and "10 ms at 50 Hz" in str(learning.verdict)


def test_lamps_that_warm_up_are_noticed(scene):
    learning = learn(scaled(scene.empty(60), np.linspace(1, 1.06, 60)))
    assert "changed by +5." in str(learning.verdict) and "flickers" not in str(learning.verdict)


def test_verdict_is_saved_with_the_model_and_models_without_one_load(tmp_path, scene):
    model = learn(scene.empty(10)).model
    model.save(tmp_path / "bg.npz")
    verdict = load_background(tmp_path / "bg.npz").provenance.verdict
    assert verdict.startswith("usable: 10 frames tell the noise to 24 %")
    with np.load(tmp_path / "bg.npz") as file:
        arrays, about = {"mean": file["mean"], "sigma": file["sigma"]}, str(file["about"])
    older = about[: about.index(', "verdict"')] + "}"
    np.savez(tmp_path / "old.npz", about=np.array(older), **arrays)
    assert load_background(tmp_path / "old.npz").provenance.verdict == ""


def test_cancelled_learning_has_no_verdict(scene):
    learning = TrainingRun(5, "test")
    learning.add(scene.empty(1)[0])
    learning.cancel("the camera was suspended")
    assert learning.verdict is None and learning.refusal == "the camera was suspended after 1 of 5 frames"


# --- Was the room empty? The background that is to be replaced tells; and the report of a lesson that programs read.


def learned(images):
    learner = BackgroundLearner()
    for image in images:
        learner.add(image)
    return learner.model("before", created="2026-03-01T08:00:00+00:00")


def lesson(images, before=None):
    learning = TrainingRun(len(images), "camera", before)
    for image in images:
        learning.add(image)
    return learning


@pytest.mark.parametrize("colour", [False, True])
def test_somebody_who_stood_still_all_the_time_is_found_by_the_background_before(scene, colour):
    before = learned(scene.empty(30, colour=colour))
    statue = [scene.with_person(image) for image in scene.empty(30, seed=4, colour=colour)]
    verdict = lesson(statue, before).verdict
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
    assert lesson(again, before).verdict.grade == GOOD


def test_camera_that_was_bumped_a_little_is_no_sign_of_somebody(scene):
    before = learned(scene.empty(30))
    assert changed_regions(learned([np.roll(image, 1, axis=1) for image in scene.empty(30, seed=4)]), before) == []


def test_background_of_another_size_or_none_tells_nothing(scene):
    before = learned([image[:100] for image in scene.empty(30)])
    assert lesson(scene.empty(30), before).verdict.grade == lesson(scene.empty(30)).verdict.grade == GOOD


def test_report_of_a_good_lesson_survives_its_journey(scene):
    learning = lesson(scene.empty(30))
    report = training_report(learning, 3, "good; ...", learning.model, "bg.npz")
    assert (report.number, report.grade, report.frames, report.saved) == (3, GOOD, 30, "bg.npz")
    assert report.noise == pytest.approx(1.5, rel=0.05) and report.moved == 0.0
    assert TrainingReport.from_json(report.to_json()) == report


def test_report_of_a_refused_lesson_tells_findings_and_figures(scene):
    images = scene.empty(30)
    for k, image in enumerate(images):
        image[20:100, 4 * k : 4 * k + 25] = 250
    learning = lesson(images)
    report = TrainingReport.from_json(training_report(learning, 1, learning.refusal).to_json())
    assert report.grade == REDO and report.moved > 0.1
    assert "something moved" in report.findings[0].what and "clear the scene" in report.findings[0].remedy


def test_report_of_a_lesson_without_an_end_or_whose_model_cannot_be_used_is_redo(scene):
    learning = TrainingRun(5, "camera")
    learning.cancel("the camera went away")
    assert training_report(learning, 1, learning.refusal).grade == REDO
    assert training_report(lesson(scene.empty(30)), 2, "is of another size").grade == REDO


def test_camera_that_was_bumped_after_its_calibration_makes_a_good_lesson_usable(scene):
    learning = lesson(scene.empty(30))
    about = replace(learning.model.provenance, camera_turn_rad="0.0 0.0349 0.0", calibration="x")
    report = training_report(
        learning, 1, "good; ...", BackgroundModel(learning.model.mean, learning.model.sigma, about)
    )
    assert report.grade == USABLE
    assert "turned by 2.0 degrees" in report.findings[0].what and "calibrate it again" in report.findings[0].remedy


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"findings": [{}]}', '{"findings": [], "number": 1, "other": 2}'])
def test_text_that_is_no_report_is_refused(text):
    with pytest.raises(ValueError):
        TrainingReport.from_json(text)


def test_what_the_camera_told_of_itself_is_saved_with_the_background(tmp_path, scene):
    about = {
        "camera_serial": "S1",
        "camera_model": "Acme One",
        "exposure_us": "5000",
        "gain": "0",
        "pixel_format": "Mono8",
        "temperature_c": "41.5",
    }
    learning = TrainingRun(10, "camera", created="2026-03-01T08:00:00+00:00", **about)
    for image in scene.empty(10):
        learning.add(image)
    learning.model.save(tmp_path / "bg.npz")
    loaded = load_background(tmp_path / "bg.npz").provenance
    assert {key: getattr(loaded, key) for key in about} == about
    assert (loaded.created, loaded.frames) == ("2026-03-01T08:00:00+00:00", 10)
