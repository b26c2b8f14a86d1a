"""A camera node among messages, for tests: what it publishes is heard, what it asks is answered."""

import os
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, CompressedImage, JointState
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from camera_client.camera_node import CameraNode
from sagoma_ros.messages import to_ns, to_stamp
from sagoma_ros.qos import RESULT, SILHOUETTE_RELIABLE_SUBSCRIBER

DEADLINE_S = 20.0  # only ever reached by a failing test
EPOCH_NS = 1_000_000_000_000_000_000
FRAMES = 30
NAMESPACE = f"/test_{os.getpid()}"  # a second run of these tests on this machine is not heard
PACE_TOPIC = f"{NAMESPACE}/prediction"
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class Bench:
    """A CameraNode in a namespace of its own, and a node beside it that plays hull server and EKF."""

    def __init__(self, context, parameters):
        overrides = [Parameter(key, value=value) for key, value in parameters.items()]
        self.node = CameraNode(namespace=NAMESPACE, context=context, parameter_overrides=overrides)
        self.peer = rclpy.create_node("peer", context=context)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.heard = {}
        self.acknowledging = True
        self.predictions = self.peer.create_publisher(JointState, PACE_TOPIC, RESULT)
        self.peer.create_subscription(
            CompressedImage, f"{NAMESPACE}/silhouette/compressed", self._acknowledge, SILHOUETTE_RELIABLE_SUBSCRIBER
        )
        self.listen(CompressedImage, "silhouette/compressed", SILHOUETTE_RELIABLE_SUBSCRIBER)
        self.listen(CameraInfo, "camera_info", SILHOUETTE_RELIABLE_SUBSCRIBER)
        self.diagnostics = []
        self.peer.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, RESULT)
        self.learn = self.peer.create_client(Trigger, f"{NAMESPACE}/camera_client/learn_background")

    def listen(self, kind, topic, qos):
        self.heard[topic] = []
        self.peer.create_subscription(kind, f"{NAMESPACE}/{topic}", self.heard[topic].append, qos)

    def _on_diagnostics(self, message):
        if message.status[0].name == self.node.get_fully_qualified_name():
            self.diagnostics.append(message)

    def _acknowledge(self, message):
        if self.acknowledging:
            self.acknowledge(to_ns(message.header.stamp))

    def acknowledge(self, stamp_ns):
        message = JointState()
        message.header.stamp = to_stamp(stamp_ns)
        self.predictions.publish(message)

    @property
    def masks(self):
        return self.heard["silhouette/compressed"]

    def stamps_ns(self, topic="silhouette/compressed"):
        return [to_ns(message.header.stamp) for message in self.heard[topic]]

    def start(self):
        assert self.node.trigger_configure() == SUCCESS
        assert self.node.trigger_activate() == SUCCESS
        return self

    def until(self, done):
        deadline = time.monotonic() + DEADLINE_S
        while not done():
            assert time.monotonic() < deadline, "the awaited event did not come"
            self.executor.spin_once(timeout_sec=0.05)

    def until_said(self, text):
        self.until(lambda: self.diagnostics and text in self.diagnostics[-1].status[0].message)

    def values(self):
        """Key and value of the newest diagnostics."""
        count = len(self.diagnostics)
        self.until(lambda: len(self.diagnostics) > count + 1)
        return {pair.key: pair.value for pair in self.diagnostics[-1].status[0].values}

    def ask_to_learn(self, meanwhile=lambda: None):
        assert self.learn.wait_for_service(DEADLINE_S)
        answer = self.learn.call_async(Trigger.Request())
        self.until(lambda: self.node._learning.busy or answer.done())
        meanwhile()
        self.until(answer.done)
        return answer.result()

    def close(self):
        self.node.close()
        self.executor.shutdown()
        self.node.destroy_node()
        self.peer.destroy_node()


def set_camera_info(bench_, info):
    client = bench_.peer.create_client(SetCameraInfo, f"{NAMESPACE}/set_camera_info")
    assert client.wait_for_service(DEADLINE_S)
    answer = client.call_async(SetCameraInfo.Request(camera_info=info))
    bench_.until(answer.done)
    return answer.result()
