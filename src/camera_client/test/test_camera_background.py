"""The background model: its limits against the definition, learning, files."""

import io
import json
import math
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from camera_pictures import learned
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from camera_client.background.fixed import FixedBackground
from camera_client.background.model import NOISIEST, BackgroundModel, Provenance, load_background, read_background
from camera_client.background.training import FEWEST_FRAMES, background_of_footage
from camera_client.settings import BackgroundSettings
from capture_rig.errors import InputError

GREY_LEVELS = np.arange(256)


def model_of(mean, sigma):
    mean, sigma = np.asarray(mean, np.float32), np.asarray(sigma, np.float32)
    return BackgroundModel(mean, sigma, Provenance("test", 10, 1.0))


def foreground_of_every_grey_level(model, settings):
    """(pixels, 256) bool: what the limits say of each pixel at each grey level."""
    background = FixedBackground(model, settings)
    images = [np.full(model.shape, grey, np.uint8) for grey in GREY_LEVELS]
    return np.stack([background.distance(image, image).reshape(-1) > 0 for image in images], axis=1)


def probability(rule, grey, mean, sigma):
    """Thesis eq. 6.3: the density, or the two-sided tail, in float64."""
    return norm.pdf(grey, mean, sigma) if rule == "pdf" else 2 * norm.sf(np.abs(grey - mean) / sigma)


@given(
    st.sampled_from(["tail", "pdf"]),
    st.floats(-12, math.log10(0.5)),
    st.floats(0.1, 64),
    st.lists(st.tuples(st.floats(0, 255, width=32), st.floats(0, 120, width=32)), min_size=1, max_size=30),
)
@hypothesis.settings(max_examples=150, deadline=None)
def test_limits_agree_with_the_definition_for_any_background_and_risk(rule, log_risk, sigma_floor, pixels):
    mean, sigma = np.array(pixels, np.float32).T.reshape(2, 1, -1)
    settings = BackgroundSettings(rule=rule, risk=10**log_risk, sigma_floor=sigma_floor)
    floored = np.maximum(sigma.astype(float), sigma_floor).reshape(-1, 1)
    expected = probability(rule, GREY_LEVELS, mean.astype(float).reshape(-1, 1), floored)
    undecided = np.abs(expected / settings.risk - 1) < 1e-9  # equal but for rounding
    found = foreground_of_every_grey_level(model_of(mean, sigma), settings)
    assert np.array_equal(found[~undecided], (expected < settings.risk)[~undecided])


@pytest.mark.parametrize("rule", ["tail", "pdf"])
def test_colour_limits_agree_with_the_definition_channel_by_channel(rule):
    rng = np.random.default_rng(5)
    mean, sigma = (rng.uniform(0, most, (20, 30, 3)).astype(np.float32) for most in (255, 20))
    settings, image = BackgroundSettings(rule=rule, risk=1e-3), rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    image[5:] = np.clip(np.rint(mean + rng.normal(0, 8, mean.shape)), 0, 255)[5:]
    unlikely = probability(rule, image, mean.astype(float), np.maximum(sigma.astype(float), 1.0)) < settings.risk
    found = FixedBackground(model_of(mean, sigma), settings).distance(image, image) > 0
    assert np.array_equal(found, unlikely.any(axis=2)) and 0.1 < found.mean() < 0.9


@pytest.mark.parametrize("mean", [10, 120, 250])
def test_learned_mean_and_sigma_equal_those_of_the_frames(mean):
    rng = np.random.default_rng(mean)
    frames = np.clip(np.rint(rng.normal(mean, 1.0, (2000, 6, 7))), 0, 255).astype(np.uint8)
    model = learned(frames)
    assert np.allclose(model.mean, frames.mean(axis=0), rtol=1e-6)
    assert np.allclose(model.sigma, frames.std(axis=0, ddof=1), rtol=1e-5)
    assert model.provenance.frames == 2000
    assert math.isclose(model.provenance.mean_noise, frames.std(axis=0, ddof=1).mean(), rel_tol=1e-5)


@pytest.mark.parametrize("shapes, text", [([(4, 5), (4, 6)], "5 x 4 mono"), ([(4, 5)], "1 frames are too few")])
def test_frames_of_two_sizes_or_a_single_one_are_no_background(shapes, text):
    with pytest.raises(InputError, match=text):
        learned([np.zeros(shape, np.uint8) for shape in shapes])


def test_saved_model_comes_back_with_its_provenance(tmp_path, scene):
    images = scene.empty(5, colour=True)
    model = learned(images, "camera 10.0.0.1", software="test 1", created="2026-01-01", camera_serial="S1")
    model.save(tmp_path / "deep" / "bg.npz")
    loaded = load_background(tmp_path / "deep" / "bg.npz")
    assert np.array_equal(loaded.mean, model.mean) and np.array_equal(loaded.sigma, model.sigma)
    assert loaded.provenance == model.provenance
    with np.load(tmp_path / "deep" / "bg.npz") as file:
        assert json.loads(str(file["about"]))["image"] == "160 x 120 colour"


DATA = Path(__file__).parent / "data"


def test_background_that_version_0_1_saved_is_read_with_a_verdict_and_without(tmp_path):
    model = load_background(DATA / "background_0_1.npz")
    assert model.shape == (12, 16) and model.mean[0, :3] == pytest.approx([99.84, 99.88, 99.74], abs=1e-4)
    assert model.sigma[0, :3] == pytest.approx([2.13197, 1.90209, 2.40586], abs=1e-4)
    about = model.provenance
    assert (about.source, about.frames, about.camera_serial, about.exposure_us) == ("camera 10.0.0.5", 50, "S1", "5000")
    assert (about.verdict, about.calibration, about.created) == ("good", "1a2b3c4d", "2026-03-01T08:00:00+00:00")
    assert about.turn_rad == pytest.approx([0.0, 0.0349, 0.0])
    with np.load(DATA / "background_0_1.npz") as file:
        arrays, text = {"mean": file["mean"], "sigma": file["sigma"]}, str(file["about"])
    np.savez(tmp_path / "old.npz", about=np.array(text[: text.index(', "verdict"')] + "}"), **arrays)
    assert load_background(tmp_path / "old.npz").provenance.verdict == ""


def saved(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


FLAT = np.ones((2, 2), np.float32)


@pytest.mark.parametrize(
    "content, text",
    [
        (None, r"bg\.npz: cannot be read \(No such file"),
        (b"", r"bg\.npz: is not a background model.*again"),
        (b"no archive", "is not a background model.*again"),
        (b"PK\x03\x04 broken", "is not a background model.*again"),
        (saved(mean=FLAT, sigma=FLAT, about=np.array("{}")), "another version"),
    ],
    ids=["missing", "empty", "text", "cut off", "version"],
)
def test_file_that_is_no_model_is_refused(tmp_path, content, text):
    path = tmp_path / "bg.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=text):
        load_background(path)
    model_of(np.nan * FLAT, FLAT).save(path)
    with pytest.raises(InputError, match="damaged"):
        load_background(path)


def test_background_learned_from_a_video_equals_the_learner(tmp_path, scene):
    images = scene.empty(12)
    path = scene.write_video(tmp_path / "bg.avi", images)
    model = read_background(path, (scene.height, scene.width))
    assert np.allclose(model.mean, np.mean(images, axis=0), atol=1e-4)
    assert np.allclose(model.sigma, np.std(images, axis=0, ddof=1), atol=1e-4)
    assert (model.provenance.source, model.provenance.frames) == (path, 12)


def test_background_from_one_still_assumes_a_noise(tmp_path, scene):
    path = scene.write_video(tmp_path / "one.avi", scene.empty(1))
    model = read_background(path, (scene.height, scene.width))
    assert np.array_equal(model.mean, scene.empty(1)[0])
    assert (model.sigma == NOISIEST).all()
    assert (model.provenance.frames, model.provenance.mean_noise) == (1, NOISIEST)


@pytest.mark.parametrize("shape, text", [((480, 640), "640 x 480 mono"), ((120, 160, 3), "160 x 120 colour")])
def test_background_of_another_size_or_channels_is_refused(tmp_path, scene, shape, text):
    model_of(np.zeros((120, 160)), np.ones((120, 160))).save(tmp_path / "bg.npz")
    with pytest.raises(InputError, match=rf"bg\.npz: the background is 160 x 120 mono, .* {text}"):
        read_background(tmp_path / "bg.npz", shape)


# --- a background of footage with people in it


H, W, NOISE = 100, 150, 2.0


def footage(colour, frames=40):
    """Somebody crosses the picture below row 50; above it somebody stands for 60 % of the time, from column 100 on."""
    rng = np.random.default_rng(4)
    room = rng.uniform(60, 180, (H, W, 3) if colour else (H, W))
    pictures = []
    for k in range(frames):
        picture = room * (1 + 0.05 * np.sin(k))  # exposure wanders
        left = round(k * (W - 20) / frames)
        picture[50:, left : left + 20] = 20
        if k % 5 < 3:
            picture[:40, 100:130] = 230
        pictures.append(np.rint(picture + rng.normal(0, NOISE, picture.shape)).clip(0, 255).astype(np.uint8))
    return pictures, room


@pytest.mark.parametrize("colour", [False, True])
def test_who_walks_through_leaves_no_trace_and_who_lingers_is_uncertain(colour):
    pictures, room = footage(colour)
    model, uncertain = background_of_footage(pictures, "a test")
    passed = np.zeros((H, W), bool)
    passed[50:] = True
    off = np.abs(model.mean - room) if not colour else np.abs(model.mean - room).max(axis=2)
    assert np.quantile(off[passed], 0.99) < 0.06 * 180 and uncertain[passed].mean() < 0.02
    sigma = model.sigma if not colour else model.sigma.mean(axis=2)
    assert 0.5 * NOISE < np.median(sigma[passed]) < 3 * NOISE
    lingered = np.zeros((H, W), bool)
    lingered[:40, 100:130] = True
    assert uncertain[lingered].mean() > 0.9 and np.median(sigma[lingered]) > 20
    assert uncertain[~lingered].mean() < 0.02 and model.provenance.frames == len(pictures)


def test_too_few_frames_are_refused():
    with pytest.raises(InputError, match="too few to tell a background"):
        background_of_footage(footage(False, FEWEST_FRAMES - 1)[0], "a test")
