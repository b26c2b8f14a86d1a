"""Things that stand in a camera's way: learned from what the others see, and forgotten when they are gone."""

import numpy as np
import pytest
from hull_scenes import capsule_person, ring_rig, silhouettes

from capture_rig import Volume
from capture_rig.mask_levels import UNCERTAIN
from capture_rig.visibility import CELL_M
from hull_server.consistency.occluders import LEARNED_S, OccluderMap
from hull_server.consistency.silhouette_residuals import ResidualEstimator
from hull_server.views import RigViews

ROOM = Volume(np.array([-1.6, -1.6, -0.05]), np.array([1.6, 1.6, 2.1]))
RIG = ring_rig(5, size=(480, 360), focal_px=260.0, volume=ROOM)
VIEWS, HIDDEN = RigViews.from_rig(RIG), RIG.names[0]
STEP_S = 0.1
WALK = [capsule_person(0.3, x, 0.1) for x in np.linspace(-0.6, 0.6, 25)]


@pytest.fixture
def occluders():
    return OccluderMap(VIEWS, ResidualEstimator(RIG, VIEWS, CELL_M))


def desk(masks):
    """The masks of a set in which something hides a person's legs from the first camera; and the pixels it hides."""
    rows = np.flatnonzero(masks[HIDDEN].any(axis=1))
    hidden = np.zeros(masks[HIDDEN].shape, bool)
    hidden[rows[0] + int(0.6 * (rows[-1] - rows[0])) :] = True
    return {**masks, HIDDEN: np.where(hidden, np.uint8(0), masks[HIDDEN])}, hidden


def learn(occluders, masks, seconds=STEP_S):
    estimator = occluders._estimator
    for camera, name in enumerate(VIEWS.names):
        estimator.set_mask(camera, masks[name])
    for _ in range(round(seconds / STEP_S)):
        occluders.learn(estimator.estimate(tuple(range(len(VIEWS.names))), ()), STEP_S)


def test_behind_a_desk_its_camera_becomes_uncertain_and_the_others_do_not(occluders):
    masks = silhouettes(RIG, WALK[12])
    hiding, hidden = desk(masks)
    learn(occluders, hiding, LEARNED_S - 2 * STEP_S)
    assert all(np.array_equal(mask, hiding[name]) for name, mask in occluders.applied(hiding).items())
    learn(occluders, hiding, 4 * STEP_S)
    seen = occluders.applied(hiding)
    legs = hidden & (masks[HIDDEN] > 0)
    assert (seen[HIDDEN][legs] == UNCERTAIN).mean() > 0.7
    assert not ((seen[HIDDEN] == UNCERTAIN) & ~hidden).any()
    assert all(np.array_equal(seen[name], hiding[name]) for name in VIEWS.names[1:])
    np.testing.assert_array_equal(hiding[HIDDEN][legs], 0)  # what came in is not written to


def test_nothing_is_learned_of_who_walks_and_stands_in_full_view(occluders):
    seen = [silhouettes(RIG, person) for person in WALK[::2]]
    for masks in seen + seen[-1:] * 40:
        learn(occluders, masks)
        assert all(np.array_equal(mask, masks[name]) for name, mask in occluders.applied(masks).items())


def test_a_thing_taken_away_is_forgotten_while_a_person_stands_there(occluders):
    masks = silhouettes(RIG, WALK[12])
    hiding, hidden = desk(masks)
    learn(occluders, hiding, LEARNED_S + 2 * STEP_S)
    assert (occluders.applied(hiding)[HIDDEN] == UNCERTAIN).any()
    learn(occluders, masks, LEARNED_S)
    legs = hidden & (masks[HIDDEN] > 0)
    assert not (occluders.applied(hiding)[HIDDEN][legs] == UNCERTAIN).any()


def test_a_camera_whose_silhouette_fits_nobody_is_a_fault_and_no_occluder(occluders):
    masks = silhouettes(RIG, WALK[12])
    turned = {**masks, HIDDEN: np.roll(masks[HIDDEN], 90, axis=1)}
    learn(occluders, turned, 3 * LEARNED_S)
    assert not (occluders.applied(turned)[HIDDEN] == UNCERTAIN).any()
