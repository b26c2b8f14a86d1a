"""People whom a rig does not show whole: what is cut off, and the sentence that tells them what to do."""

from functools import lru_cache

import numpy as np
import pytest
from t_pose_studio import Studio, person, standing

from icp_tracker.acquisition.body_parts import find_legs
from icp_tracker.acquisition.t_pose_measures import TPoseSettings
from icp_tracker.acquisition.t_pose_source import find_t_pose
from icp_tracker.acquisition.truncation import (
    FEET,
    LEFT_HAND,
    Stance,
    advice_text,
    cut_parts,
    smallest_translation_into_view,
)
from icp_tracker.acquisition.upright import PoseRejected, Upright, stance_of
from stick_figure.body import Body
from virtual_studio.motions.timeline import both_sides
from virtual_studio.rig import narrowed, ring, tilted, with_camera

BODY = Body.from_stature(1.75)
T_POSE = both_sides()
RING = ring(3, ceiling=False)
TOWARDS_LAST = RING.cameras[2].centre_world[:2] / np.linalg.norm(RING.cameras[2].centre_world[:2])


@lru_cache
def room(up=0.0, factor=1.0):
    """Three cameras, the last of them tilted up (rad), all with a lens of so many times the focal length."""
    rig = with_camera(RING, 2, tilted(RING.cameras[2], up))
    for number, camera in enumerate(rig.cameras):
        rig = with_camera(rig, number, narrowed(camera, factor))
    return Studio(rig)


def answer(studio, place, heading=0.4):
    """Why a T-pose there is refused; empty when it is measured."""
    return find_t_pose(
        studio.render(person(BODY, standing(BODY, T_POSE, heading, place))), TPoseSettings(), studio.visibility
    )[1]


def test_raised_hand_is_no_crown():
    up = np.array([[0.3, 0.0, z] for z in np.arange(1.4, 2.1, 0.02)] * 10)
    trunk = np.random.default_rng(0).uniform([-0.15, -0.2, 0.0], [0.15, 0.2, 1.7], (3000, 3))
    assert stance_of(np.concatenate([trunk, up]), 0.02).stature == pytest.approx(1.7, abs=0.03)


def test_legs_without_shins_are_refused():
    thighs = np.random.default_rng(0).uniform([-0.1, -0.2, 0.4], [0.1, 0.2, 1.7], (3000, 3))
    body = Upright(thighs, np.zeros(2), np.array([1.0, 0.0]), 0.0, 1.7, 0.02)
    with pytest.raises(PoseRejected, match="no legs in the hull"):
        find_legs(body)


@pytest.mark.parametrize(
    ("up", "place", "heading", "starts"),
    [
        (0.24, tuple(0.5 * TOWARDS_LAST), 1.4, "cam03 does not see your feet: step "),
        (-0.24, tuple(0.5 * TOWARDS_LAST), 1.4, "cam03 does not see your head: step "),
        (0.0, (1.25, 0.0), 0.0, "you are partly outside the volume: step "),
        (0.0, (0.0, 0.95), 0.0, "your hand is partly outside the volume: step "),
    ],
)
def test_cut_off_person_is_told_what_is_missing_and_where_to_go(up, place, heading, starts):
    studio = room(up)
    told = answer(studio, place, heading)
    assert told.startswith(starts), told
    stance = Stance(np.array(place), np.array([np.cos(heading), np.sin(heading)]), 0.0, BODY.stature)
    step = smallest_translation_into_view(stance, studio.visibility)
    assert abs(np.linalg.norm(step) - step_of(told)) <= 0.2
    there = np.array(place) + step  # whoever obeys is measured, or asked for a short step more: hulls are wide
    left = answer(studio, tuple(there), heading)
    assert left == "" or step_of(left) <= 0.2


def step_of(told):
    """The length of the step in a sentence, metres."""
    return float(told.split("step ")[1].split(" m")[0])


def test_step_is_said_about_where_the_person_faces_when_that_is_known():
    visibility = room().visibility
    for forward, word in (((1.0, 0.0), " right"), ((-1.0, 0.0), " left")):
        stance = Stance(np.array([0.0, 0.95]), np.array(forward), 0.0, 1.75, facing=5.0)
        told = advice_text((LEFT_HAND,), stance, visibility)
        assert "left hand" in told and word in told


def test_without_a_place_a_camera_is_to_be_turned():
    stance = Stance(np.zeros(2), np.array([1.0, 0.0]), 0.0, 1.75)
    assert advice_text((FEET,), stance, room(0.6).visibility) == (
        "cam03 does not see your feet: no place in the volume is seen by 3 cameras; turn cam03 down"
    )
    assert "you do not fit into its picture" in advice_text((FEET,), stance, room(0.0, 2.2).visibility)


def test_whole_body_near_the_border_is_not_called_cut():
    """The hull of hands and feet a few voxels inside the border is whole."""
    studio = room()
    voxels = studio.render(person(BODY, standing(BODY, T_POSE, 0.0, (0.0, 0.35)))).voxels.points_world
    stance = Stance(np.array([0.0, 0.35]), np.array([1.0, 0.0]), 0.0, BODY.stature)
    assert cut_parts(voxels, stance, 0.02, studio.visibility) == ()
