"""What the bridges to other programs deliver: instants a second and their age, read by clients of each protocol.

    python bench/bridges.py --quick                  # one person at 60 Hz for 5 s; without --quick 30 s

Each bridge is a process of its own, as a user starts it. A publisher sends pose and points of a person who moves,
stamped when they are sent, in place of the server; the clients run in this process: a ROS subscriber, a UDP socket with
a reader of OSC of its own, an inlet of Lab Streaming Layer. Age: from the stamp to the client; processor time: of the
bridge, per instant. All over loopback.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import threading
import time

from report import Table, finish, machine_line, parser

import numpy as np
import psutil
import pylsl
from osc import osc_messages
from sensor_msgs.msg import JointState, MultiDOFJointState, PointCloud2

from mocap_packets.fit import FIRST_PERSON, ReferencePoints
from sagoma_ros.joint_motion import motion_message
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import packet_cloud
from sagoma_ros.qos import RESULT
from sagoma_tools.graph.ros_link import RosLink
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import JointMotion, Pose
from stick_figure.skeleton import T_POSE_ANGLES

DOMAIN, PORT = 89, 39541
NODES = ("isb_angles", "vmc_bridge", "lsl_bridge")
SOURCE = "sagoma /mocap"


class Clients:
    """When each client got an instant, and of when that is: ns of this machine's clock; s since the first for OSC."""

    def __init__(self, link: RosLink, receiver: socket.socket) -> None:
        self.heard: dict[str, list[tuple[float, float]]] = {name: [] for name in NODES}
        self._receiver, self._closing, self._inlet = receiver, threading.Event(), None
        link.node.create_subscription(JointState, "mocap/isb_angles", self._hear_angles, RESULT)
        self._threads = [threading.Thread(target=hear) for hear in (self._hear_osc, self._hear_lsl)]

    def __enter__(self) -> Clients:
        (found,) = pylsl.resolve_byprop("source_id", SOURCE, timeout=60.0)
        self._inlet = pylsl.StreamInlet(found)
        self._inlet.open_stream(timeout=60.0)
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        time.sleep(1.0)  # what is under way
        self._closing.set()
        for thread in self._threads:
            thread.join()

    @property
    def all_hear(self) -> bool:
        """Whether every client has got something."""
        return all(self.heard.values())

    def forget(self) -> None:
        """Count from now on."""
        for heard in self.heard.values():
            heard.clear()

    def ages_ms(self, name: str, first_ns: int) -> np.ndarray:
        """Return the ages of what a client got. VMC's time counts from any instant: that of the first one is known."""
        came, of = np.array(self.heard[name]).reshape(-1, 2).T
        return (came - of) * 1e-6 if name != "vmc_bridge" else (came - first_ns) * 1e-6 - (of - of[0]) * 1e3

    def _hear_angles(self, message: JointState) -> None:
        self.heard["isb_angles"].append((time.time_ns(), to_ns(message.header.stamp)))

    def _hear_osc(self) -> None:
        while not self._closing.is_set():
            try:
                said = dict(osc_messages(self._receiver.recv(65535)))
            except TimeoutError:
                continue
            self.heard["vmc_bridge"].append((time.time_ns(), said["/VMC/Ext/T"][0]))

    def _hear_lsl(self) -> None:
        while not self._closing.is_set():
            _, stamp_s = self._inlet.pull_sample(timeout=0.2)
            if stamp_s is not None:
                now_ns = time.time_ns()
                self.heard["lsl_bridge"].append((now_ns, now_ns - 1e9 * (pylsl.local_clock() - stamp_s)))


def start(node: str) -> subprocess.Popen:
    """Start a bridge as a process."""
    module = "isb_node" if node == "isb_angles" else node.replace("bridge", "node")
    port = ["-p", f"port:={PORT}"] if node == "vmc_bridge" else []
    return subprocess.Popen([sys.executable, "-m", f"motion_bridges.{module}", "--ros-args", *port])


class Player:
    """Publishes a person who moves."""

    def __init__(self, link: RosLink) -> None:
        self._rotations = link.node.create_publisher(MultiDOFJointState, "mocap/joint_rotations", RESULT)
        self._points = link.node.create_publisher(PointCloud2, "mocap/reference_points", RESULT)
        self._body, self._covariance = Body.from_stature(1.8), np.tile(1e-4 * np.eye(3), (15, 1, 1))

    def play(self, hz: float, count: int) -> int:
        """Publish so many instants; returns the stamp of the first."""
        begin_s, first_ns = time.monotonic(), 0
        for k in range(count):
            time.sleep(max(0.0, begin_s + k / hz - time.monotonic()))
            pose = Pose.from_angles(np.array([0.0, 0.0, 1.1]), np.eye(3), T_POSE_ANGLES + 0.3 * np.sin(6.0 * k / hz))
            here = ReferencePoints(forward(self._body, pose), self._covariance, np.ones(15, bool))
            motions = {FIRST_PERSON: JointMotion.of(pose, np.zeros(24))}
            stamp_ns = time.time_ns()
            first_ns = first_ns or stamp_ns
            self._rotations.publish(motion_message(motions, stamp_ns, "map"))
            self._points.publish(packet_cloud(here, stamp_ns, "map"))
        return first_ns


def main() -> None:
    """Run all bridges at once, print what their clients got."""
    arguments = parser(__doc__, quick="5 s instead of 30")
    arguments.add_argument("--hz", type=float, default=60.0, help="instants a second (default: 60)")
    given: argparse.Namespace = arguments.parse_args()
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(DOMAIN)}
    pylsl.set_config_content("[multicast]\nResolveScope = machine\n")
    print(machine_line())
    processes = {node: start(node) for node in NODES}
    try:
        with RosLink("player") as link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            receiver.bind(("127.0.0.1", PORT))
            receiver.settimeout(0.2)
            with Clients(link, receiver) as clients:
                player = Player(link)
                while not clients.all_hear:  # whom discovery has brought together
                    player.play(given.hz, round(given.hz))
                time.sleep(1.0)
                clients.forget()
                before = {node: psutil.Process(one.pid).cpu_times() for node, one in processes.items()}
                sent = round(given.hz * (5.0 if given.quick else 30.0))
                first_ns = player.play(given.hz, sent)
            after = {node: psutil.Process(one.pid).cpu_times() for node, one in processes.items()}
    finally:
        for one in processes.values():
            one.send_signal(signal.SIGINT)
        for one in processes.values():
            one.wait()
    table = Table("bridge:<12 | instants sent:>14d | received:>9d | p50 ms:>7.2f | p95 ms:>7.2f | processor ms:>13.2f")
    figures: dict[str, object] = {"sent": sent, "hz": given.hz}
    for node in NODES:
        ages = clients.ages_ms(node, first_ns)
        used = sum(after[node][:2]) - sum(before[node][:2])
        p50, p95 = np.percentile(ages, [50, 95]).tolist()
        table.row(node, sent, len(ages), p50, p95, 1e3 * used / sent)
        figures |= {f"{node}_received": len(ages), f"{node}_p50_ms": round(p50, 2), f"{node}_p95_ms": round(p95, 2)}
        figures[f"{node}_processor_ms"] = round(1e3 * used / sent, 2)
    finish(figures)


if __name__ == "__main__":
    main()
