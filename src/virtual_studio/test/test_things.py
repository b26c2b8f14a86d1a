"""Things beside the studio's person: a chair that hides legs, a box that is lifted off a stand and carried away."""

from functools import cache

import numpy as np
import pytest
from test_hard_case_motions import spheres

from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.skeleton import L_CALF, L_FOREARM, R_CALF, R_FOREARM
from virtual_studio.motions.catalogue import HARD_CASES
from virtual_studio.people import VolumetricBody
from virtual_studio.rendering.camera import ExactSilhouettes, VirtualCamera
from virtual_studio.rig import ring

FPS = 20
# average and stout tell what depends on sizes; a third body costs as much again
PEOPLE = [(1.75, 1.0), pytest.param((1.93, 0.88), marks=pytest.mark.slow), (1.52, 1.2)]


@cache
def played(name, who=PEOPLE[0]):
    stature_m, build = who
    body = Body.from_stature(stature_m)
    motion = HARD_CASES[name](body, HARD_CASES[name].duration_s, FPS, build)
    return VolumetricBody(body, build), motion, motion.things


def overlap_m(capsules, others):
    """How deep two groups of capsules are in each other at most; negative: how far apart."""
    (a, ra), (b, rb) = ((c.reshape(-1, 3), r.ravel()) for c, r in map(spheres, (capsules, others)))
    return -(np.linalg.norm(a[:, None] - b[None], axis=2) - ra[:, None] - rb[None]).min()


@pytest.mark.parametrize("who", PEOPLE)
def test_chair_is_under_whoever_sits_and_in_nobodys_way(who):
    person, motion, things = played("on_a_chair", who)
    deepest = [overlap_m(person.place(pose), things.standing) for pose in motion.poses[::10]]
    assert max(deepest) < 0.06  # flesh and seat give way
    assert max(deepest) > -0.01


@pytest.mark.parametrize("who", PEOPLE)
def test_box_stays_between_the_hands_and_outside_the_body(who):
    person, motion, things = played("carry_a_box", who)
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
    person, motion, things = played("on_a_chair")
    rig = ring(3, ceiling=False)
    eyes, frame = ExactSilhouettes(rig), round(3.9 * FPS)
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
    person, motion, things = played("carry_a_box")
    camera = ring(1, ceiling=False).cameras[0]
    bare, empty = VirtualCamera(camera), VirtualCamera(camera, standing=things.untouched)
    assert np.count_nonzero(bare.empty_room() != empty.empty_room()) > 500
    light, mask = empty.render(person.place(motion.poses[0]), None)
    assert np.array_equal(light[mask == 0], empty.empty_room()[mask == 0])


def test_what_is_carried_belongs_to_the_person_from_when_it_is_taken():
    person, motion, things = played("carry_a_box")
    placed = person.place(motion.poses[things.taken])
    assert len(things.foreground(placed, things.taken - 1).radii) == len(placed.radii)
    assert len(things.foreground(placed, things.taken).radii) > len(placed.radii)
    assert things.room(things.taken - 1) is things.room(0) and things.room(things.taken) is things.standing
