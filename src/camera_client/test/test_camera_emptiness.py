"""Was the room empty? The background that is to be replaced tells; and the report of a lesson that programs read."""

from dataclasses import replace

import numpy as np
import pytest

from camera_client.background_model import BackgroundLearner, BackgroundModel, load_background
from camera_client.emptiness import changed_places
from camera_client.lesson_report import LessonReport, report_of
from camera_client.live_learning import LiveLearning
from capture_rig.verdict import GOOD, REDO, USABLE


def learned(images):
    learner = BackgroundLearner()
    for image in images:
        learner.add(image)
    return learner.model("before", created="2026-03-01T08:00:00+00:00")


def lesson(images, before=None):
    learning = LiveLearning(len(images), "camera", before)
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
    place = changed_places(learned(statue), before)[0]
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
    assert changed_places(learned([np.roll(image, 1, axis=1) for image in scene.empty(30, seed=4)]), before) == []


def test_background_of_another_size_or_none_tells_nothing(scene):
    before = learned([image[:100] for image in scene.empty(30)])
    assert lesson(scene.empty(30), before).verdict.grade == lesson(scene.empty(30)).verdict.grade == GOOD


def test_report_of_a_good_lesson_survives_its_journey(scene):
    learning = lesson(scene.empty(30))
    report = report_of(learning, 3, "good; ...", learning.model, "bg.npz")
    assert (report.number, report.grade, report.frames, report.saved) == (3, GOOD, 30, "bg.npz")
    assert report.noise == pytest.approx(1.5, rel=0.05) and report.moved == 0.0
    assert LessonReport.from_json(report.to_json()) == report


def test_report_of_a_refused_lesson_tells_findings_and_figures(scene):
    images = scene.empty(30)
    for k, image in enumerate(images):
        image[20:100, 4 * k : 4 * k + 25] = 250
    learning = lesson(images)
    report = LessonReport.from_json(report_of(learning, 1, learning.refusal).to_json())
    assert report.grade == REDO and report.moved > 0.1
    assert "something moved" in report.findings[0].what and "clear the scene" in report.findings[0].remedy


def test_report_of_a_lesson_without_an_end_or_whose_model_cannot_be_used_is_redo(scene):
    learning = LiveLearning(5, "camera")
    learning.cancel("the camera went away")
    assert report_of(learning, 1, learning.refusal).grade == REDO
    assert report_of(lesson(scene.empty(30)), 2, "is of another size").grade == REDO


def test_camera_that_was_bumped_after_its_calibration_makes_a_good_lesson_usable(scene):
    learning = lesson(scene.empty(30))
    about = replace(learning.model.provenance, camera_turn_rad="0.0 0.0349 0.0", calibration="x")
    report = report_of(learning, 1, "good; ...", BackgroundModel(learning.model.mean, learning.model.sigma, about))
    assert report.grade == USABLE
    assert "turned by 2.0 degrees" in report.findings[0].what and "calibrate it again" in report.findings[0].remedy


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"findings": [{}]}', '{"findings": [], "number": 1, "other": 2}'])
def test_text_that_is_no_report_is_refused(text):
    with pytest.raises(ValueError):
        LessonReport.from_json(text)


def test_what_the_camera_told_of_itself_is_saved_with_the_background(tmp_path, scene):
    about = {
        "camera_serial": "S1",
        "camera_model": "Acme One",
        "exposure_us": "5000",
        "gain": "0",
        "pixel_format": "Mono8",
        "temperature_c": "41.5",
    }
    learning = LiveLearning(10, "camera", created="2026-03-01T08:00:00+00:00", **about)
    for image in scene.empty(10):
        learning.add(image)
    learning.model.save(tmp_path / "bg.npz")
    loaded = load_background(tmp_path / "bg.npz").provenance
    assert {key: getattr(loaded, key) for key in about} == about
    assert (loaded.created, loaded.frames) == ("2026-03-01T08:00:00+00:00", 10)
