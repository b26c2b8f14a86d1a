"""The filter's state after the previous set: waited for, for a bounded time, and only once in vain."""

import threading

import pytest

from icp_tracker.icp_ros import FilterFeedback

NEVER_S = 3600.0


class Answer:
    def __init__(self, stamp_ns):
        self.stamp_ns, self.of = stamp_ns, {1: stamp_ns}


def waiting(feedback):
    """A thread that asks, and the list that its result goes to."""
    found = []
    thread = threading.Thread(target=lambda: found.append(feedback.after_previous_set()))
    thread.start()
    return thread, found


def test_wait_ends_with_the_answer_to_the_set_that_was_sent():
    feedback = FilterFeedback(NEVER_S)
    assert feedback.after_previous_set() == {}  # nothing was sent yet
    feedback.sent(20)
    thread, found = waiting(feedback)
    feedback.update(Answer(10))
    feedback.update(Answer(30))  # nobody was asked for it
    feedback.update(Answer(20))
    thread.join(20.0)
    assert found == [{1: 20}] == [feedback.after_previous_set()] and feedback.timeouts == 0


def test_silent_filter_is_waited_for_once_until_it_answers():
    feedback = FilterFeedback(0.01)
    feedback.sent(10)
    assert feedback.after_previous_set() == {}
    feedback._wait_s = NEVER_S  # a second wait would last
    assert feedback.after_previous_set() == {} and feedback.timeouts == 1
    feedback.update(Answer(10))
    assert feedback.after_previous_set() == {1: 10}


def test_the_newest_state_serves_where_that_of_the_previous_set_does_not_come():
    feedback = FilterFeedback(0.0)
    feedback.sent(10)
    feedback.update(Answer(10))
    feedback.sent(20)
    assert feedback.after_previous_set() == {1: 10}


@pytest.mark.parametrize("answered", [False, True])
def test_nothing_of_before_stamps_went_back_is_handed_out(answered):
    feedback = FilterFeedback(0.0)
    feedback.sent(1000)
    feedback.update(Answer(1000))
    feedback.forget()
    assert feedback.after_previous_set() == {}
    feedback.sent(10)
    if answered:
        feedback.update(Answer(10))
    assert feedback.after_previous_set() == ({1: 10} if answered else {})


def test_closing_releases_the_waiter_and_counts_nothing():
    feedback = FilterFeedback(NEVER_S)
    feedback.sent(7)
    thread, found = waiting(feedback)
    feedback.close()
    thread.join(20.0)
    assert found == [{}] and feedback.timeouts == 0
