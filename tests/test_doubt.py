"""A limb that the cameras do not show is doubtful and its ellipsoid holds it; limbs in full view are not doubted."""

import numpy as np
import pytest
from doubt import calls_of
from products import Recorded
from scenes import studio_clip

from mocap_packets.fit import PART_NAMES

LEFT_ARM = PART_NAMES.index("left arm")
LEFT_HAND_POINT, NECK_POINT, ON_CHEST_M = 11, 2, 0.35
SECONDS = 4.2  # T-pose, the way to the chest, and most of the two seconds there


@pytest.fixture(scope="module")
def pressed():
    """A forearm pressed to the chest before three cameras: what is said, and in which frames it lies there."""
    clip = studio_clip("arm_on_chest", SECONDS, 3)
    calls, _ = calls_of(Recorded.of(clip), {})
    at_the_chest = np.linalg.norm(clip.truth[:, LEFT_HAND_POINT] - clip.truth[:, NECK_POINT], axis=1) < ON_CHEST_M
    return calls, at_the_chest[-len(calls.clear) :]


def test_an_arm_pressed_to_the_chest_is_doubtful_before_three_cameras(pressed):
    calls, there = pressed
    assert there.sum() > 60
    assert calls.called[there, LEFT_ARM].mean() > 0.5
    assert calls.inside[there & calls.called[:, LEFT_ARM], LEFT_ARM].all()


def test_nothing_else_of_that_person_is(pressed):
    calls, _ = pressed
    others = [part for part in range(len(PART_NAMES)) if part != LEFT_ARM]
    assert not calls.called[:, others].any()


def test_limbs_in_full_view_are_not_doubted():
    clip = studio_clip("walk", 2.5, 5)
    calls, _ = calls_of(Recorded.of(clip), {})
    assert len(calls.clear) > 100 and calls.clear.all()
    assert not calls.called.any()
