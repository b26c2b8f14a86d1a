"""Nodes that look like a graph's from outside, well or ill as asked, for the doctor's tests. Runs as a program too:

doctor_fake_nodes.py SECONDS CAMERA [--ros-args]
"""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from sensor_msgs.msg import CompressedImage

from sagoma_ros.images import silhouette_message
from sagoma_ros.messages import to_stamp
from sagoma_ros.qos import RESULT, SILHOUETTE_PUBLISHER
from sagoma_tools.graph.ros_link import RosLink
from virtual_studio.rig import ring

RIG = ring(3, False)
FRAME_S, REPORT_S = 0.05, 0.25


class FakeNode(RosLink):
    """Answers ~/get_state and reports on /diagnostics; ``lead_s``: its clock is ahead."""

    def __init__(self, name, namespace="", lead_s=0.0, domain_id=None):
        super().__init__(name, namespace=namespace, domain_id=domain_id)
        self.lead_ns = round(lead_s * 1e9)
        self.node.create_service(GetState, "~/get_state", self.on_get_state)
        self.reports = self.node.create_publisher(DiagnosticArray, "/diagnostics", RESULT)
        self.node.create_timer(REPORT_S, self.report)

    def on_get_state(self, request, response):
        response.current_state = State(id=State.PRIMARY_STATE_ACTIVE, label="active")
        return response

    def report(self):
        values = [KeyValue(key="rate_hz", value=f"{1 / FRAME_S}")]
        status = DiagnosticStatus(name=self.node.get_fully_qualified_name(), message="running", values=values)
        message = DiagnosticArray(status=[status])
        message.header.stamp = to_stamp(time.time_ns() + self.lead_ns)
        self.reports.publish(message)


class FakeCamera(FakeNode):
    """Silhouettes of somebody who moves, or of nobody."""

    def __init__(self, camera, blank=False, **options):
        super().__init__("camera_client", f"/{camera}", **options)
        self.blank, self.frame = blank, 0
        self.canvas = RIG.camera(camera).undistorted_view().camera
        self.masks = self.node.create_publisher(CompressedImage, "silhouette/compressed", SILHOUETTE_PUBLISHER)
        self.node.create_timer(FRAME_S, self.publish)

    def publish(self):
        self.frame += 1
        mask = np.zeros((self.canvas.height, self.canvas.width), np.uint8)
        if not self.blank:
            left = 200 + self.frame % 50
            mask[100:400, left : left + 80] = 255
        self.masks.publish(silhouette_message(mask, time.time_ns() + self.lead_ns, "optical"))


@contextmanager
def fake_server(domain_id: int | None = None) -> Iterator[None]:
    with ExitStack() as nodes:
        for name in ("hull_server", "icp_tracker", "ekf_tracker"):
            nodes.enter_context(FakeNode(name, domain_id=domain_id))
        yield


if __name__ == "__main__":
    with FakeCamera(sys.argv[2]):
        print("ready", flush=True)
        threading.Event().wait(float(sys.argv[1]))
