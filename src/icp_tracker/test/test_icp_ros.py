"""What the node has besides the tracker: the service that saves the body, and the filter's awaited answer."""

import os
import threading
from dataclasses import replace

import numpy as np
import pytest
import rclpy
from node_probe import Spinner
from std_srvs.srv import Trigger

from icp_tracker.icp_ros import FilterFeedback, SaveBodyService, SaveBodySettings
from stick_figure.body import BUILD_NUMBERS, Body, load_body

NAMESPACE = f"/test_body_desk_{os.getpid()}"


class SavingProbe(Spinner):
    """A node with the service, and its client."""

    def __init__(self, context, folder):
        super().__init__(context)
        self.node = self.add(rclpy.create_node("tracker", context=context, namespace=NAMESPACE))
        self.service = SaveBodyService(self.node, SaveBodySettings(str(folder)))
        self.client = self.node.create_client(Trigger, "~/save_body")

    def ask(self):
        self.until(self.client.service_is_ready)
        response = self.client.call_async(Trigger.Request())
        self.until(response.done)
        return response.result()

    def close(self):
        self.service.close()
        super().close()


@pytest.fixture
def counter(open_probe, tmp_path):
    return lambda folder=tmp_path / "bodies": open_probe(SavingProbe, folder)


def test_each_person_has_a_file_with_its_build_and_nobody_is_kept_who_was_forgotten(counter, tmp_path):
    asked, folder, build = counter(), tmp_path / "bodies", np.linspace(-1.0, 1.0, BUILD_NUMBERS)
    built, other = replace(Body.from_stature(1.68), build=build), Body.from_stature(1.82)
    asked.service.keep(1, 123, built)
    assert asked.ask().message == f"{folder}/body_123.yaml"
    assert load_body(folder / "body_123.yaml").lengths == pytest.approx(built.lengths)
    assert np.array_equal(load_body(folder / "body_123.yaml").build, build)
    asked.service.keep(3, 456, other)
    answer = asked.ask()
    assert answer.success and answer.message == f"{folder}/body_123.yaml, {folder}/body_456_person3.yaml"
    assert load_body(folder / "body_456_person3.yaml").stature == pytest.approx(other.stature)
    asked.service.forget()
    answer = asked.ask()
    assert not answer.success and "no body is followed yet" in answer.message


def test_folder_that_cannot_be_written_is_named(counter, tmp_path):
    (tmp_path / "file").write_text("")
    asked = counter(tmp_path / "file" / "bodies")
    asked.service.keep(1, 1, Body.from_stature(1.68))
    answer = asked.ask()
    assert not answer.success and str(tmp_path / "file" / "bodies") in answer.message


# --- the filter's state after the previous set ------------------------------------------------------------------------

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


def test_silent_filter_is_waited_for_once_until_it_answers():
    feedback = FilterFeedback(0.01)
    feedback.sent(10)
    assert feedback.after_previous_set() == {}
    feedback._wait_s = NEVER_S  # a second wait would last
    assert feedback.after_previous_set() == {} and feedback.timeouts == 1
    feedback.update(Answer(10))
    assert feedback.after_previous_set() == {1: 10}


def test_closing_releases_the_waiter_and_counts_nothing():
    feedback = FilterFeedback(NEVER_S)
    feedback.sent(7)
    thread, found = waiting(feedback)
    feedback.close()
    thread.join(20.0)
    assert found == [{}] and feedback.timeouts == 0
