"""Statistics of frames: expected = delivered + incomplete + lost, whatever a device and a network do."""

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camera_client.frame_source import WRAP_16_BIT, FrameStatistics

WHOLE, HALF, LOST, TWICE = "whole", "half", "lost", "twice"
FATES = st.lists(st.sampled_from([WHOLE, WHOLE, HALF, LOST, TWICE]), max_size=60)


def ids_from(first):
    """GVSP block ids of 16 bits: ... 65534, 65535, 1, 2 ..."""
    value = first
    while True:
        yield value
        value = value % WRAP_16_BIT + 1


def play(statistics, fates, first, says_first=True):
    """One run of acquisition; what a bystander who knows every frame's fate expects of the statistics."""
    statistics.restart(first if says_first else None)
    known, arrived = 0, []
    for place, (frame_id, fate) in enumerate(zip(ids_from(first), fates, strict=False)):
        if fate != LOST:
            arrived.append(place)
            statistics.add(frame_id, complete=fate != HALF)
        if fate == TWICE:
            statistics.add(frame_id)
    if arrived:
        known = arrived[-1] + 1 - (0 if says_first else arrived[0])
    kept = [fates[place] for place in arrived]
    return known, kept.count(WHOLE) + kept.count(TWICE), kept.count(HALF), known - len(kept), kept.count(TWICE)


def counts(statistics):
    return statistics.expected, statistics.delivered, statistics.incomplete, statistics.lost, statistics.repeated


@given(st.lists(st.tuples(FATES, st.integers(1, WRAP_16_BIT), st.booleans()), max_size=5))
def test_account_agrees_with_the_fate_of_every_frame_over_wraps_and_restarts(runs):
    statistics, totals = FrameStatistics(), (0, 0, 0, 0, 0)
    for fates, first, says_first in runs:
        totals = tuple(a + b for a, b in zip(totals, play(statistics, fates, first, says_first), strict=True))
    assert counts(statistics) == totals
    assert statistics.expected == statistics.delivered + statistics.incomplete + statistics.lost


@pytest.mark.parametrize(
    "ids, expected",
    [
        ((65533, 65534, 65535, 1, 2, 5, 6), (9, 7, 0, 2, 0)),
        ((65535, 1, 65535, 2), (3, 3, 0, 0, 1)),  # a repetition from before the wrap
        ((70_000, 170_000, 100_000), (100_001, 2, 0, 99_999, 1)),  # ids of 64 bits do not wrap
    ],
)
def test_skipped_ids_are_lost_frames_over_a_wrap_too(ids, expected):
    statistics = FrameStatistics()
    for frame_id in ids:
        statistics.add(frame_id)
    assert counts(statistics) == expected


def test_snapshot_keeps_the_rule_while_another_thread_adds():
    statistics, finished = FrameStatistics(), threading.Event()

    def add():
        for frame_id in range(1, 15_000, 3):
            statistics.add(frame_id, complete=frame_id % 2 == 0)
        finished.set()

    thread = threading.Thread(target=add)
    thread.start()
    looks = 0
    while not finished.is_set() or looks == 0:
        seen = statistics.snapshot()
        assert seen.expected == seen.delivered + seen.incomplete + seen.lost
        looks += 1
    thread.join()
    assert statistics.snapshot() == statistics and statistics.expected == 14_998
