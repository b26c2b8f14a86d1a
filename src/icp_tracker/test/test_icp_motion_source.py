"""Somebody who walks in without a T-pose: found, the right way round, with honest sizes; carts and nobody are not. Whom
a rig does not show whole is told what to do."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from t_pose_studio import SET_NS, Studio, box, person, standing

from icp_tracker.acquisition import truncation
from icp_tracker.acquisition.body_parts import find_legs
from icp_tracker.acquisition.body_sizes import sizes_of_body
from icp_tracker.acquisition.motion_source import STEP_M, MotionSettings, MotionSource
from icp_tracker.acquisition.pose_source import CombinedPoseSource
from icp_tracker.acquisition.t_pose_measures import TPoseSettings
from icp_tracker.acquisition.t_pose_source import TPoseSource, find_t_pose
from icp_tracker.acquisition.upright import PoseRejected, Upright, stance_of
from mocap_packets.hull import NO_CENTERLINE, HullProducts
from stick_figure.body import Body
from stick_figure.body_surface import build_of_girth
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.motions.timeline import both_sides
from virtual_studio.people import person_of
from virtual_studio.rig import narrowed, ring, tilted, with_camera

EVERY = 4  # of a walk at 60 Hz: fifteen sets a second
BODY = person_of(1.70, 0.97, 1.03)


@lru_cache
def room(tilt=0.0):
    """Three cameras, the last of them tilted up (rad)."""
    rig = ring(3, ceiling=False)
    return Studio(with_camera(rig, 2, tilted(rig.cameras[2], tilt)))


@lru_cache
def walk(tilt=0.0, build=1.0, seconds=0.7):
    """Somebody who walks, of such a build, and four sets more: sets, poses, and the rig's visibility."""
    studio = room(tilt)
    poses = MOTIONS["walk"](BODY, 3.0 + seconds, 60.0).poses[120::EVERY][: round(seconds * 60 / EVERY) + 4]
    sets = [studio.render(person(BODY, pose, build), apart_ns=EVERY * SET_NS) for pose in poses]
    return sets, poses, studio.visibility


def source_of(watch_s, visibility, known=None):
    return MotionSource(MotionSettings(watch_s=watch_s), visibility, known=known)


def found_in(source, sets):
    """The first answer with a pose, and the number of its set; else the last answer."""
    for number, seen in enumerate(sets):
        answer = source.find_pose(seen)
        if answer.pose is not None:
            return answer, number
    return answer, None


@pytest.fixture(scope="module")
def walker():
    sets, poses, visibility = walk()
    answer, number = found_in(source_of(0.5, visibility), sets)
    assert number is not None, answer.reason
    return answer, poses[number]


def test_who_walks_in_is_found_the_right_way_round(walker):
    answer, pose = walker
    assert answer.is_fitted
    assert answer.pose.R_world_torso[:, 0] @ pose.R_world_torso[:, 0] > 0.8
    off = np.linalg.norm(forward(answer.body, answer.pose) - forward(BODY, pose), axis=1)
    assert off.mean() < 0.05 and off.max() < 0.15


def test_stout_person_is_found_when_a_body_of_average_girth_explains_too_little():
    sets, poses, visibility = walk(build=1.5)
    found, number = found_in(source_of(0.5, visibility), sets)
    assert found.pose is not None and (found.body.build == build_of_girth(1.3)).all()
    assert found.pose.R_world_torso[:, 0] @ poses[number].R_world_torso[:, 0] > 0.8


def test_slower_walk_counts_less_as_walking_forwards():
    sets, _, visibility = walk(seconds=1.3)
    ways = []
    for times in (1, 6):
        source = source_of(30.0, visibility)
        for k, seen in enumerate(sets):
            source.find_pose(replace(seen, stamp_ns=10**9 + k * times * EVERY * SET_NS))
        ways.append(max(hypothesis.way for hypothesis in source._followed))
    assert ways[0] > STEP_M / 2 and 0.0 < ways[1] < ways[0] / 3


def test_sizes_of_who_walks_in_are_as_uncertain_as_they_are_wrong(walker):
    answer, _ = walker
    off = np.abs(answer.estimate.sizes - sizes_of_body(BODY))[:-1]
    assert (off < 3.0 * answer.estimate.sd[:-1]).all()
    assert abs(answer.estimate.stature - BODY.stature) < 0.05


def test_it_must_have_watched_for_so_long_and_anew_after_a_long_gap():
    sets, _, visibility = walk()
    answer, number = found_in(source_of(30.0, visibility), sets)
    assert number is None and answer.reason.startswith("somebody is here: watched for")
    source = source_of(0.5, visibility)
    assert source.find_pose(sets[0]).pose is None
    later = replace(sets[1], stamp_ns=sets[1].stamp_ns + round(3e9))
    assert source.find_pose(later).reason.endswith("watched for 0.0 of 0.5 s")


def test_known_body_keeps_its_sizes():
    sets, _, visibility = walk()
    answer, _ = found_in(source_of(0.3, visibility, known=BODY), sets)
    assert answer.body is BODY and answer.estimate is None


def test_cart_and_nobody_are_not_followed():
    sets, _, visibility = walk()
    source = source_of(0.0, visibility)
    cart = room().render(box((-0.3, -0.25, 0.0), (0.3, 0.25, 1.6)), apart_ns=EVERY * SET_NS)
    answer, number = found_in(source, [cart])
    assert number is None and answer.reason
    assert source.find_pose(sets[0].of_body(7)).reason == "no hull"


@pytest.mark.slow
def test_post_that_explains_itself_is_nobody():
    post = room().render(box((-0.09, -0.08, 0.0), (0.09, 0.08, 1.7)), apart_ns=EVERY * SET_NS)
    source = MotionSource(MotionSettings(), room().visibility)
    posts = [replace(post, stamp_ns=post.stamp_ns + k * EVERY * SET_NS) for k in range(30)]
    answer, number = found_in(source, posts)
    assert number is None, answer


def test_feet_that_are_not_seen_are_told_first_and_not_measured():
    sets, _, visibility = walk(tilt=0.30, seconds=0.0)
    answer = source_of(0.0, visibility).find_pose(sets[0])
    assert answer.pose is None and answer.reason.startswith("cam03 does not see your feet")


def test_who_walks_in_is_told_so_and_not_to_raise_the_arms():
    sets, _, visibility = walk()
    source = CombinedPoseSource(TPoseSource(TPoseSettings(), visibility), MotionSource(MotionSettings(), visibility))
    assert source.find_pose(sets[0]).reason.startswith("somebody is here: watched for 0.0 of 1.0 s")


def test_t_pose_that_is_held_decides_alone():
    seen = room().render(person(BODY, standing(BODY, both_sides())), apart_ns=SET_NS)
    source = CombinedPoseSource(TPoseSource(TPoseSettings(hold_sets=2)), MotionSource(MotionSettings(watch_s=0.0)))
    first, second = source.find_pose(seen), source.find_pose(seen)
    assert first.reason.startswith("T-pose seen, hold it")
    assert second.pose is not None and second.estimate is not None  # measured, not guessed


def test_a_gap_of_sets_does_not_begin_the_watch_anew():
    sets, _, visibility = walk()
    hidden = range(2, len(sets), 3)  # every third set shows nothing: somebody passes behind a cupboard
    shown = [HullProducts(s.stamp_ns, NO_CENTERLINE) if k in hidden else s for k, s in enumerate(sets)]
    answer, number = found_in(source_of(0.5, visibility), shown)
    assert number is not None and number not in hidden, answer.reason


# --- whom a rig does not show whole -----------------------------------------------------------------------------------

MAN = Body.from_stature(1.75)
T_POSE = both_sides()
RING = ring(3, ceiling=False)
TOWARDS_LAST = RING.cameras[2].centre_world[:2] / np.linalg.norm(RING.cameras[2].centre_world[:2])


@lru_cache
def rig_of(up=0.0, factor=1.0):
    """Three cameras, the last of them tilted up (rad), all with a lens of so many times the focal length."""
    rig = with_camera(RING, 2, tilted(RING.cameras[2], up))
    for number, camera in enumerate(rig.cameras):
        rig = with_camera(rig, number, narrowed(camera, factor))
    return Studio(rig)


def told_at(studio, place, heading=0.4):
    """Why a T-pose there is refused; empty when it is measured."""
    return find_t_pose(
        studio.render(person(MAN, standing(MAN, T_POSE, heading, place))), TPoseSettings(), studio.visibility
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
    studio = rig_of(up)
    told = told_at(studio, place, heading)
    assert told.startswith(starts), told
    stance = truncation.Stance(np.array(place), np.array([np.cos(heading), np.sin(heading)]), 0.0, MAN.stature)
    step = truncation.smallest_translation_into_view(stance, studio.visibility)
    assert abs(np.linalg.norm(step) - step_of(told)) <= 0.2
    there = np.array(place) + step  # whoever obeys is measured, or asked for a short step more: hulls are wide
    left = told_at(studio, tuple(there), heading)
    assert left == "" or step_of(left) <= 0.2


def step_of(told):
    """The length of the step in a sentence, metres."""
    return float(told.split("step ")[1].split(" m")[0])


def test_step_is_said_about_where_the_person_faces_when_that_is_known():
    visibility = rig_of().visibility
    for facing, word in (((1.0, 0.0), " right"), ((-1.0, 0.0), " left")):
        stance = truncation.Stance(np.array([0.0, 0.95]), np.array(facing), 0.0, 1.75, facing=5.0)
        told = truncation.advice_text((truncation.LEFT_HAND,), stance, visibility)
        assert "left hand" in told and word in told


def test_without_a_place_a_camera_is_to_be_turned():
    stance = truncation.Stance(np.zeros(2), np.array([1.0, 0.0]), 0.0, 1.75)
    assert truncation.advice_text((truncation.FEET,), stance, rig_of(0.6).visibility) == (
        "cam03 does not see your feet: no place in the volume is seen by 3 cameras; turn cam03 down"
    )
    assert "you do not fit into its picture" in truncation.advice_text(
        (truncation.FEET,), stance, rig_of(0.0, 2.2).visibility
    )


def test_whole_body_near_the_border_is_not_called_cut():
    """The hull of hands and feet a few voxels inside the border is whole."""
    studio = rig_of()
    voxels = studio.render(person(MAN, standing(MAN, T_POSE, 0.0, (0.0, 0.35)))).voxels.points_world
    stance = truncation.Stance(np.array([0.0, 0.35]), np.array([1.0, 0.0]), 0.0, MAN.stature)
    assert truncation.cut_parts(voxels, stance, 0.02, studio.visibility) == ()
