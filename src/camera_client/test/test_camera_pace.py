"""When frames leave: by a clock of the test's own, never by waiting."""

import itertools

import pytest

from camera_client.sources.footage_source import AcknowledgedPace, FootageClock, SharedClock
from capture_rig.session import footage_stamp_ns

EPOCH_NS = 1_800_000_000_000_000_000
MS = 1_000_000


def acknowledged(window, patience_s=2.0):
    """A pace, and the time in seconds that it goes by."""
    now_s = [0.0]
    pace = AcknowledgedPace(50.0, window, patience_s, lambda: now_s[0])
    pace.begin(EPOCH_NS, 0)
    return pace, now_s


def test_as_many_frames_as_the_window_leave_and_one_more_with_each_acknowledgement():
    pace, _ = acknowledged(window=3)
    assert [pace.wait(k, 0.0) for k in range(4)] == [True, True, True, False]
    for k in range(3, 40):
        pace.acknowledge(footage_stamp_ns(EPOCH_NS, k - 3, 50.0))
        assert pace.wait(k, 0.0) and not pace.wait(k + 1, 0.0)
    assert pace.timeouts == 0


def test_silent_consumer_is_outrun_after_the_timeout_which_frames_and_acknowledgements_begin_anew():
    pace, now_s = acknowledged(window=1, patience_s=2.0)
    pace.wait(0, 0.0)
    now_s[0] += 1.99
    assert not pace.wait(1, 0.0)
    now_s[0] += 0.02
    assert pace.wait(1, 0.0) and pace.timeouts == 1
    for outrun in (lambda: pace.acknowledge(footage_stamp_ns(EPOCH_NS, 0, 50.0)), lambda: None):
        now_s[0] += 1.5
        outrun()
        assert not pace.wait(2, 0.0) and pace.timeouts == 1
    now_s[0] += 0.5
    assert pace.wait(2, 0.0) and pace.timeouts == 2


def test_acknowledgements_of_an_earlier_playing_do_not_count():
    pace, _ = acknowledged(window=2)
    pace.acknowledge(EPOCH_NS + 10**15)
    pace.begin(EPOCH_NS, 0)
    assert [pace.wait(k, 0.0) for k in range(3)] == [True, True, False]


FIRST, SECOND, THIRD = (FootageClock(EPOCH_NS + k * MS, EPOCH_NS + k * MS) for k in range(3))


@pytest.mark.parametrize("order", list(itertools.permutations([FIRST, SECOND, THIRD])))
def test_cameras_come_to_the_clock_that_begins_first_whatever_they_hear_first(order):
    announced = []
    shared = SharedClock(announced.append)
    held = [shared.offer(clock) for clock in order]
    assert held[-1] == FIRST and announced[-1] == FIRST
    assert announced == sorted(set(announced), reverse=True)  # what no longer holds is announced no more
