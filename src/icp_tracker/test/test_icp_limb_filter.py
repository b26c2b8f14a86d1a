"""What is believed of a limb: places gather odds by stamps, few samples speak for "unseen". Margins are made up."""

import numpy as np
import pytest

from icp_tracker.monitor.limb_filter import CHANCE_SAMPLES, DOUBTFUL, MEMORY_S, PLACE_LOG_PRIOR, LimbBelief
from icp_tracker.monitor.limb_search import NO_POSES, LimbPlaces

NEAR, FAR, SHOWN = 0.2, 0.6, 15.0  # m, m, samples of a limb in view


def places(*rivals, samples=SHOWN, unexplained=0.0):
    """Other places of an arm, best first: margin (samples), how far off (m), and which of the known ones it is."""
    margins, apart, origins = np.array(sorted(rivals, reverse=True), float).reshape(-1, 3).T
    ends = np.zeros((len(margins), 2, 3))
    ends[:, :, 1] = apart[:, None]
    return LimbPlaces(NO_POSES, margins, ends, np.zeros((2, 3)), samples, unexplained, origins.astype(int))


def after(*sets, dt_s=1 / 60, hidden=False):
    belief = None
    for one in sets:
        belief = LimbBelief.after(belief, one, dt_s, hidden)
    return belief


def seconds_until_moved(margin, dt_s=1 / 60):
    sets = 1
    while after(*[places((margin, FAR, 0))] * sets, dt_s=dt_s).likeliest_place is None:
        sets += 1
        assert sets < 1000
    return sets * dt_s


def test_a_place_that_explains_more_moves_the_limb_the_sooner_the_more_it_explains():
    times = [seconds_until_moved(margin) for margin in (1.5, 2.5, 8.0)]
    assert times == sorted(times, reverse=True) and times[0] > 3.0 * times[-1]


def test_it_takes_the_same_time_at_any_rate():
    slow, fast = (seconds_until_moved(4.0, dt_s) for dt_s in (1 / 15, 1 / 120))
    assert slow == pytest.approx(fast, abs=1 / 15)


def test_a_place_about_as_good_makes_doubtful_only_when_it_is_elsewhere():
    assert after(*[places((2.0, FAR, 0))] * 30).not_as_tracked > DOUBTFUL
    assert after(*[places((2.0, NEAR, 0))] * 30).not_as_tracked < 0.1
    assert after(*[places((-10.0, FAR, 0))] * 30).not_as_tracked < 0.1


def test_what_was_seen_a_moment_ago_is_not_unseen_at_once_unless_it_reaches_beyond_the_cameras():
    whole, gone = places(samples=SHOWN), places(samples=0.0)
    assert after(*[whole] * 30, gone).not_as_tracked < DOUBTFUL
    assert LimbBelief.after(after(*[whole] * 30), gone, 1 / 60, hidden=True).not_as_tracked > DOUBTFUL
    assert after(*[whole] * 30, *[gone] * round(3 * MEMORY_S * 60)).probabilities[-1] > 0.9


def test_as_much_left_over_as_explained_makes_doubtful_though_no_other_place_was_found():
    assert after(*[places(unexplained=SHOWN)] * 30).not_as_tracked > DOUBTFUL
    assert after(*[places(unexplained=SHOWN / 3)] * 30).not_as_tracked < 0.1
    assert after(*[places(unexplained=2.0 * SHOWN)] * 30).probabilities[-1] < 0.1


@pytest.mark.parametrize(
    ("sets", "moved_to"),
    [
        ([places((-PLACE_LOG_PRIOR, FAR, 0))] * 1000, None),
        ([places((-20.0, FAR, 0))] * 10 + [places((1000.0, FAR, 0))], None),
        ([places((CHANCE_SAMPLES - 1.0, FAR, 0), samples=0.0)] * 60, None),
        ([places((CHANCE_SAMPLES + 3.0, FAR, 0), samples=0.0)] * 60, 0),
    ],
    ids=["no more than its prior for long", "one torn set", "less than chance", "more than chance"],
)
def test_a_limb_is_moved_only_to_what_explains_more_for_a_while(sets, moved_to):
    assert after(*sets).likeliest_place == moved_to


def test_a_place_that_is_followed_keeps_its_odds_and_a_refuted_or_new_one_starts_anew():
    known = after(*[places((6.0, NEAR, 0))] * 3)
    later = LimbBelief.after(known, places((6.0, NEAR, 0), (2.0, FAR, -1), (1.0, FAR, 1)), 1 / 60, False)
    assert later.log_odds[0] > known.log_odds[0] > later.log_odds[1:].max()
    assert known.without(0).log_odds[0] == PLACE_LOG_PRIOR


def test_an_unseen_hand_may_be_anywhere_about_its_elbow():
    tracked = np.array([[0.0, 0.0, 0.0], [0.45, 0.0, 0.0]])
    nowhere = LimbPlaces(NO_POSES, np.empty(0), np.empty((0, 2, 3)), tracked, 0.0, 0.0, np.empty(0, int))
    belief = after(*[nowhere] * 60)
    assert belief.probabilities[-1] > 0.9
    assert np.diag(belief.spread[1]) == pytest.approx(2 / 3 * 0.45**2, rel=0.05)  # of a stick of free direction
    assert (np.diag(belief.spread[0]) < np.diag(belief.spread[1])).all()
