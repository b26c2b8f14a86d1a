"""Requests to learn the background: one at a time, each answered once."""

import numpy as np
import pytest

from camera_client.background.training import BackgroundTrainer, TrainingRun
from capture_rig.errors import InputError


def images(count):
    rng = np.random.default_rng(0)
    return [np.clip(np.rint(rng.normal(100, 2, (40, 50))), 0, 255).astype(np.uint8) for _ in range(count)]


def keep(model):
    return f"kept {model.provenance.frames} frames"


def test_lesson_is_answered_once_when_its_last_frame_came():
    desk, answers = BackgroundTrainer(keep), []
    desk.begin(TrainingRun(3, "camera"), answers.append)
    for k, image in enumerate(images(5)):
        assert desk.busy == (k < 3)
        desk.add(image)
    assert answers == [(True, "kept 3 frames")]
    desk.cancel("too late")
    assert len(answers) == 1


def test_second_request_is_refused_while_the_first_is_under_way():
    desk, answers = BackgroundTrainer(keep), []
    desk.begin(TrainingRun(3, "camera"), answers.append)
    with pytest.raises(InputError, match="learning already"):
        desk.begin(TrainingRun(3, "camera"), answers.append)
    for image in images(3):
        desk.add(image)
    desk.begin(TrainingRun(3, "camera"), answers.append)
    assert desk.busy and len(answers) == 1


def test_cancelled_lesson_is_answered_with_the_reason():
    desk, answers = BackgroundTrainer(keep), []
    desk.begin(TrainingRun(3, "camera"), answers.append)
    desk.add(images(1)[0])
    desk.cancel("the camera was suspended")
    assert answers == [(False, "the camera was suspended after 1 of 3 frames")] and not desk.busy


def test_model_that_cannot_be_used_is_answered_with_the_error():
    def refuse(model):
        raise InputError("is of another size")

    desk, answers = BackgroundTrainer(refuse), []
    desk.begin(TrainingRun(3, "camera"), answers.append)
    for image in images(3):
        desk.add(image)
    assert answers == [(False, "is of another size.")]
