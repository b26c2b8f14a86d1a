"""The service that saves the body being followed."""

import os
import time

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from icp_tracker.acquisition.body_sizes import LimbGirths
from icp_tracker.icp_ros import SaveBodyService, SaveBodySettings, SavedBody
from stick_figure.body import Body
from stick_figure.body_file import load_body, load_thickness

NAMESPACE = f"/test_body_desk_{os.getpid()}"
DEADLINE_S = 20.0  # only ever reached by a failing test


class Counter:
    """A node with a body desk, and who asks it."""

    def __init__(self, context, folder):
        self.node = rclpy.create_node("tracker", context=context, namespace=NAMESPACE)
        self.desk = SaveBodyService(self.node, SaveBodySettings(str(folder)))
        self.client = self.node.create_client(Trigger, "~/save_body")
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)

    def ask(self):
        deadline = time.monotonic() + DEADLINE_S
        while not self.client.service_is_ready():
            assert time.monotonic() < deadline
            self.executor.spin_once(timeout_sec=0.05)
        future = self.client.call_async(Trigger.Request())
        self.executor.spin_until_future_complete(future, DEADLINE_S)
        return future.result()


@pytest.fixture
def counter(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(context=context)
    made = []

    def make(folder=tmp_path / "bodies"):
        made.append(Counter(context, folder))
        return made[-1]

    yield make
    for one in made:
        one.desk.close()
        one.executor.shutdown()
        one.node.destroy_node()
    rclpy.shutdown(context=context)


def test_body_is_saved_with_the_thickness_of_its_limbs(counter, tmp_path):
    asked, body = counter(), Body.from_stature(1.68)
    asked.desk.keep(SavedBody(123, body, LimbGirths.of({"thigh": 1.1})))
    answer = asked.ask()
    path = tmp_path / "bodies" / "body_123.yaml"
    assert answer.success and answer.message == str(path)
    assert load_body(path).lengths == pytest.approx(body.lengths)
    assert load_thickness(path) == {"thigh": 1.1}


def test_before_anybody_is_followed_the_answer_says_so(counter):
    answer = counter().ask()
    assert not answer.success and "no body is followed yet" in answer.message


def test_folder_that_cannot_be_written_is_named(counter, tmp_path):
    (tmp_path / "file").write_text("")
    asked = counter(tmp_path / "file" / "bodies")
    asked.desk.keep(SavedBody(1, Body.from_stature(1.68)))
    answer = asked.ask()
    assert not answer.success and str(tmp_path / "file" / "bodies") in answer.message
