"""The witness on the server of bench/hosts.py: prints every frame set of the hull server, and which cameras are known.

    python tests/support/hosts_listener.py CAMERA ...

Lines of JSON on standard output, each with ``at_s``, the machine's monotonic clock: {"stamp_ns", "missing",
"spread_ms", "received_ms"} for a frame set (received: from the earliest stamp until the set was closed), {"known":
[CAMERA ...]} when cameras' publishers were found or lost, {"says"} when the hull server's message changed; of a whole
graph also {"stamp_ns", "age_ms"} for every answer of the filter, {"stamp_ns", "points"} (15 x 3, m) of a tracked body.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2

from sagoma_ros.messages import to_ns
from sagoma_ros.packets import read_reference_points
from sagoma_ros.qos import RESULT
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import DIAGNOSTICS_TOPIC, LATENCY_TOPIC, LOSSLESS, camera_topics

LOOK_S = 0.05
POINTS_TOPIC = "/mocap/reference_points"
said: list[str] = []  # by the hull server


def send(**what: Any) -> None:
    """Print one line."""
    print(json.dumps({"at_s": time.monotonic(), **what}), flush=True)


def on_frame_set(message: DiagnosticArray) -> None:
    values = {pair.key: pair.value for pair in message.status[0].values}
    times = {key: float(values[key]) for key in ("spread_ms", "received_ms")}
    send(stamp_ns=to_ns(message.header.stamp), missing=[name for name in values["missing"].split(",") if name], **times)


def on_answer(message: DiagnosticArray) -> None:
    """Print the filter's answer to an exposure."""
    stamp_ns = to_ns(message.header.stamp)
    send(stamp_ns=stamp_ns, age_ms=1e-6 * (time.time_ns() - stamp_ns))


def on_points(message: PointCloud2) -> None:
    points_world = read_reference_points(message, POINTS_TOPIC).points_world
    send(stamp_ns=to_ns(message.header.stamp), points=points_world.round(4).tolist())


def on_diagnostics(message: DiagnosticArray) -> None:
    """Print the hull server's message when it has changed."""
    for status in message.status:
        if status.name == "/hull_server" and said[-1:] != [status.message]:
            said.append(status.message)
            send(says=status.message)


def main() -> None:
    """Listen until killed."""
    topics = {camera: camera_topics(camera)[1].name for camera in sys.argv[1:]}
    known: list[str] = []
    with RosLink("hosts_listener") as link:
        link.node.create_subscription(DiagnosticArray, "/hull/frame_set", on_frame_set, LOSSLESS)
        link.node.create_subscription(DiagnosticArray, LATENCY_TOPIC, on_answer, LOSSLESS)
        link.node.create_subscription(PointCloud2, POINTS_TOPIC, on_points, LOSSLESS)
        link.node.create_subscription(DiagnosticArray, DIAGNOSTICS_TOPIC, on_diagnostics, RESULT)
        while not threading.Event().wait(LOOK_S):
            found = [camera for camera, topic in topics.items() if link.node.count_publishers(topic)]
            if found != known:
                known = found
                send(known=found)


if __name__ == "__main__":
    main()
