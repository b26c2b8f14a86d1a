"""Nodes that look like a graph's from outside, well or ill as asked, for the doctor's tests. Runs as a program too:

doctor_fake_nodes.py SECONDS CAMERA[,blank][,lead=S] ... [--ros-args]
"""

import contextlib
import sys
import threading
import time
from dataclasses import dataclass

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage

from sagoma_ros.images import camera_info_message, silhouette_message
from sagoma_ros.messages import to_stamp
from sagoma_ros.qos import RESULT, SILHOUETTE_PUBLISHER
from virtual_studio.rig import ring

RIG = ring(3, False)
FRAME_S, REPORT_S = 0.05, 0.25


@dataclass(frozen=True)
class Camera:
    """How a camera's client misbehaves; ``lead_s``: its clock is ahead."""

    name: str
    blank: bool = False
    lead_s: float = 0.0


class FakeNode(Node):
    """Answers ~/get_state and reports on /diagnostics."""

    def __init__(self, name, namespace, context, lead_s=0.0):
        super().__init__(name, namespace=namespace, context=context, use_global_arguments=False)
        self.lead_ns = round(lead_s * 1e9)
        self.create_service(GetState, "~/get_state", self.on_get_state)
        self.reports = self.create_publisher(DiagnosticArray, "/diagnostics", RESULT)
        self.create_timer(REPORT_S, self.report)

    def on_get_state(self, request, response):
        response.current_state = State(id=State.PRIMARY_STATE_ACTIVE, label="active")
        return response

    def report(self):
        values = [KeyValue(key="rate_hz", value=f"{1 / FRAME_S}")]
        status = DiagnosticStatus(name=self.get_fully_qualified_name(), message="running", values=values)
        message = DiagnosticArray(status=[status])
        message.header.stamp = to_stamp(time.time_ns() + self.lead_ns)
        self.reports.publish(message)


class FakeCamera(FakeNode):
    """Silhouettes of somebody who moves, and their camera_info."""

    def __init__(self, camera, context):
        super().__init__("camera_client", f"/{camera.name}", context, camera.lead_s)
        self.camera, self.frame = camera, 0
        self.canvas = RIG.camera(camera.name).undistorted_view().camera
        self.infos = self.create_publisher(CameraInfo, "camera_info", SILHOUETTE_PUBLISHER)
        self.masks = self.create_publisher(CompressedImage, "silhouette/compressed", SILHOUETTE_PUBLISHER)
        self.create_timer(FRAME_S, self.publish)

    def publish(self):
        self.frame += 1
        mask = np.zeros((self.canvas.height, self.canvas.width), np.uint8)
        if not self.camera.blank:
            left = 200 + self.frame % 50
            mask[100:400, left : left + 80] = 255
        stamp_ns = time.time_ns() + self.lead_ns
        self.infos.publish(camera_info_message(self.canvas, stamp_ns, "optical"))
        self.masks.publish(silhouette_message(mask, stamp_ns, "optical"))


class FakeGraph:
    """Cameras and server nodes, spun by a thread; a context manager."""

    def __init__(self, cameras, server=(), domain_id=None):
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.nodes = [FakeNode(name, "/", self.context) for name in server]
        self.nodes += [FakeCamera(camera, self.context) for camera in cameras]
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in self.nodes:
            self.executor.add_node(node)
        self.thread = threading.Thread(target=self.spin, daemon=True)
        self.thread.start()

    def spin(self):
        with contextlib.suppress(ExternalShutdownException):
            self.executor.spin()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.executor.shutdown(timeout_sec=5.0)
        self.thread.join(5.0)
        for node in self.nodes:
            node.destroy_node()
        self.context.try_shutdown()


def parse(text):
    name, *words = text.split(",")
    lead_s = next((float(word.partition("=")[2]) for word in words if word.startswith("lead=")), 0.0)
    return Camera(name, "blank" in words, lead_s)


if __name__ == "__main__":
    with FakeGraph([parse(text) for text in sys.argv[2:] if text != "--ros-args"]):
        print("ready", flush=True)
        threading.Event().wait(float(sys.argv[1]))
