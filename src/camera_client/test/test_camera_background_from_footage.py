"""A background of footage with people in it: right where they pass, uncertain where somebody lingers."""

import numpy as np
import pytest

from camera_client.background.training import FEWEST_FRAMES, background_of_footage
from capture_rig.errors import InputError

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
