"""A limb that the cameras do not show is doubtful and its ellipsoid holds it; limbs in full view are not doubted."""

from dataclasses import replace

import numpy as np
import pytest
from doubt import calls_of
from products import Recorded
from scenes import studio_clip

from mocap_packets.fit import PART_NAMES

LEFT_ARM = PART_NAMES.index("left arm")
ELBOW, HAND, NECK, ON_CHEST_M = 7, 11, 2, 0.35
SECONDS = 4.2  # T-pose, the way to the chest, and most of the two seconds there
HIDDEN_FROM, WITHIN_M = 110, 0.12  # the frame; of the forearm's line


@pytest.fixture(scope="module")
def walk():
    """A person in full view."""
    return Recorded.of(studio_clip("walk", 2.5, 5))


def without_left_forearm(products, elbow_world, hand_world):
    """A set without what the hull tells of a forearm, as when no camera sees it before what is behind it."""

    def elsewhere(points_world):
        along = hand_world - elbow_world
        share = np.clip((points_world - elbow_world) @ along / (along @ along), 0.0, 1.0)
        return np.linalg.norm(points_world - elbow_world - share[:, None] * along, axis=1) > WITHIN_M

    packets = (products.centerline, products.voxels, products.contour_rays)
    return products.of_rows(*(elsewhere(packet.points_world) for packet in packets))


def test_a_forearm_without_evidence_is_doubtful_and_nothing_else_is(walk):
    truth = walk.truths[0]
    shown = [
        products if frame < HIDDEN_FROM else without_left_forearm(products, truth[frame, ELBOW], truth[frame, HAND])
        for frame, products in enumerate(walk.products)
    ]
    calls, _ = calls_of(replace(walk, products=shown), {})
    hidden = (np.arange(len(truth)) >= HIDDEN_FROM)[-len(calls.clear) :]
    assert hidden.sum() > 30
    assert calls.called[hidden, LEFT_ARM].mean() > 0.8
    assert calls.inside[hidden & calls.called[:, LEFT_ARM], LEFT_ARM].mean() > 0.8  # three points, each in 95 %
    calls.called[hidden, LEFT_ARM] = False
    assert not calls.called.any()


def test_limbs_in_full_view_are_not_doubted(walk):
    calls, _ = calls_of(walk, {})
    assert len(calls.clear) > 100 and calls.clear.all()
    assert not calls.called.any()


def test_an_arm_pressed_to_the_chest_before_three_cameras_is_right_or_doubtful():
    clip = studio_clip("arm_on_chest", SECONDS, 3)
    calls, _ = calls_of(Recorded.of(clip), {})
    there = (np.linalg.norm(clip.truth[:, HAND] - clip.truth[:, NECK], axis=1) < ON_CHEST_M)[-len(calls.clear) :]
    assert there.sum() > 60
    assert (calls.clear | calls.called[:, LEFT_ARM])[there].all()
    assert calls.inside[there, LEFT_ARM].mean() > 0.9
    others = [part for part in range(len(PART_NAMES)) if part != LEFT_ARM]
    assert not calls.called[:, others].any()
