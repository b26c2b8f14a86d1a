"""The rule of the stamp: all cameras keep the same exposures, whatever jitter, drift and delay there is."""

import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_packets.thinning import EVERY_FRAME, LAPSE_NS, LARGEST_OF, FrameDecimation, FrameSelector, nearest_fraction

EPOCH_NS = 1_790_000_000_000_000_000
PERIOD_NS = 1e9 / 60


def rule(keep, of, from_ns=0):
    return FrameDecimation(from_ns, from_ns, EPOCH_NS, PERIOD_NS, keep, of)


def stamp(k):
    return EPOCH_NS + round(k * PERIOD_NS)


@given(st.integers(1, LARGEST_OF), st.integers(1, LARGEST_OF), st.integers(-1000, 1000))
def test_any_run_of_exposures_keeps_its_share_to_within_one_frame(keep, of, first):
    keep = min(keep, of)
    kept = [k for k in range(first, first + of) if rule(keep, of).keeps(stamp(k))]
    assert len(kept) == keep and rule(keep, of).fraction == keep / of
    gaps = {b - a for a, b in pairwise(kept)}
    assert gaps <= {of // keep, -(-of // keep)}  # as even as whole exposures allow


def test_cameras_that_jitter_and_are_apart_by_less_than_half_a_period_keep_the_same_exposures():
    draw, two_thirds = random.Random(1), rule(2, 3)
    for k in range(3000):
        choices = {two_thirds.keeps(stamp(k + draw.uniform(-0.45, 0.45))) for _ in range(5)}
        assert choices == {two_thirds.keeps(stamp(k))}


@pytest.mark.parametrize(
    ("share", "fraction"),
    [(1.0, (1, 1)), (2.0, (1, 1)), (0.999, (19, 20)), (2 / 3, (2, 3)), (0.46, (5, 11)), (0.0, (1, 20))],
)
def test_nearest_fraction_does_not_exceed_the_share(share, fraction):
    assert nearest_fraction(share) == fraction


@given(st.floats(0.1, 0.99))
def test_nearest_fraction_wastes_at_most_a_tenth_of_the_share(share):
    keep, of = nearest_fraction(share)
    assert 0.9 * share <= keep / of <= share + 1e-8 or share < 2 / LARGEST_OF


def test_rule_holds_from_its_first_stamp_on_and_the_one_before_until_then_though_it_is_told_twice():
    selector = FrameSelector()
    selector.update(rule(1, 2), 0)  # of which the phase is an exposure that is kept
    for now_ns in (10, 11):
        selector.update(FrameDecimation(stamp(100), stamp(100), stamp(1), PERIOD_NS, 1, 2), now_ns)
    assert [selector.keeps(stamp(k), 20) for k in (98, 99)] == [True, False]
    assert [selector.keeps(stamp(k), 20) for k in (100, 101)] == [False, True]


def test_nothing_is_kept_between_a_rule_and_the_stamp_at_which_it_resumes():
    selector = FrameSelector()
    selector.update(FrameDecimation(stamp(10), stamp(20), stamp(0), PERIOD_NS, 1, 2), 0)
    assert [k for k in range(30) if selector.keeps(stamp(k), 1)] == [*range(10), 20, 22, 24, 26, 28]


def test_rule_that_is_not_told_again_lapses_and_a_new_one_starts_from_every_frame():
    selector = FrameSelector()
    selector.update(rule(1, 2), 0)
    assert not selector.keeps(stamp(1), LAPSE_NS)
    assert selector.keeps(stamp(1), LAPSE_NS + 1)
    selector.update(rule(1, 3, from_ns=stamp(10)), 2 * LAPSE_NS)
    assert all(selector.keeps(stamp(0.37 * k), 2 * LAPSE_NS) for k in range(27)) and EVERY_FRAME.fraction == 1.0
