"""Scenes of several persons: who is where when, and sessions of them."""

import numpy as np
import pytest

from capture_rig.errors import InputError
from capture_rig.session import load_session
from stick_figure.kinematics import forward
from virtual_studio.motions.together import OUTSIDE_M, TOGETHER
from virtual_studio.people import OUTFITS, VolumetricBody, people_of_sizes, person_of, together
from virtual_studio.recording.session import write_scene
from virtual_studio.rig import VOLUME, ring

PAIR = people_of_sizes(2)
RIGHT_HAND = 12


def places(motion):
    """(F, 2) the torso's place on the floor."""
    return np.array([pose.position_world[:2] for pose in motion.poses])


@pytest.fixture(scope="module")
def coming_later():
    """The motions of the two, 5 frames a second."""
    return TOGETHER["coming_later"].motions(PAIR, 5.0)


def test_second_person_comes_into_the_volume_leaves_it_and_comes_back(coming_later):
    staying, coming = map(places, coming_later)
    inside = (np.abs(coming) < VOLUME.high[:2]).all(axis=1)
    assert np.flatnonzero(np.diff(inside.astype(int))).size == 3  # in, out and in again
    assert coming[0, 0] == pytest.approx(OUTSIDE_M)
    assert np.linalg.norm(staying - staying[0], axis=1).max() < 0.4


@pytest.mark.slow
def test_persons_of_the_crowd_keep_out_of_each_others_way():
    motions = TOGETHER["crowd"].motions(people_of_sizes(4), 2.0)
    four = np.array([places(motion) for motion in motions])
    apart = np.linalg.norm(four[:, None] - four[None], axis=-1)[np.triu_indices(4, 1)]
    assert apart.min() > 0.5


def test_parts_of_several_bodies_are_rendered_as_one(coming_later):
    poses = [motion.poses[0] for motion in coming_later]
    bodies = [person.place(pose) for person, pose in zip(PAIR, poses, strict=True)]
    both = together(*bodies)
    assert len(both.albedo) == sum(len(body.albedo) for body in bodies)
    np.testing.assert_array_equal(both.starts[len(bodies[0].starts) :], bodies[1].starts)


@pytest.mark.slow
def test_session_of_a_scene_has_a_truth_and_a_body_for_each_person(tmp_path, coming_later):
    folder = write_scene(tmp_path / "scene", ring(1), "coming_later", PAIR, [OUTFITS["middle"]], fps=1.0)
    session = load_session(folder)
    assert [truth.source.name for truth in session.truths] == ["truth.csv", "truth_2.csv"]
    assert (folder / "body_2.yaml").is_file()
    for person, truth, motion in zip(PAIR, session.truths, coming_later, strict=True):
        np.testing.assert_allclose(truth.points_world[2], forward(person.body, motion.poses[10]), atol=1e-3)


def test_scene_that_does_not_exist_or_lacks_persons_is_refused(tmp_path):
    with pytest.raises(InputError, match="no scene 'dance'"):
        write_scene(tmp_path / "scene", ring(1), "dance", PAIR)
    with pytest.raises(InputError, match="1 persons for the 2 roles"):
        write_scene(tmp_path / "scene", ring(1), "meeting", PAIR[:1])


@pytest.mark.slow
@pytest.mark.parametrize("persons", [PAIR, (VolumetricBody(person_of(1.9)), VolumetricBody(person_of(1.55)))])
def test_two_who_meet_pass_each_other_shake_hands_hug_and_part(persons):
    motions = TOGETHER["meeting"].motions(persons, 10.0)
    apart = np.linalg.norm(places(motions[0]) - places(motions[1]), axis=1)
    hands = np.array(
        [
            [forward(p.body, pose)[RIGHT_HAND] for pose in motion.poses]
            for p, motion in zip(persons, motions, strict=True)
        ]
    )
    shaking = np.linalg.norm(hands[0] - hands[1], axis=1)
    assert 0.4 < apart[15:40].min() < 0.8  # they pass each other
    assert (shaking < 0.2).sum() >= 10  # and shake hands for a second
    assert 0.2 < apart[70:120].min() < 0.5  # the hug
    assert apart[-10:].min() > 0.9  # and part
