"""First poses from hulls that are carved from exact silhouettes of people with volume: in a T-pose, or walking in; the
right way round, with honest sizes. Carts and nobody are not. Whom a rig does not show whole is told what to do."""

import re
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from poses import angles_with
from t_pose_studio import DOWN, SET_NS, Studio, box, person, standing, studio

from icp_tracker.initialization import truncation
from icp_tracker.initialization.hull_source import HullSource, MotionSettings, TPoseSettings
from icp_tracker.initialization.pose_hypothesis import STEP_M
from mocap_packets.hull import NO_CENTERLINE, HullProducts
from stick_figure.body import Body
from stick_figure.body_surface import build_of_girth
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.motions.timeline import both_sides
from virtual_studio.people import person_of
from virtual_studio.rig import ring, tilted, with_camera

MAN = Body.from_stature(1.75)
T_POSE, HANGING = both_sides(), both_sides(shoulder_x=DOWN + 0.1)
SIX, THREE = (5, True), (3, False)  # cameras around, and one on the ceiling


def found_in(source, sets):
    """The first answer with a pose, and the number of its set; else the last answer."""
    for number, seen in enumerate(sets):
        answer = source.find_pose(seen)
        if answer.pose is not None:
            return answer, number
    return answer, None


def answer_to(room, *people, arms="level", visibility=None):
    """What is made of one set with people, asked for a T-pose."""
    source = HullSource(TPoseSettings(arms=arms, hold_sets=1), None, visibility)
    return source.find_pose(room.render(*people))


# --- in a T-pose -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", [SIX, THREE])
def test_t_pose_of_anybody_anywhere_is_found_and_never_taken_back_to_front(rig):
    rng = np.random.default_rng(rig[0])
    for _ in range(4):
        body = Body.from_stature(rng.uniform(1.4, 2.0))
        angles = both_sides(
            shoulder_x=np.radians(rng.uniform(-15, 15)),
            shoulder_z=rng.uniform(-0.15, 0.1),
            elbow=-rng.uniform(0, 0.3),
            hip_x=rng.uniform(0, 0.15),
            knee=0.05,
        )
        pose = standing(body, angles, rng.uniform(-np.pi, np.pi), rng.uniform(-0.2, 0.2, 2))
        found = answer_to(studio(*rig), person(body, pose, rng.uniform(0.85, 1.25)))
        assert found.pose is not None, found.reason
        assert found.pose.R_world_torso[:, 0] @ pose.R_world_torso[:, 0] > np.cos(np.radians(12))
        error = np.linalg.norm(forward(found.body, found.pose) - forward(body, pose), axis=1)
        assert error[[0, 2, 3, 4, 5, 6]].max() < 0.07  # the trunk
        assert error.max() < 0.20


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        (HANGING, "no T-pose: the (left|right) .*arm is 8"),
        (both_sides(shoulder_x=DOWN + 0.7, elbow=-1.7, shoulder_y=0.3), "no T-pose"),  # hands on the hips
        (angles_with(T_POSE, left_shoulder_x=1.5), "no T-pose: the left "),
        (angles_with(T_POSE, left_shoulder_x=DOWN + 0.1), "no T-pose: the left "),
        (both_sides(shoulder_x=1.4), "no T-pose"),
        (both_sides(shoulder_x=-np.pi / 4), "no T-pose"),
        (both_sides(shoulder_z=-0.9), "no T-pose"),
        (both_sides(elbow=-1.2), "no T-pose"),
        (both_sides(hip_y=-1.5, knee=1.5), ""),
        (box((-0.3, -0.4, 0.0), (0.3, 0.4, 1.4)), ""),
        (box((-0.2, -0.8, 0.0), (0.2, 0.8, 1.5)), ""),
    ],
)
@pytest.mark.parametrize("rig", [SIX, THREE])
def test_other_poses_and_carts_are_no_t_pose(rig, shape, said):
    parts = person(MAN, standing(MAN, shape, 0.3 if rig == SIX else 2.0)) if isinstance(shape, np.ndarray) else shape
    answer = answer_to(studio(*rig), parts)
    assert answer.pose is None and answer.reason
    assert re.match(said, answer.reason), answer.reason


def test_lowered_arms_are_found_where_they_are_asked_for():
    lowered, level = (person(MAN, standing(MAN, both_sides(shoulder_x=x), 2.0)) for x in (-np.pi / 4, 0.0))
    assert answer_to(studio(*SIX), lowered, arms="lowered").pose is not None
    assert answer_to(studio(*SIX), level, arms="lowered").reason.startswith("no T-pose: the ")


def test_scraps_are_no_hull_and_children_no_adults():
    whole = studio(*SIX).render(person(MAN, standing(MAN, T_POSE)))
    few = whole.of_rows(*(np.arange(len(part)) < 50 for part in (whole.centerline, whole.voxels, whole.contour_rays)))
    source = HullSource(TPoseSettings(), None)
    assert source.find_pose(few).reason == "no hull"
    assert source.find_pose(shifted(whole, 0, 0.0, 0.3)).reason.startswith("no adult's height: 0.")


def shifted(seen, stamp_ns, shift, scale=1.0):
    """The same set somewhere else, at another time, or smaller."""
    parts = (replace(part, points_world=scale * part.points_world + shift) for part in (seen.centerline, seen.voxels))
    rays = replace(seen.contour_rays, points_world=scale * seen.contour_rays.points_world + shift)
    return HullProducts(stamp_ns, *parts, contour_rays=rays)


@pytest.fixture(scope="module")
def held():
    return studio(*SIX).render(person(MAN, standing(MAN, T_POSE, 0.7)))


def test_t_pose_must_be_held(held):
    source, nobody = HullSource(TPoseSettings(hold_sets=3), MotionSettings()), NO_CENTERLINE
    sets = [
        shifted(held, k * SET_NS, 0.0) if seen else HullProducts(k * SET_NS, nobody)
        for k, seen in enumerate([1, 1, 0, 1, 1, 1])
    ]
    answers = [source.find_pose(seen) for seen in sets]
    assert [answer.reason for answer in answers] == [
        "T-pose seen, hold it (1 of 3)",
        "T-pose seen, hold it (2 of 3)",
        "no hull",
        "T-pose seen, hold it (1 of 3)",
        "T-pose seen, hold it (2 of 3)",
        "",
    ]
    assert answers[-1].pose is not None and answers[-1].estimate is not None


def test_known_body_keeps_its_sizes_in_a_t_pose(held):
    found = HullSource(TPoseSettings(hold_sets=1), None, known=MAN).find_pose(held)
    assert found.body is MAN and found.estimate is None
    error_m = np.linalg.norm(forward(MAN, found.pose) - forward(MAN, standing(MAN, T_POSE, 0.7)), axis=1)
    assert error_m.mean() < 0.05


def test_walking_with_arms_stretched_out_is_refused_until_it_ends(held):
    at = [np.array([0.8 * min(k, 11) / 60, 0.0, 0.0]) for k in range(20)]  # 0.8 m/s, and stops
    answer, number = found_in(
        HullSource(TPoseSettings(), None), [shifted(held, k * SET_NS, shift) for k, shift in enumerate(at)]
    )
    assert number is not None and number > 11
    middle = held.voxels.points_world[:, :2].mean(axis=0) + at[-1][:2]
    assert np.linalg.norm(answer.pose.position_world[:2] - middle) < 0.06


# --- walking in ------------------------------------------------------------------------------------------------------

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
    return HullSource(TPoseSettings(), MotionSettings(watch_s=watch_s), visibility, known)


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


def test_it_must_have_watched_for_so_long_and_anew_after_a_long_gap():
    sets, _, visibility = walk()
    answer, number = found_in(source_of(30.0, visibility), sets)
    assert number is None and answer.reason.startswith("somebody is here: watched for")
    source = source_of(0.5, visibility)
    assert source.find_pose(sets[0]).pose is None
    later = replace(sets[1], stamp_ns=sets[1].stamp_ns + round(3e9))
    assert source.find_pose(later).reason.endswith("watched for 0.0 of 0.5 s")


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
    source = source_of(1.0, room().visibility)
    posts = [replace(post, stamp_ns=post.stamp_ns + k * EVERY * SET_NS) for k in range(30)]
    answer, number = found_in(source, posts)
    assert number is None, answer


def test_feet_that_are_not_seen_are_told_first_and_not_measured():
    sets, _, visibility = walk(tilt=0.30, seconds=0.0)
    answer = source_of(0.0, visibility).find_pose(sets[0])
    assert answer.pose is None and answer.reason.startswith("cam03 does not see your feet")


def test_a_gap_of_sets_does_not_begin_the_watch_anew():
    sets, _, visibility = walk()
    hidden = range(2, len(sets), 3)  # every third set shows nothing: somebody passes behind a cupboard
    shown = [HullProducts(s.stamp_ns, NO_CENTERLINE) if k in hidden else s for k, s in enumerate(sets)]
    answer, number = found_in(source_of(0.5, visibility), shown)
    assert number is not None and number not in hidden, answer.reason


# --- whom a rig does not show whole -----------------------------------------------------------------------------------

LAST_WORLD = room().rig.cameras[2].centre_world[:2]
NEAR_LAST = tuple(0.5 * LAST_WORLD / np.linalg.norm(LAST_WORLD))


def test_raised_hand_is_no_crown():
    up = np.array([[0.3, 0.0, z] for z in np.arange(1.4, 2.1, 0.02)] * 10)
    trunk = np.random.default_rng(0).uniform([-0.15, -0.2, 0.0], [0.15, 0.2, 1.7], (3000, 3))
    assert truncation.stance_of(np.concatenate([trunk, up]), 0.02).stature == pytest.approx(1.7, abs=0.03)


@pytest.mark.parametrize(
    ("up", "place", "heading", "says"),
    [
        (0.30, NEAR_LAST, 1.4, "cam03 does not see your feet: step away from it"),
        (-0.24, NEAR_LAST, 1.4, "cam03 does not see your head: step away from it"),
        (0.0, (1.25, 0.0), 0.0, "you are partly outside the volume: step towards its middle"),
        (0.0, (0.0, 0.95), 0.0, "your hand is partly outside the volume: step towards its middle"),
    ],
)
def test_cut_off_person_is_told_what_is_missing_and_where_to_go(up, place, heading, says):
    pose = standing(MAN, T_POSE, heading, place)
    assert says in answer_to(room(up), person(MAN, pose), visibility=room(up).visibility).reason


def test_whole_body_near_the_border_is_not_called_cut():
    """The hull of hands and feet a few voxels inside the border is whole."""
    studio = room()
    voxels = studio.render(person(MAN, standing(MAN, T_POSE, 0.0, (0.0, 0.35)))).voxels.points_world
    stance = truncation.Stance(np.array([0.0, 0.35]), np.array([1.0, 0.0]), 0.0, MAN.stature)
    assert truncation.cut_parts(voxels, stance, 0.02, studio.visibility) == ()
