"""Requests to learn the background: one at a time, each with exactly one report."""

import json

import numpy as np
import pytest

from camera_client.background.model import load_background
from camera_client.background.training import BackgroundTrainer, TrainingReport
from capture_rig.errors import InputError
from capture_rig.verdict import GOOD, REDO, USABLE


def images(count):
    rng = np.random.default_rng(0)
    for _ in range(count):
        yield np.clip(np.rint(rng.normal(100, 2, (40, 50))), 0, 255).astype(np.uint8)


def train(pictures, use=lambda model: model, **request):
    """The report of a training with all of ``pictures``."""
    pictures, trainer = list(pictures), BackgroundTrainer(use)
    over = trainer.begin(len(pictures), "camera x", **request)
    for picture in pictures:
        trainer.add(picture)
    return over.result(timeout=0)


def test_training_takes_the_wanted_frames_and_no_more():
    used = []
    trainer = BackgroundTrainer(lambda model: used.append(model) or model)
    over = trainer.begin(10, "camera x", about={"camera_serial": "S1"})
    for k, image in enumerate(images(12)):
        assert trainer.busy == (k < 10) != over.done()
        assert trainer.progress == (f"{k}/10" if k < 10 else "")
        trainer.add(image)
    trainer.cancel("too late")
    (model,), report = used, over.result(timeout=0)
    assert report.success and report.frames == model.provenance.frames == 10
    assert model.provenance.mean_noise == pytest.approx(2.0, rel=0.1)
    assert (model.provenance.source, model.provenance.camera_serial) == ("camera x", "S1")
    assert "camera_client" in model.provenance.software


def test_second_request_is_refused_while_the_first_is_under_way():
    trainer = BackgroundTrainer(lambda model: model)
    first = trainer.begin(3, "camera")
    with pytest.raises(InputError, match="learning already"):
        trainer.begin(3, "camera")
    for image in images(3):
        trainer.add(image)
    second = trainer.begin(3, "camera")
    assert trainer.busy and first.result(timeout=0).number == 1 and not second.done()


def test_cancelled_training_is_reported_with_the_reason_and_how_far_it_came():
    trainer = BackgroundTrainer(lambda model: model)
    over = trainer.begin(3, "camera")
    trainer.add(next(images(1)))
    trainer.cancel("the camera was suspended")
    trainer.cancel("once more")
    report = over.result(timeout=0)
    assert (report.success, report.text) == (False, "the camera was suspended after 1 of 3 frames")
    assert (report.grade, report.findings, trainer.busy) == (REDO, (), False)


def test_training_with_changing_sizes_is_refused():
    report = train([np.zeros((4, 5), np.uint8), np.zeros((5, 5), np.uint8), np.zeros((5, 5), np.uint8)])
    assert not report.success and "5 x 5 mono" in report.text


@pytest.mark.parametrize(
    ("error", "text"), [(InputError("is of another size"), "is of another size."), (OSError("gone"), "OSError('gone')")]
)
def test_background_that_cannot_be_used_is_reported_with_the_error(error, text):
    def refuse(model):
        raise error

    report = train(images(30), refuse)
    assert (report.success, report.grade, report.frames) == (False, REDO, 30) and text in report.text


def test_background_is_saved_with_what_the_camera_told_of_itself(tmp_path):
    about = {
        "camera_serial": "S1",
        "camera_model": "Acme One",
        "exposure_us": "5000",
        "gain": "0",
        "pixel_format": "Mono8",
        "temperature_c": "41.5",
    }
    path = str(tmp_path / "bg.npz")
    report = train(images(10), file=path, about={**about, "created": "2026-03-01T08:00:00+00:00"})
    assert report.saved == path and report.text.endswith(f"saved to {path}")
    loaded = load_background(path).provenance
    assert {key: getattr(loaded, key) for key in about} == about
    assert (loaded.created, loaded.frames) == ("2026-03-01T08:00:00+00:00", 10)
    assert loaded.verdict.startswith("usable: too few pictures to measure the noise: 10")


def test_background_that_cannot_be_saved_is_used_all_the_same(tmp_path):
    (tmp_path / "file").write_text("in the way")
    report = train(images(30), file=str(tmp_path / "file" / "bg.npz"))
    assert (report.success, report.saved) == (True, "") and "in use, but not saved" in report.text


def test_report_of_a_good_training_survives_its_journey(scene):
    report = train(scene.empty(30))
    assert (report.number, report.grade, report.frames, report.findings) == (1, GOOD, 30, ())
    assert report.noise == pytest.approx(1.5, rel=0.05) and report.moved == 0.0
    assert TrainingReport.from_json(report.to_json()) == report


def test_training_while_something_moves_is_refused_with_findings_and_figures(scene):
    pictures, used = scene.empty(30), []
    for k, picture in enumerate(pictures):
        picture[20:100, 4 * k : 4 * k + 25] = 250
    text = train(pictures, used.append).to_json()
    report = TrainingReport.from_json(text)
    assert (report.success, report.grade, used) == (False, REDO, []) and report.moved > 0.1
    assert "something moved" in report.text and "% of the pixels" in report.text
    assert "something moved" in report.findings[0].what and "clear the scene" in report.findings[0].remedy
    values = json.loads(text)  # as other programs read it
    assert values["grade"] == REDO and "clear the scene" in values["findings"][0]["remedy"]


def test_camera_that_was_bumped_after_its_calibration_makes_a_good_training_usable(scene):
    report = train(
        scene.empty(30), lambda model: model.with_provenance(camera_turn_rad="0.0 0.0349 0.0", calibration="x")
    )
    assert (report.grade, report.success) == (USABLE, True)
    assert "turned by 2.0 degrees" in report.findings[0].what and "calibrate it again" in report.findings[0].remedy


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"findings": [{}]}', '{"findings": [], "number": 1, "other": 2}'])
def test_text_that_is_no_report_is_refused(text):
    with pytest.raises(ValueError):
        TrainingReport.from_json(text)
