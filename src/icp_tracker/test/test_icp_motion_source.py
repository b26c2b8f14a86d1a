"""Somebody who walks in without a T-pose: found, the right way round, with honest sizes; carts and nobody are not."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from t_pose_studio import SET_NS, Studio, box, person, standing

from icp_tracker.acquisition.body_sizes import sizes_of_body
from icp_tracker.acquisition.motion_source import STEP_M, MotionSettings, MotionSource
from icp_tracker.acquisition.pose_source import CombinedPoseSource
from icp_tracker.acquisition.t_pose_measures import TPoseSettings
from icp_tracker.acquisition.t_pose_source import TPoseSource
from mocap_packets.hull import NO_CENTERLINE, HullProducts
from stick_figure.body_surface import build_of_girth
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.motions.timeline import both_sides
from virtual_studio.people import person_of
from virtual_studio.rig import ring, tilted, with_camera

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
