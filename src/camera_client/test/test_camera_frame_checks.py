"""Flags of frames that are no picture of the scene."""

import numpy as np
import pytest

from camera_client.sources.frame_checks import DARK, FROZEN, SATURATED, FrameChecks

PERIOD_NS = 20_000_000


@pytest.fixture(params=[False, True], ids=["mono", "colour"])
def checks(request, scene):
    checks = FrameChecks(np.mean(scene.empty(30, colour=request.param), axis=0))
    checks.colour = request.param
    return checks


def test_sound_frames_carry_no_flag_even_with_a_person_in_front(scene, checks):
    for k, image in enumerate(scene.empty(80, seed=5, colour=checks.colour)):
        assert checks.check(scene.with_person(image), k * PERIOD_NS) == ()


def test_lens_cap_is_dark_and_only_dark(scene, checks):
    rng = np.random.default_rng(0)
    black = rng.integers(0, 6, scene.empty(1, colour=checks.colour)[0].shape, dtype=np.uint8)
    assert all(checks.check(black, k * PERIOD_NS) == (DARK,) for k in range(100))
    assert FrameChecks(black.astype(float)).check(black, 0) == ()  # unless the scene was learned black


def test_overexposure_is_saturated_and_a_window_that_is_always_white_is_not(scene, checks):
    image = scene.empty(1, seed=5, colour=checks.colour)[0]
    image[:50] = 255
    assert checks.check(image, 0) == (SATURATED,)
    assert FrameChecks(image.astype(float)).check(image, 0) == ()
    image[15:50] = 200
    assert checks.check(image, 0) == ()


def test_same_picture_for_longer_than_a_second_is_frozen_until_a_new_one_comes(scene, checks):
    image, other = scene.empty(2, seed=5, colour=checks.colour)
    flags = [checks.check(image, k * PERIOD_NS) for k in range(60)]
    assert flags[:50] == [()] * 50  # 50 periods of 20 ms make the second
    assert flags[50:] == [(FROZEN,)] * 10
    assert checks.check(other, 60 * PERIOD_NS) == checks.check(other, 61 * PERIOD_NS) == ()


def test_repeated_frame_over_a_jump_of_the_clock_is_not_frozen(scene, checks):
    image = scene.empty(1, seed=5, colour=checks.colour)[0]
    assert checks.check(image, 0) == ()
    assert checks.check(image, 3_600_000_000_000) == ()
    assert checks.check(image, 10) == ()  # and back


def test_footage_that_repeats_a_picture_is_not_frozen(scene):
    checks = FrameChecks(may_repeat=True)
    assert {checks.check(scene.empty(1)[0], k * PERIOD_NS) for k in range(200)} == {()}
