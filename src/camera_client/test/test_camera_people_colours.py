"""Where the background looks like the people in the room a silhouette is uncertain; elsewhere it is background."""

import numpy as np
import pytest

from camera_client.background.expected_image import samples_of
from camera_client.background.kernels import BLOCK_PX, STEP_PX
from camera_client.background.model import BackgroundModel, Provenance
from camera_client.settings import SilhouetteSettings
from camera_client.silhouettes.appearance import PeopleColours
from camera_client.silhouettes.masks import Box
from camera_client.silhouettes.pipeline import SilhouettePipeline
from capture_rig.mask_levels import FOREGROUND, UNCERTAIN

H, W, NOISE = 120, 160, 2.0
WALL, SCREEN, SHIRT = (190, 180, 170), (30, 34, 40), (38, 42, 48)  # a shirt that is nearly as dark as the screen
STEP_NS = 100_000_000


def room(colour):
    """A bright wall whose right half is a dark screen, and the person's shirt, as levels (H, W[, 3])."""
    wall, screen, shirt = (np.array(c if colour else c[:1], np.float32) for c in (WALL, SCREEN, SHIRT))
    picture = np.tile(wall, (H, W, 1))
    picture[:, W // 2 :] = screen
    return (picture if colour else picture[:, :, 0]), (shirt if colour else shirt[0])


def frame_of(room_levels, shirt, left, rng):
    """A frame with a person 40 pixels wide from column ``left`` on, and where the person is."""
    picture, person = room_levels.copy(), np.zeros((H, W), bool)
    person[30:110, left : left + 40] = True
    picture[person] = shirt
    return np.rint(picture + rng.normal(0, NOISE, picture.shape)).clip(0, 255).astype(np.uint8), person


def test_a_shirt_before_a_screen_of_its_colour_is_uncertain_and_the_wall_is_background(scene):
    """The person stands before the wall for two seconds, then half before the screen."""
    (levels, shirt), rng = room(colour=True), np.random.default_rng(3)
    model = BackgroundModel(levels, np.full_like(levels, NOISE), Provenance("test", 50, NOISE))
    pipeline = SilhouettePipeline(scene.camera(), model, SilhouetteSettings(shadow="keep"))
    for k in range(20):
        pipeline.run(frame_of(levels, shirt, 20, rng)[0], (k + 1) * STEP_NS)
    image, person = frame_of(levels, shirt, 60, rng)
    shown = pipeline.run(image, 21 * STEP_NS).mask[:H, :W]
    before_wall, wall = person.copy(), ~person
    before_wall[:, W // 2 :], wall[:, W // 2 :] = False, False
    assert (shown[before_wall] == FOREGROUND).mean() > 0.95
    assert (shown[wall] == 0).mean() > 0.95
    assert (shown[35:105, W // 2 + 4 : 96] == 0).mean() < 0.2  # hardly denied


def learn(colours, image, person, frames, nobody=None):
    mask = np.where(person, np.uint8(255), np.uint8(0))
    for k in range(frames):
        colours.learn(image, mask, Box(0, 0, H, W), nobody, k * STEP_NS)


@pytest.mark.parametrize("colour", [False, True])
def test_nothing_is_uncertain_before_people_were_seen_for_a_second(colour):
    levels, shirt = room(colour)
    colours = PeopleColours(levels.shape)
    image, person = frame_of(levels, shirt, 20, np.random.default_rng(0))
    learn(colours, image, person, 5)
    learn(colours, image, person, 15, nobody=np.ones((-(-H // BLOCK_PX), -(-W // BLOCK_PX)), bool))  # say the others
    out = np.zeros((H, W), np.uint8)
    distance = np.full((H // STEP_PX, W // STEP_PX), 30, np.uint8)
    assert not colours.known
    assert colours.mark_uncertain(samples_of(image), distance, out, 3.0, 9.0).empty and not out.any()


@pytest.mark.parametrize("colour", [False, True])
def test_colours_decide_by_the_mean_ratio_of_a_block(colour):
    levels, shirt = room(colour)
    colours = PeopleColours(levels.shape)
    image, person = frame_of(levels, shirt, 20, np.random.default_rng(0))
    learn(colours, image, person, 15)
    out = np.zeros((H, W), np.uint8)
    distance = np.zeros((H // STEP_PX, W // STEP_PX), np.uint8)
    distance[person[::STEP_PX, ::STEP_PX]] = 16  # z^2 = 4: as background, a ratio of exp(least - 2) for it
    box = colours.mark_uncertain(samples_of(image), distance, out, 2.5, 9.0)
    inner = np.zeros((H, W), bool)
    inner[40:96, 24:56] = True  # whole blocks of the person
    assert (out[inner] == UNCERTAIN).all() and not out[:, 64:80].any()  # the wall is none of the colours
    assert box.top % BLOCK_PX == 0 and box.top <= 40 and box.bottom >= 96
    assert colours.mark_uncertain(samples_of(image), distance, np.zeros((H, W), np.uint8), 60.0, 90.0).empty
