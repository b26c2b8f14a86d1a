"""The example of docs/examples, run as the process a user would start."""

import select
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import rclpy
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.task import Future
from sensor_msgs.msg import JointState

from sagoma_ros.qos import RESULT
from stick_figure.skeleton import ANGLE_NAMES

EXAMPLE = Path(__file__).resolve().parent.parent / "docs" / "examples" / "subscribe_joint_states.py"
PATIENCE_S = 30.0


@pytest.fixture
def node():
    rclpy.init()
    node = rclpy.create_node("joint_source")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def example():
    process = subprocess.Popen(
        [sys.executable, str(EXAMPLE)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    watchdog = threading.Timer(2 * PATIENCE_S, process.kill)  # a hung example ends the reads below
    watchdog.start()
    yield process
    watchdog.cancel()
    process.kill()
    process.communicate()


def joint_states(angle, rate):
    message = JointState(name=list(ANGLE_NAMES), position=[0.0] * 18, velocity=[0.0] * 18)
    message.position[8], message.velocity[8] = angle, rate
    return message


def publisher_matched_by_the_example(node):
    """A publisher with the tracker's QoS on mocap/joint_states, once somebody listens."""
    matched = Future()
    events = PublisherEventCallbacks(matched=lambda status: matched.set_result(status.current_count))
    publisher = node.create_publisher(JointState, "/mocap/joint_states", RESULT, event_callbacks=events)
    rclpy.spin_until_future_complete(node, matched, timeout_sec=PATIENCE_S)
    assert matched.done(), "the example did not subscribe to /mocap/joint_states"
    return publisher


def test_example_prints_the_joint_it_hears_and_ends_at_ctrl_c(node, example):
    publisher = publisher_matched_by_the_example(node)
    first = "left_elbow -0.750 rad, 1.25 rad/s\n"
    while not select.select([example.stdout], [], [], 0.2)[0]:  # its half of the match may come a little later
        publisher.publish(joint_states(-0.75, 1.25))
    assert example.stdout.readline() == first
    publisher.publish(joint_states(-0.5, 0.0))
    assert next(line for line in example.stdout if line != first) == "left_elbow -0.500 rad, 0.00 rad/s\n"
    example.send_signal(signal.SIGINT)
    assert example.wait(PATIENCE_S) == 0
    assert (example.stdout.read(), example.stderr.read()) == ("bye\n", "")
