"""The hard cases: possible movements of a body that passes through neither itself nor the floor, and things there."""

from functools import cache

import numpy as np
import pytest

from stick_figure import skeleton
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import HARD_CASES, MOTIONS, T_POSE_S
from virtual_studio.people import VolumetricBody, person_of
from virtual_studio.rendering.camera import ExactSilhouettes, VirtualCamera
from virtual_studio.rig import VOLUME, ring

FPS, TOUR_S = 30, 11.0
AVERAGE, SMALL = (1.75, 1.0), (1.52, 1.2)  # stature m, build: what depends on sizes shows on these two
ARMS = skeleton.L_FOREARM, skeleton.R_FOREARM
THIGHS, CALVES = (skeleton.L_THIGH, skeleton.R_THIGH), (skeleton.L_CALF, skeleton.R_CALF)
LEFT_HAND, RIGHT_HAND, NECK, L_KNEE, L_ANKLE, R_ANKLE = 11, 12, 2, 9, 13, 14


@cache
def played(name, who=AVERAGE):
    """A person and the motion."""
    stature_m, build = who
    body, seconds = Body.from_stature(stature_m), HARD_CASES[name].duration_s if name in HARD_CASES else TOUR_S
    return VolumetricBody(body, build), MOTIONS[name](body, seconds, FPS, build)


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


def skin(person, pose):
    """The spheres that fill the parts of a posed person, by sticks."""
    centres, radii = spheres(person.place(pose))

    def of_sticks(*sticks):
        parts = np.flatnonzero(np.isin(person.sticks, sticks))
        return centres[parts], radii[parts]

    return of_sticks


def gap_m(some, others):
    """Least distance between the skins of two groups of spheres (centres, radii); negative where they overlap."""
    (a, ra), (b, rb) = ((centres.reshape(-1, 3), radii.ravel()) for centres, radii in (some, others))
    return (np.linalg.norm(a[:, None] - b[None], axis=2) - ra[:, None] - rb[None]).min()


@pytest.mark.slow
@pytest.mark.parametrize("name", [*HARD_CASES, "tour", "walk"])
def test_motion_is_a_movement_of_which_people_are_capable(name):
    (_, motion), points = played(name), points_of(name)
    assert (motion.angles > skeleton.ANGLE_LOW - 1e-9).all()
    assert (motion.angles < skeleton.ANGLE_HIGH + 1e-9).all()
    np.testing.assert_array_equal(motion.angles[: round(T_POSE_S * FPS)], np.tile(skeleton.T_POSE_ANGLES, (FPS, 1)))
    velocity = np.diff(points, axis=0) * FPS
    assert np.linalg.norm(velocity, axis=2).max() < 9.0  # m/s: the foot of a kick
    assert np.linalg.norm(velocity[:, 0], axis=1).max() < 3.5  # m/s: the torso of a runner
    assert np.linalg.norm(np.diff(velocity[:, 0], axis=0) * FPS, axis=1).max() < 30.0  # m/s^2
    if name != "leave_and_return":
        assert (points > VOLUME.low + 0.03).all()
        assert (points < VOLUME.high - 0.03).all()
    if name in HARD_CASES and name not in ("lie_down", "jump", "run"):  # the foot that carries the body hardly slides
        ankles = points[:, [L_ANKLE, R_ANKLE]]
        carrying = ankles[:-1, :, 2].argmin(axis=1)
        rows = np.arange(len(carrying))
        slide = np.linalg.norm((ankles[1:] - ankles[:-1])[rows, carrying, :2], axis=1) * FPS
        assert np.median(slide) < 0.12  # m/s
        assert slide.mean() < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("name", [*HARD_CASES, "tour"])
@pytest.mark.parametrize("who", [AVERAGE, SMALL])
def test_body_neither_sinks_into_the_floor_nor_passes_through_itself(name, who):
    person, motion = played(name, who)
    lowest = []
    for pose in motion.poses[::6]:
        part, (centres, radii) = skin(person, pose), spheres(person.place(pose))
        lowest.append((centres[..., 2] - radii).min())
        for forearm in map(part, ARMS):
            assert gap_m(forearm, part(skeleton.TORSO)) > -0.020
            assert gap_m(forearm, part(skeleton.HEAD)) > 0.0
            assert gap_m(forearm, part(*THIGHS, *CALVES)) > -0.015
        for pair, least_m in ((ARMS, -0.025), (CALVES, -0.005), (THIGHS, -0.025)):  # clasped hands
            assert gap_m(*map(part, pair)) > least_m
    assert min(lowest) > -0.015
    assert 0.08 < max(lowest) < 0.20 if name == "jump" else max(lowest) < 0.012


def test_hands_touch_what_the_motion_is_named_after():
    for name, least_m, frames in (("arm_on_chest", 0.01, 2 * FPS), ("hands_on_hips", 0.04, 1)):
        person, motion = played(name)
        parts = [skin(person, pose) for pose in motion.poses]
        assert sum(gap_m(part(ARMS[0]), part(skeleton.TORSO)) < least_m for part in parts) >= frames
    points = points_of("hands_clasped")
    assert (np.linalg.norm(points[:, LEFT_HAND] - points[:, RIGHT_HAND], axis=1) < 0.10).sum() >= 2 * FPS


def test_crossed_legs_put_each_ankle_on_the_other_side_once():
    points = points_of("crossed_legs")
    ahead, left_of, _ = (points[:, L_ANKLE] - points[:, R_ANKLE]).T
    crossed = left_of < -0.03
    assert crossed.sum() > 2 * FPS and ahead[crossed].max() > 0.1 and ahead[crossed].min() < -0.1


def test_squat_sitting_and_lying_bring_the_torso_down():
    standing = points_of("squat")[0, 0, 2]
    assert points_of("squat")[:, 0, 2].min() < 0.60 * standing
    seated = points_of("sitting")[round(4.0 * FPS)]
    thigh = seated[L_KNEE] - seated[5]
    assert abs(thigh[2]) < 0.2 * np.linalg.norm(thigh)
    lying = played("lie_down")[1].poses[round(6.5 * FPS)]
    assert lying.position_world[2] < 0.16 and lying.R_world_torso[2, 0] > 0.99  # on the back: the chest up


def test_turning_stays_at_its_place_and_leaving_goes_out_of_the_volume_and_comes_back():
    poses = played("turn_on_spot")[1].poses
    headings = np.unwrap([np.arctan2(pose.R_world_torso[1, 0], pose.R_world_torso[0, 0]) for pose in poses])
    assert headings[-1] - headings[0] == pytest.approx(4 * np.pi, abs=0.02)
    turning, leaving = (
        np.linalg.norm(points_of(name)[:, 0, :2], axis=1) for name in ("turn_on_spot", "leave_and_return")
    )
    assert turning.max() < 0.25 and leaving.max() > 2.0 and leaving[-1] < 0.25
    assert (points_of("leave_and_return")[np.argmax(leaving), :, 0] > VOLUME.high[0]).all()


def test_jumper_falls_freely():
    fast = HARD_CASES["jump"](Body.from_stature(1.75), 5.0, 120)
    heights = np.array([pose.position_world[2] for pose in fast.poses])
    top = int(np.argmax(heights[:400]))
    acceleration = np.diff(heights[top - 10 : top + 11], 2) * 120**2
    assert acceleration.mean() == pytest.approx(-9.81, abs=0.5)


def test_unusual_proportions_keep_the_stature():
    average, leggy = person_of(1.80), person_of(1.80, arms=1.05, legs=1.05)
    assert leggy.stature == pytest.approx(1.80, abs=1e-9)
    assert leggy.lengths[skeleton.L_THIGH] == pytest.approx(1.05 * average.lengths[skeleton.L_THIGH])
    assert leggy.lengths[skeleton.L_FOREARM] == pytest.approx(1.05 * average.lengths[skeleton.L_FOREARM])


def test_build_thickens_the_trunk_and_hardly_the_head():
    body = Body.from_stature(1.75)
    pose = MOTIONS["t_pose_only"](body, 0.1, 30).poses[0]
    thick, thin = (VolumetricBody(body, build) for build in (1.2, 1.0))
    ratio = thick.place(pose).radii / thin.place(pose).radii
    for stick, expected in ((skeleton.TORSO, 1.2), (skeleton.HEAD, 1.06)):
        np.testing.assert_allclose(ratio[np.flatnonzero(thin.sticks == stick)], expected)
    np.testing.assert_allclose(ratio[-4:], 1.0)  # feet


# --- things -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("who", [AVERAGE, SMALL])
def test_chair_is_under_whoever_sits_and_in_nobodys_way(who):
    person, motion = played("on_a_chair", who)
    chair = spheres(motion.things.standing)
    gaps = [gap_m(spheres(person.place(pose)), chair) for pose in motion.poses[::15]]
    assert -0.06 < min(gaps) < 0.01  # flesh gives way


@pytest.mark.parametrize("who", [AVERAGE, SMALL])
def test_box_stays_between_the_hands_and_outside_the_body(who):
    person, motion = played("carry_a_box", who)
    things, rest = motion.things, np.append(~np.isin(person.sticks, ARMS), np.ones(4, bool))
    for frame in range(things.taken, len(motion.poses), 15):
        box, (centres, radii) = things.carried[frame], spheres(person.place(motion.poses[frame]))
        assert gap_m((centres[rest], radii[rest]), spheres(box)) > -0.03
        hands = forward(person.body, motion.poses[frame])[11:13]
        middle = 0.5 * (box.starts.mean(axis=0) + box.ends.mean(axis=0))
        assert np.linalg.norm(hands.mean(axis=0) - middle) < 0.08
        assert np.linalg.norm(hands[0] - hands[1]) == pytest.approx(0.43, abs=0.06)
    assert things.carried[0] is things.carried[things.taken]
    assert things.standing.starts[:, 2].min() >= 0.0


def test_what_stands_in_the_room_hides_legs_and_is_no_silhouette():
    person, motion = played("on_a_chair")
    rig = ring(3, ceiling=False)
    eyes, placed = ExactSilhouettes(rig), person.place(motion.poses[round(3.9 * FPS)])
    calves = np.isin(person.sticks, CALVES).nonzero()[0]
    legs = placed._replace(**{f: getattr(placed, f)[calves] for f in placed._fields})
    for parts, most in ((placed, 0.9), (legs, 0.8)):
        seen, whole = eyes.render(parts, motion.things.standing), eyes.render(parts)
        assert all(not (seen[name] & ~whole[name]).any() for name in rig.names)
        assert min(np.count_nonzero(seen[name]) / np.count_nonzero(whole[name]) for name in rig.names) < most


def test_a_thing_belongs_to_the_room_until_it_is_taken_and_then_to_the_person():
    person, motion = played("carry_a_box")
    things, camera = motion.things, ring(1, ceiling=False).cameras[0]
    bare, furnished = VirtualCamera(camera), VirtualCamera(camera, standing=things.untouched)
    assert np.count_nonzero(bare.empty_room() != furnished.empty_room()) > 500
    light, mask = furnished.render(person.place(motion.poses[0]), None)
    assert np.array_equal(light[mask == 0], furnished.empty_room()[mask == 0])
    placed = person.place(motion.poses[things.taken])
    assert len(things.foreground(placed, things.taken - 1).radii) == len(placed.radii)
    assert len(things.foreground(placed, things.taken).radii) > len(placed.radii)
    assert things.room(things.taken - 1) is things.room(0) and things.room(things.taken) is things.standing
