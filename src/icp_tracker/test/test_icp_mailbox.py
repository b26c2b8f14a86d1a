"""Waiting for messages of a stamp, for a bounded time and only once in vain."""

import threading

from icp_tracker.icp_ros import FilterFeedback
from sagoma_ros.worker import Mailbox

NEVER_S = 3600.0


class Answer:
    def __init__(self, stamp_ns):
        self.stamp_ns, self.of = stamp_ns, {1: stamp_ns}


def test_item_that_is_there_is_taken_without_waiting():
    mailbox = Mailbox(keep=2, wait_s=NEVER_S)
    mailbox.put(7, "seven")
    assert mailbox.take(7) == "seven"
    assert mailbox.timeouts == 0


def test_wait_ends_with_the_item():
    mailbox = Mailbox(keep=2, wait_s=NEVER_S)
    taken = []
    waiter = threading.Thread(target=lambda: taken.append(mailbox.take(7)))
    waiter.start()
    mailbox.put(6, "six")
    mailbox.put(7, "seven")
    waiter.join(20.0)
    assert taken == ["seven"]


def test_silent_sender_is_waited_for_once_until_it_speaks():
    mailbox = Mailbox(keep=4, wait_s=0.01)
    assert mailbox.take(1) is None
    mailbox._wait_s = NEVER_S  # a second wait would last
    assert mailbox.take(2) is None
    assert mailbox.timeouts == 1
    mailbox.put(3, "three")
    assert mailbox.take(3) == "three"


def test_oldest_items_are_forgotten():
    mailbox = Mailbox(keep=2, wait_s=0.0)
    for stamp in (1, 2, 3):
        mailbox.put(stamp, stamp)
    assert [mailbox.take(stamp) for stamp in (1, 2, 3)] == [None, 2, 3]
    assert mailbox.newest() == 3


def test_closing_releases_the_waiter_and_counts_nothing():
    mailbox = Mailbox(keep=2, wait_s=NEVER_S)
    taken = []
    waiter = threading.Thread(target=lambda: taken.append(mailbox.take(7)))
    waiter.start()
    mailbox.close()
    waiter.join(20.0)
    assert taken == [None] and mailbox.timeouts == 0


def test_feedback_hands_out_the_state_after_the_previous_set_or_the_newest():
    feedback = FilterFeedback(wait_s=0.0)
    assert feedback.after_previous_set() == {}  # nothing was asked yet
    feedback.asked(10)
    assert feedback.after_previous_set() == {}
    feedback.put(Answer(10))
    feedback.asked(20)
    assert feedback.after_previous_set() == {1: 10}
    feedback.put(Answer(20))
    assert feedback.after_previous_set() == {1: 20}


def test_feedback_hands_out_nothing_of_before_stamps_went_back():
    feedback = FilterFeedback(wait_s=0.0)
    feedback.asked(1000)
    feedback.put(Answer(1000))
    feedback.forget()
    assert feedback.after_previous_set() == {}
    feedback.asked(10)  # the answer to this set comes too late
    assert feedback.after_previous_set() == {}
    feedback.put(Answer(10))
    assert feedback.after_previous_set() == {1: 10}
