"""The verdict on a background that was just learned."""

import numpy as np
import pytest

from camera_client.background_model import load_background
from camera_client.live_learning import LiveLearning, describe
from capture_rig.verdict import GOOD, REDO, USABLE


def learn(images):
    learning = LiveLearning(len(images), "test camera")
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
    learning = LiveLearning(5, "test")
    learning.add(scene.empty(1)[0])
    learning.cancel("the camera was suspended")
    assert learning.verdict is None and learning.refusal == "the camera was suspended after 1 of 5 frames"
