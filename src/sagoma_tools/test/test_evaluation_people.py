"""Tracks of several persons against several truths."""

from pathlib import Path

import numpy as np
import pytest

from capture_rig.session import Truth
from mocap_packets.fit import GOOD
from sagoma_tools.evaluation.track import Track
from sagoma_tools.evaluation.track_evaluation import changes, main_track, score_people
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

FRAMES, FPS = 120, 60.0


def points(y):
    """(F, 15, 3) of somebody who walks along y."""
    body = Body.from_stature(1.7)
    places = np.column_stack([np.linspace(0.0, 1.0, FRAMES), np.full(FRAMES, y), np.full(FRAMES, 1.2)])
    return np.array([forward(body, Pose.from_angles(place, np.eye(3), T_POSE_ANGLES)) for place in places])


def truth(y):
    return Truth(np.arange(FRAMES), points(y), None, 1.0, Path("truth.csv"))


def track(points_world, frames=None, state="tracking"):
    frames = np.arange(len(points_world)) if frames is None else frames
    covariance = np.tile(1e-4 * np.eye(3), (len(frames), 15, 1, 1))
    angles, parts = np.zeros((len(frames), 18)), np.full((len(frames), 5), GOOD)
    return Track(frames, points_world, covariance, angles, np.full(len(frames), state), parts)


TRUTHS = truth(0.0), truth(2.0)


def test_each_track_belongs_to_the_truth_that_it_is_nearest_to_in_its_first_second():
    people = score_people({1: track(points(2.0) + 0.01), 2: track(points(0.0))}, TRUTHS, FPS)
    assert [person.numbers for person in people.persons] == [(2,), (1,)]
    assert people.switches == 0
    assert people.persons[0].scores.mean_mm == pytest.approx(0.0, abs=1e-9)
    assert people.persons[1].scores.mean_mm == pytest.approx(10.0 * np.sqrt(3.0))


def test_two_persons_taken_for_each_other_are_two_switches():
    first, second = points(0.0), points(2.0)
    half = FRAMES // 2 + 10
    tracks = {
        1: track(np.concatenate([first[:half], second[half:]])),
        2: track(np.concatenate([second[:half], first[half:]])),
    }
    assert score_people(tracks, TRUTHS, FPS).switches == 2


def test_new_number_of_a_person_counts_as_a_switch():
    first = points(0.0)
    tracks = {1: track(first[:60]), 3: track(first[60:], np.arange(60, FRAMES)), 2: track(points(2.0))}
    people = score_people(tracks, TRUTHS, FPS)
    assert people.persons[0].numbers == (1, 3)
    assert people.persons[0].switches == 1


def test_track_of_nobody_is_a_ghost():
    people = score_people({1: track(points(0.0)), 2: track(points(5.0))}, TRUTHS, FPS)
    assert people.ghosts == (2,)
    assert people.ghost_frames == FRAMES
    assert people.persons[1].scores is None


def test_what_a_track_calls_lost_is_not_looked_at():
    lost = track(points(9.0)[60:], np.arange(60, FRAMES), "lost")
    whole = Track(*(np.concatenate(pair) for pair in zip(track(points(0.0)[:60])._columns, lost._columns, strict=True)))
    people = score_people({1: whole}, TRUTHS[:1], FPS)
    assert people.ghost_frames == 0
    assert people.persons[0].scores.tracked == 60


def test_truth_that_is_nearer_for_a_moment_is_no_switch():
    rows = np.array([[0.1, 0.2]] * 20 + [[0.3, 0.2]] * 3 + [[0.1, 0.2]] * 20)
    assert changes(rows, 6) == 0
    assert changes(np.array([[0.1, 0.2]] * 20 + [[0.3, 0.2]] * 20), 6) == 1


def test_main_track_is_that_of_the_first_truth():
    tracks = {1: track(points(2.0)), 2: track(points(0.0))}
    assert main_track(tracks, TRUTHS, FPS) is tracks[2]
    assert main_track(tracks, TRUTHS[:1], FPS) is tracks[1]
