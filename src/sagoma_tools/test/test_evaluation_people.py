"""Tracks of several persons against several truths; wrong parts that are called, clear frames in which one is."""

import numpy as np
import pytest
from evaluation_tracks import track_of, truth_of, walker

from mocap_packets.fit import DOUBTFUL, GOOD, LOST, PART_NAMES
from sagoma_tools.evaluation.scores import score
from sagoma_tools.evaluation.track import Track
from sagoma_tools.evaluation.track_evaluation import changes, main_track, score_people

FRAMES, FPS = 120, 60.0
ASIDE_M = np.array([0.0, 1.0, 0.0])
FIRST, SECOND = walker(FRAMES)[0], walker(FRAMES, aside_m=2.0)[0]
TRUTHS = truth_of(FIRST), truth_of(SECOND)


# --- whose track is whose


def test_each_track_belongs_to_the_truth_that_it_is_nearest_to_in_its_first_second():
    people = score_people({1: track_of(SECOND + 0.01), 2: track_of(FIRST)}, TRUTHS, FPS)
    assert people.who.numbers == ((2,), (1,))
    assert people.who.switches == (0, 0)
    assert people.scores[0].mean_mm == pytest.approx(0.0, abs=1e-9)
    assert people.scores[1].mean_mm == pytest.approx(10.0 * np.sqrt(3.0))


def parts_of(*pieces):
    return track_of(np.concatenate(pieces))


@pytest.mark.parametrize(
    ("tracks", "numbers", "switches", "ghosts"),
    [
        ({1: parts_of(FIRST[:70], SECOND[70:]), 2: parts_of(SECOND[:70], FIRST[70:])}, [(1,), (2,)], (1, 1), ()),
        ({1: track_of(FIRST[:60]), 3: track_of(FIRST[60:], first=60), 2: track_of(SECOND)}, [(1, 3), (2,)], (1, 0), ()),
        ({1: track_of(FIRST), 2: track_of(FIRST + 5.0 * ASIDE_M)}, [(1,), ()], (0, None), (2,)),
    ],
    ids=["two taken for each other", "a new number", "a track of nobody is a ghost"],
)
def test_switches_of_numbers_and_tracks_of_nobody_are_counted(tracks, numbers, switches, ghosts):
    people = score_people(tracks, TRUTHS, FPS)
    assert list(people.who.numbers) == numbers
    assert (people.who.switches, people.who.ghosts, people.who.ghost_frames) == (switches, ghosts, FRAMES * len(ghosts))
    assert [scores is None for scores in people.scores] == [not each for each in numbers]


def test_what_a_track_calls_lost_is_not_looked_at():
    away = np.concatenate([FIRST[:60], FIRST[60:] + 9.0 * ASIDE_M])
    people = score_people({1: track_of(away, np.repeat(["tracking", "lost"], 60))}, TRUTHS[:1], FPS)
    assert people.who.ghost_frames == 0
    assert people.scores[0].tracked == 60


def test_truth_that_is_nearer_for_a_moment_is_no_switch():
    rows = np.array([[0.1, 0.2]] * 20 + [[0.3, 0.2]] * 3 + [[0.1, 0.2]] * 20)
    assert changes(rows, 6) == 0
    assert changes(np.array([[0.1, 0.2]] * 20 + [[0.3, 0.2]] * 20), 6) == 1


def test_main_track_is_that_of_the_first_truth():
    tracks = {1: track_of(SECOND), 2: track_of(FIRST)}
    assert main_track(tracks, TRUTHS, FPS) is tracks[2]
    assert main_track(tracks, TRUTHS[:1], FPS) is tracks[1]


# --- parts that are wrong, and parts that are called doubtful or lost

TEN = FIRST[:10]
LEFT_ARM, RIGHT_LEG = PART_NAMES.index("left arm"), PART_NAMES.index("right leg")
LEFT_ELBOW, LEFT_HAND, RIGHT_FOOT = 7, 11, 14


def off(points_world, errors_m):
    """Points moved along x by errors (F, 15) m."""
    return points_world + np.asarray(errors_m)[..., None] * [1.0, 0.0, 0.0]


def flagged_by_hand():
    """Frames 0 to 3: the left arm is wrong, in 0 and 1 it is called, as lost in 1; frame 0: so is the right leg, which
    is not called. Frame 4: a hand is 150 mm off, neither wrong nor clear, and called. Frame 5: clear, a leg called."""
    errors, parts = np.zeros((10, 15)), np.full((10, 5), GOOD, "<U8")
    errors[:4, LEFT_HAND], errors[0, LEFT_ELBOW], errors[0, RIGHT_FOOT], errors[4, LEFT_HAND] = 0.3, 0.25, 0.21, 0.15
    parts[0, LEFT_ARM], parts[1, LEFT_ARM], parts[4, LEFT_ARM], parts[5, RIGHT_LEG] = DOUBTFUL, LOST, DOUBTFUL, LOST
    return errors, parts


def test_shares_are_those_of_flags_set_by_hand():
    errors, parts = flagged_by_hand()
    scores = score(track_of(off(TEN, errors), parts=parts), truth_of(TEN))
    assert scores.calls.wrong.sum() == 5 and scores.calls.clear.tolist() == [False] * 5 + [True] * 5
    assert scores.calls.flagged_of_bad == pytest.approx(2 / 5)
    assert scores.calls.false_alarms == pytest.approx(1 / 5)


@pytest.mark.parametrize(("error_m", "false_alarms"), [(0.0, 0.0), (0.15, None)], ids=["clear", "neither"])
def test_shares_of_nothing_are_null(error_m, false_alarms):
    figures = score(track_of(off(TEN, np.full((10, 15), error_m))), truth_of(TEN)).figures()
    assert (figures["flagged_of_bad"], figures["false_alarms"]) == (None, false_alarms)


def test_several_truths_give_a_record_a_person_and_their_mean():
    first, second, third = TEN, TEN + 3.0 * ASIDE_M, TEN + 6.0 * ASIDE_M
    errors, parts = flagged_by_hand()
    tracks = {1: track_of(off(first, errors), parts=parts), 2: track_of(off(second, errors)), 3: Track.of_states([])}
    thesis = {1: track_of(off(second, np.full((10, 15), 0.08))), 2: track_of(off(first, np.full((10, 15), 0.04)))}
    truths = truth_of(first), truth_of(second), truth_of(third)
    figures = score_people(tracks, truths, FPS).figures(score_people(thesis, truths, FPS))
    persons = figures["persons"]
    for key, of_persons, mean in (
        ("flagged_of_bad", [0.4, 0.0, None], 0.2),
        ("false_alarms", [0.2, 0.0, None], 0.1),
        ("thesis_mean_mm", [40.0, 80.0, None], 60.0),
        ("identity_switches", [0, 0, None], 0),
    ):
        assert ([one[key] for one in persons], figures[key]) == (of_persons, mean), key
    assert [one["tracked"] for one in persons] == [10, 10, 0]
    assert figures["mean_mm"] == pytest.approx(np.mean([one["mean_mm"] for one in persons[:2]]))
    assert set(persons[2]) == set(persons[0]) and persons[2]["mean_mm"] is None
