"""The hard cases: possible movements, on the floor, of a body that does not pass through itself."""

from functools import cache

import numpy as np
import pytest

from capture_rig.errors import InputError
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.skeleton import (
    ANGLE_HIGH,
    ANGLE_LOW,
    HEAD,
    L_CALF,
    L_FOREARM,
    L_THIGH,
    R_CALF,
    R_FOREARM,
    R_THIGH,
    T_POSE_ANGLES,
    TORSO,
)
from virtual_studio.motions.catalogue import HARD_CASES, MOTIONS, T_POSE_S
from virtual_studio.people import VolumetricBody, person_of
from virtual_studio.rendering.camera import ExactSilhouettes, VirtualCamera
from virtual_studio.rig import VOLUME, ring

FPS = 30
AVERAGE, BIG, SMALL = (1.75, 1.0), (1.93, 0.88), (1.52, 1.2)  # stature m, build
LEFT_HAND, RIGHT_HAND, NECK, L_KNEE, L_ANKLE, R_ANKLE = 11, 12, 2, 9, 13, 14


# average and stout tell what depends on sizes; a third body costs as much again
ANYBODY = [AVERAGE, pytest.param(BIG, marks=pytest.mark.slow), SMALL]


@cache
def played(name, who=AVERAGE):
    stature_m, build = who
    body = Body.from_stature(stature_m)
    return VolumetricBody(body, build), HARD_CASES[name](body, HARD_CASES[name].duration_s, FPS, build)


@cache
def points_of(name):
    """The average person's points (n, 15, 3)."""
    person, motion = played(name)
    return np.array([forward(person.body, pose) for pose in motion.poses])


def spheres(capsules):
    """Centres (parts, 9, 3) and radii (parts, 9) of spheres along capsules: an oracle for what they fill."""
    share = np.linspace(0.0, 1.0, 9)
    centres = capsules.starts[:, None] + share[None, :, None] * (capsules.ends - capsules.starts)[:, None]
    return centres, capsules.radii[:, :1] + share * (capsules.radii[:, 1:] - capsules.radii[:, :1])


def gap_m(skin, some, others):
    """Least distance between two groups of capsules, whose spheres are the skin; negative where they overlap."""
    (a, ra), (b, rb) = ((skin[0][parts].reshape(-1, 3), skin[1][parts].ravel()) for parts in (some, others))
    return (np.linalg.norm(a[:, None] - b[None], axis=2) - ra[:, None] - rb[None]).min()


def parts_of(person, *sticks):
    return np.flatnonzero(np.isin(person.sticks, sticks)).tolist()


@pytest.mark.slow
@pytest.mark.parametrize("name", HARD_CASES)
def test_hard_case_is_a_movement_of_which_people_are_capable(name):
    (_, motion), points = played(name), points_of(name)
    assert (motion.angles > ANGLE_LOW - 1e-9).all()
    assert (motion.angles < ANGLE_HIGH + 1e-9).all()
    np.testing.assert_array_equal(motion.angles[: round(T_POSE_S * FPS)], np.tile(T_POSE_ANGLES, (FPS, 1)))
    velocity = np.diff(points, axis=0) * FPS
    assert np.linalg.norm(velocity, axis=2).max() < 9.0  # m/s: the foot of a kick
    assert np.linalg.norm(velocity[:, 0], axis=1).max() < 3.5  # m/s: the torso of a runner
    assert np.linalg.norm(np.diff(velocity[:, 0], axis=0) * FPS, axis=1).max() < 30.0  # m/s^2
    if name != "leave_and_return":
        assert (points > VOLUME.low + 0.03).all()
        assert (points < VOLUME.high - 0.03).all()
    if name not in ("lie_down", "jump", "run"):  # the foot that carries the body hardly slides
        ankles = points[:, [L_ANKLE, R_ANKLE]]
        carrying = ankles[:-1, :, 2].argmin(axis=1)
        rows = np.arange(len(carrying))
        slide = np.linalg.norm((ankles[1:] - ankles[:-1])[rows, carrying, :2], axis=1) * FPS
        assert np.median(slide) < 0.12  # m/s
        assert slide.mean() < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("name", HARD_CASES)
@pytest.mark.parametrize("who", ANYBODY)
def test_body_neither_sinks_into_the_floor_nor_passes_through_itself(name, who):
    person, motion = played(name, who)
    left, right = parts_of(person, L_FOREARM), parts_of(person, R_FOREARM)
    trunk, head = parts_of(person, TORSO), parts_of(person, HEAD)
    thighs, calves = ([parts_of(person, stick) for stick in pair] for pair in ((L_THIGH, R_THIGH), (L_CALF, R_CALF)))
    lowest = []
    for pose in motion.poses[::6]:
        skin = spheres(person.place(pose))
        lowest.append((skin[0][..., 2] - skin[1]).min())
        for forearm in (left, right):
            assert gap_m(skin, forearm, trunk) > -0.020
            assert gap_m(skin, forearm, head) > 0.0
            assert gap_m(skin, forearm, [*thighs[0], *thighs[1], *calves[0], *calves[1]]) > -0.015
        assert gap_m(skin, left, right) > -0.025  # clasped hands
        assert gap_m(skin, *calves) > -0.005
        assert gap_m(skin, *thighs) > -0.025
    assert min(lowest) > -0.015
    if name != "jump":
        assert max(lowest) < 0.012
    else:
        assert 0.08 < max(lowest) < 0.20


def test_arm_on_chest_keeps_the_forearm_on_the_skin_for_two_seconds():
    person, motion = played("arm_on_chest")
    gaps = np.array(
        [
            gap_m(spheres(person.place(pose)), parts_of(person, L_FOREARM), parts_of(person, TORSO))
            for pose in motion.poses
        ]
    )
    assert (gaps < 0.01).sum() >= 2 * FPS


def test_hands_meet_when_clasped_and_rest_on_the_hips_when_akimbo():
    points = points_of("hands_clasped")
    assert (np.linalg.norm(points[:, LEFT_HAND] - points[:, RIGHT_HAND], axis=1) < 0.10).sum() >= 2 * FPS
    person, motion = played("hands_on_hips")
    middle = spheres(person.place(motion.poses[4 * FPS]))
    assert gap_m(middle, parts_of(person, L_FOREARM), parts_of(person, TORSO)) < 0.04


def test_crossed_legs_put_each_ankle_on_the_other_side_once():
    points = points_of("crossed_legs")
    left_of = points[:, L_ANKLE, 1] - points[:, R_ANKLE, 1]
    ahead = points[:, L_ANKLE, 0] - points[:, R_ANKLE, 0]
    crossed = left_of < -0.03
    assert crossed.sum() > 2 * FPS
    assert (ahead[crossed] > 0.1).any() and (ahead[crossed] < -0.1).any()


def test_squat_sitting_and_lying_bring_the_torso_down():
    standing = points_of("squat")[0, 0, 2]
    assert points_of("squat")[:, 0, 2].min() < 0.60 * standing
    seated = points_of("sitting")[round(4.0 * FPS)]
    thigh = seated[L_KNEE] - seated[5]
    assert abs(thigh[2]) < 0.2 * np.linalg.norm(thigh)
    lying = played("lie_down")[1].poses[round(6.5 * FPS)]
    assert lying.position_world[2] < 0.16
    assert lying.R_world_torso[2, 0] > 0.99  # on the back: the chest up


def test_turn_on_spot_makes_two_turns_at_its_place():
    (_, motion), points = played("turn_on_spot"), points_of("turn_on_spot")
    headings = np.unwrap([np.arctan2(pose.R_world_torso[1, 0], pose.R_world_torso[0, 0]) for pose in motion.poses])
    assert headings[-1] - headings[0] == pytest.approx(4 * np.pi, abs=0.02)
    assert np.linalg.norm(points[:, 0, :2], axis=1).max() < 0.25


def test_leave_and_return_goes_out_of_the_volume_and_comes_back():
    points = points_of("leave_and_return")
    far = np.linalg.norm(points[:, 0, :2], axis=1)
    assert far.max() > 2.0
    assert (points[np.argmax(far), :, 0] > VOLUME.high[0]).all()
    assert far[-1] < 0.25


def test_jumper_falls_freely():
    fast = HARD_CASES["jump"](Body.from_stature(1.75), 5.0, 120)
    heights = np.array([pose.position_world[2] for pose in fast.poses])
    top = int(np.argmax(heights[:400]))
    acceleration = np.diff(heights[top - 10 : top + 11], 2) * 120**2
    assert acceleration.mean() == pytest.approx(-9.81, abs=0.5)


def test_unusual_proportions_keep_the_stature():
    average, leggy = person_of(1.80), person_of(1.80, arms=1.05, legs=1.05)
    assert leggy.stature == pytest.approx(1.80, abs=1e-9)
    assert leggy.lengths[L_THIGH] == pytest.approx(1.05 * average.lengths[L_THIGH])
    assert leggy.lengths[L_FOREARM] == pytest.approx(1.05 * average.lengths[L_FOREARM])
    for arms, legs in ((0.5, 1.0), (1.0, 1.5)):
        with pytest.raises(InputError, match="average"):
            person_of(1.80, arms, legs)


def test_build_thickens_the_trunk_and_hardly_the_head():
    body = Body.from_stature(1.75)
    pose = MOTIONS["t_pose_only"](body, 0.1, 30).poses[0]
    thick, thin = (VolumetricBody(body, build) for build in (1.2, 1.0))
    ratio = thick.place(pose).radii / thin.place(pose).radii
    np.testing.assert_allclose(ratio[parts_of(thin, TORSO)], 1.2)
    np.testing.assert_allclose(ratio[parts_of(thin, HEAD)], 1.06)
    np.testing.assert_allclose(ratio[-4:], 1.0)  # feet
    with pytest.raises(InputError, match="build"):
        VolumetricBody(body, 3.0)


# --- things -----------------------------------------------------------------------------------------------------------


THINGS_FPS = 20
# average and stout tell what depends on sizes; a third body costs as much again
PEOPLE = [(1.75, 1.0), pytest.param((1.93, 0.88), marks=pytest.mark.slow), (1.52, 1.2)]


@cache
def played_with(name, who=PEOPLE[0]):
    stature_m, build = who
    body = Body.from_stature(stature_m)
    motion = HARD_CASES[name](body, HARD_CASES[name].duration_s, THINGS_FPS, build)
    return VolumetricBody(body, build), motion, motion.things


def overlap_m(capsules, others):
    """How deep two groups of capsules are in each other at most; negative: how far apart."""
    (a, ra), (b, rb) = ((c.reshape(-1, 3), r.ravel()) for c, r in map(spheres, (capsules, others)))
    return -(np.linalg.norm(a[:, None] - b[None], axis=2) - ra[:, None] - rb[None]).min()


@pytest.mark.parametrize("who", PEOPLE)
def test_chair_is_under_whoever_sits_and_in_nobodys_way(who):
    person, motion, things = played_with("on_a_chair", who)
    deepest = [overlap_m(person.place(pose), things.standing) for pose in motion.poses[::10]]
    assert max(deepest) < 0.06  # flesh and seat give way
    assert max(deepest) > -0.01


@pytest.mark.parametrize("who", PEOPLE)
def test_box_stays_between_the_hands_and_outside_the_body(who):
    person, motion, things = played_with("carry_a_box", who)
    arms = np.isin(person.sticks, [L_FOREARM, R_FOREARM])
    rest = np.append(~arms, np.ones(4, bool))
    for frame in range(things.taken, len(motion.poses), 10):
        placed, box = person.place(motion.poses[frame]), things.carried[frame]
        body = placed._replace(starts=placed.starts[rest], ends=placed.ends[rest], radii=placed.radii[rest])
        assert overlap_m(body, box) < 0.03
        hands = forward(person.body, motion.poses[frame])[11:13]
        middle = 0.5 * (box.starts.mean(axis=0) + box.ends.mean(axis=0))
        assert np.linalg.norm(hands.mean(axis=0) - middle) < 0.08
        assert np.linalg.norm(hands[0] - hands[1]) == pytest.approx(0.43, abs=0.06)
    assert things.carried[0] is things.carried[things.taken]
    assert things.standing.starts[:, 2].min() >= 0.0


def test_what_stands_in_the_room_hides_legs_and_is_no_silhouette():
    person, motion, things = played_with("on_a_chair")
    rig = ring(3, ceiling=False)
    eyes, frame = ExactSilhouettes(rig), round(3.9 * THINGS_FPS)
    placed = person.place(motion.poses[frame])
    seen, whole = eyes.render(placed, things.standing), eyes.render(placed)
    shares = [np.count_nonzero(seen[name]) / np.count_nonzero(whole[name]) for name in rig.names]
    assert all(not (seen[name] & ~whole[name]).any() for name in rig.names)
    assert min(shares) < 0.9
    calves = np.isin(person.sticks, [L_CALF, R_CALF]).nonzero()[0]
    legs = placed._replace(**{f: getattr(placed, f)[calves] for f in placed._fields})
    hidden = [
        np.count_nonzero(eyes.render(legs, things.standing)[n]) / np.count_nonzero(eyes.render(legs)[n])
        for n in rig.names
    ]
    assert min(hidden) < 0.8


def test_a_filmed_room_shows_its_things_before_anybody_comes():
    person, motion, things = played_with("carry_a_box")
    camera = ring(1, ceiling=False).cameras[0]
    bare, empty = VirtualCamera(camera), VirtualCamera(camera, standing=things.untouched)
    assert np.count_nonzero(bare.empty_room() != empty.empty_room()) > 500
    light, mask = empty.render(person.place(motion.poses[0]), None)
    assert np.array_equal(light[mask == 0], empty.empty_room()[mask == 0])


def test_what_is_carried_belongs_to_the_person_from_when_it_is_taken():
    person, motion, things = played_with("carry_a_box")
    placed = person.place(motion.poses[things.taken])
    assert len(things.foreground(placed, things.taken - 1).radii) == len(placed.radii)
    assert len(things.foreground(placed, things.taken).radii) > len(placed.radii)
    assert things.room(things.taken - 1) is things.room(0) and things.room(things.taken) is things.standing
