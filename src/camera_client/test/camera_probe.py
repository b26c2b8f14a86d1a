"""A camera node among messages, for tests: what it publishes is heard, what it asks is answered."""

import os

from diagnostic_msgs.msg import DiagnosticArray
from node_probe import NodeProbe
from sensor_msgs.msg import CameraInfo, CompressedImage
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from camera_client.camera_node import CameraNode
from mocap_packets.people import AnsweredSet
from sagoma_ros.messages import LATENCY_TOPIC, latency_message, to_ns
from sagoma_ros.qos import RESULT, SILHOUETTE_RELIABLE_SUBSCRIBER

DEADLINE_S = 60.0  # only ever reached by a failing test
EPOCH_NS = 1_000_000_000_000_000_000
FRAMES = 30
NAMESPACE = f"/test_{os.getpid()}"  # a second run of these tests on this machine is not heard


class CameraProbe(NodeProbe):
    """A CameraNode in a namespace of its own; its peer plays hull server and EKF."""

    def __init__(self, context, parameters):
        super().__init__(context, CameraNode, parameters, NAMESPACE)
        self.acknowledging = True
        self.answers = self.peer.create_publisher(DiagnosticArray, f"/{LATENCY_TOPIC}", RESULT)
        self.listen(CompressedImage, "silhouette/compressed", SILHOUETTE_RELIABLE_SUBSCRIBER)
        self.listen(CameraInfo, "camera_info", SILHOUETTE_RELIABLE_SUBSCRIBER)
        self.peer.create_subscription(
            CompressedImage, "silhouette/compressed", self._acknowledge, SILHOUETTE_RELIABLE_SUBSCRIBER
        )

    def _acknowledge(self, message):
        if self.acknowledging:
            self.acknowledge(to_ns(message.header.stamp))

    def acknowledge(self, stamp_ns):
        self.answers.publish(latency_message(AnsweredSet(stamp_ns)))

    @property
    def masks(self):
        return self.heard["silhouette/compressed"]

    def stamps_ns(self, topic="silhouette/compressed"):
        return [to_ns(message.header.stamp) for message in self.heard[topic]]

    def ask_to_learn(self, meanwhile=lambda: None):
        response = self.call(Trigger, "camera_client/learn_background")
        self.until(lambda: self.node.trainer.busy or response.done())
        meanwhile()
        self.until(response.done)
        return response.result()


def set_camera_info(probe, info):
    return probe.ask(SetCameraInfo, "set_camera_info", SetCameraInfo.Request(camera_info=info))
