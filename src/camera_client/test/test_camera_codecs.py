"""Codecs: their noise is coarse, and what they draw anew beside a person is no person."""

import cv2
import numpy as np
import pytest
from camera_pictures import learned

from camera_client.background.adaptive import AdaptiveBackground
from camera_client.background.expected_image import samples_of
from camera_client.background.noise import measured_correlation
from camera_client.settings import BackgroundSettings, SilhouetteSettings
from camera_client.silhouettes.evidence import FINE_GRAIN
from camera_client.silhouettes.pipeline import SilhouettePipeline
from virtual_studio.rig import ring

HEIGHT, WIDTH, NOISE, QUALITY, FPS = 480, 640, 2.0, 30, 30.0


def through_jpeg(picture):
    """Return a picture as a Motion JPEG of low rate gives it back."""
    flags = cv2.IMREAD_COLOR if picture.ndim == 3 else cv2.IMREAD_GRAYSCALE
    return cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1], flags)


def room(colour, rng, size=(WIDTH, HEIGHT)):
    """Return the light of a room with soft patches and a few edges, (H, W[, 3])."""
    patches = cv2.resize(rng.uniform(90, 160, (12, 16)), size, interpolation=cv2.INTER_CUBIC)
    cv2.rectangle(patches, (60, 50), (180, 150), 60.0, 3)
    return patches[..., None] * [0.8, 1.0, 1.1] if colour else patches


def exposed(light, rng):
    return np.rint(light + rng.normal(0, NOISE, light.shape)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("codec", [False, True])
def test_grain_tells_a_codec_from_a_sensor_and_from_a_camera_that_was_touched(colour, codec):
    rng = np.random.default_rng(5)
    light, stored = room(colour, rng, (WIDTH // 2, HEIGHT // 2)), through_jpeg if codec else lambda picture: picture
    model = learned(stored(exposed(light, rng)) for _ in range(20))
    background = AdaptiveBackground(model, BackgroundSettings())
    for frame in range(24):
        image = stored(exposed(np.roll(light, 30 * (frame >= 14), axis=1), rng))
        background.update(image, samples_of(image), round(frame * 1e9 / FPS))
        if frame >= 8:
            correlation = background.noise.spatial_correlation
            assert (correlation > FINE_GRAIN) == codec, (frame, correlation)


def test_grain_is_what_neighbours_share_and_the_same_picture_again_tells_none():
    own, other, again = *np.random.default_rng(0).normal(0, NOISE, (2, 1000, 1)), np.zeros((1000, 1))
    assert measured_correlation(own, own, other) == 1.0
    assert measured_correlation(own, other, other) == 0.0
    assert measured_correlation(again, again, again) is None


@pytest.mark.parametrize("colour", [False, True])
def test_blocks_beside_a_person_are_no_person(colour):
    """A tall ellipse through JPEG is found whole and hardly wider: 0.13 and 0.23 of its area if they are ignored."""
    camera, rng = ring(2).cameras[0], np.random.default_rng(6)
    light = room(colour, rng)
    model = learned(through_jpeg(exposed(light, rng)) for _ in range(20))
    truth = cv2.ellipse(np.zeros((HEIGHT, WIDTH), np.uint8), (330, 160), (35, 110), 10, 0, 360, 255, cv2.FILLED)
    pipeline = SilhouettePipeline(camera, model, SilhouetteSettings(shadow="keep"))
    person = light.copy()
    person[truth > 0] = [40, 70, 190] if colour else 205
    for frame in range(20):
        found = pipeline.run(through_jpeg(exposed(person, rng)), round(frame * 1e9 / FPS)).image_mask > 127
    assert pipeline.background.noise.spatial_correlation > FINE_GRAIN
    assert np.count_nonzero(found & (truth > 0)) > 0.97 * np.count_nonzero(truth)
    assert np.count_nonzero(found & (truth == 0)) < 0.06 * np.count_nonzero(truth)
