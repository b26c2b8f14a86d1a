"""The hull server's work in one process, and split over processes by groups of cameras, in a real graph.

    python bench/camera_groups.py [--quick] [--cameras N ...] [--resolvers N]

Alone, the hull node takes all silhouettes. Split, shadow resolvers in processes of their own (as they would run on
other machines) take all silhouettes, resolve the shadows of a group of cameras each, and hand those on to the hull
node. Both get the same sets of bench/scaling.py's studio, one after another as soon as the one before is answered, from
cameras that this process plays. In the table: processor time a set of each process, user and system, middleware
included; how long a set took from sent to answered; and whether centerlines and contour rays are the same, byte for
byte.

The split pays where the busiest process, not the sum, is the limit: from the number of cameras on at which the hull
node alone needs longer than a frame period. The last line is JSON:
cameras : {number: {"alone_ms", "hull_ms", "resolver_ms", "same_bytes"}}, ms of processor time a set.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from report import Table, execute, finish, parser

import numpy as np
import psutil
import yaml
from live_servers import environment
from scaling import FPS, WARM_UP, Studio
from sensor_msgs.msg import CameraInfo, CompressedImage, PointCloud2

from capture_rig import Rig, save_rig
from capture_rig.errors import InputError
from hull_server.silhouette_input_ros import RESOLVED
from sagoma_ros.images import SILHOUETTE_FORMAT, camera_info_message
from sagoma_ros.messages import to_stamp
from sagoma_ros.qos import RESULT, SILHOUETTE_PUBLISHER
from sagoma_tools.graph.processes import Child, stop_children
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.recording.reader import header_stamp_ns

TREE = Path(__file__).resolve().parents[1]
DOMAIN = int(os.environ.get("ROS_DOMAIN_ID", 77))
ANSWERS = ("/hull/contour_rays", "/hull/centerline")
EPOCH_NS = 5_000_000_000
ANSWER_S, START_S, GRACE_S = 30.0, 120.0, 8.0
LOCKSTEP = {"autostart": True, "reliable": True, "deadline_s": 600.0}


class Cameras:
    """Plays all cameras of a rig, a set at a time, and takes the hull's clouds."""

    def __init__(self, link: RosLink, rig: Rig) -> None:
        self.clouds: dict[tuple[str, int], bytes] = {}
        self._link, self._changed, self._names = link, threading.Condition(), rig.names
        create = link.node.create_publisher
        self._images = {
            n: create(CompressedImage, f"/{n}/silhouette/compressed", SILHOUETTE_PUBLISHER) for n in rig.names
        }
        self._infos = {n: create(CameraInfo, f"/{n}/camera_info", SILHOUETTE_PUBLISHER) for n in rig.names}
        self._canvases = {camera.name: camera.undistorted_view().camera for camera in rig.cameras}
        self._heard = [
            link.node.create_subscription(PointCloud2, topic, self._taker(topic), RESULT, raw=True) for topic in ANSWERS
        ]

    def wait_for_nodes(self, resolvers: int) -> None:
        """Wait until all nodes listen to every camera, and the hull node to every resolver."""
        deadline_s, pause = time.monotonic() + START_S, threading.Event()
        handed_on = [f"/{name}/{RESOLVED}/compressed" for name in self._names if resolvers]
        node = self._link.node

        def ready() -> bool:
            images = all(p.get_subscription_count() >= max(resolvers, 1) for p in self._images.values())
            infos = all(p.get_subscription_count() > resolvers for p in self._infos.values())
            between = all(node.count_publishers(topic) and node.count_subscribers(topic) for topic in handed_on)
            return images and infos and between and all(s.get_publisher_count() for s in self._heard)

        while not ready():
            if time.monotonic() > deadline_s:
                raise InputError(f"the nodes did not start within {START_S:g} s", remedy="Look into their logs.")
            pause.wait(0.1)

    def play(self, number: int, masks: dict[str, bytes]) -> float:
        """Send one set and wait for its clouds; returns the seconds that took."""
        stamp_ns = EPOCH_NS + round(number * 1e9 / FPS)
        began = time.monotonic()
        for name in self._names:
            message = CompressedImage(format=SILHOUETTE_FORMAT, data=masks[name])
            message.header.stamp, message.header.frame_id = to_stamp(stamp_ns), f"{name}_optical"
            self._infos[name].publish(camera_info_message(self._canvases[name], stamp_ns, f"{name}_optical"))
            self._images[name].publish(message)
        with self._changed:
            answered = self._changed.wait_for(lambda: all((t, stamp_ns) in self.clouds for t in ANSWERS), ANSWER_S)
        if not answered:
            raise InputError(f"set {number} was not answered within {ANSWER_S:g} s", remedy="Look into the logs.")
        return time.monotonic() - began

    def _taker(self, topic: str) -> Any:
        def take(data: bytes) -> None:
            with self._changed:
                self.clouds[topic, header_stamp_ns(data)] = data
                self._changed.notify_all()

        return take


@contextlib.contextmanager
def nodes(rig: Rig, groups: list[tuple[str, ...]], folder: Path) -> Iterator[list[Child]]:
    """The hull node, and a resolver for each group."""
    save_rig(rig, folder / "rig.yaml")
    given = {**LOCKSTEP, "rig_file": str(folder / "rig.yaml")}
    wanted = {"hull_server": {**given, "backend": "cpu", "resolved": bool(groups)}}
    wanted |= {f"resolver_{k + 1}": {**given, "cameras": list(group)} for k, group in enumerate(groups)}
    children = []
    try:
        for name, parameters in wanted.items():
            file = folder / f"{name}.yaml"
            file.write_text(yaml.safe_dump({f"/{name}": {"ros__parameters": parameters}}))
            module = "hull_server.hull_node" if name == "hull_server" else "hull_server.resolver_node"
            ros = ["--ros-args", "-r", f"__node:={name}", "--params-file", str(file)]
            command = [sys.executable, "-m", module, *ros]
            children.append(Child(name, command, folder / f"{name}.log", environment(TREE, DOMAIN), lambda _: None))
        yield children
    finally:
        stop_children(children, GRACE_S)


def run(rig: Rig, sets: list[dict[str, bytes]], groups: list[tuple[str, ...]]) -> tuple[dict[str, float], float, dict]:
    """Play all sets; return ms of processor time a set by process, the median ms to an answer, and the clouds."""
    with (
        tempfile.TemporaryDirectory() as folder,
        nodes(rig, groups, Path(folder)) as children,
        RosLink("bench_cameras", domain_id=DOMAIN) as link,
    ):
        cameras = Cameras(link, rig)
        cameras.wait_for_nodes(len(groups))
        processes = {child.name: psutil.Process(child.pid) for child in children}
        for number in range(WARM_UP):
            cameras.play(number, sets[number])
        before = {name: _cpu_ms(process) for name, process in processes.items()}
        took = [cameras.play(number, sets[number]) for number in range(WARM_UP, len(sets))]
        counted = len(sets) - WARM_UP
        spent = {name: (_cpu_ms(process) - before[name]) / counted for name, process in processes.items()}
        return spent, 1e3 * float(np.median(took)), cameras.clouds


def _cpu_ms(process: psutil.Process) -> float:
    times = process.cpu_times()
    return 1e3 * (times.user + times.system)


def main() -> None:
    """Print the table and the line of JSON."""
    arguments = parser(__doc__, quick="60 sets instead of 200")
    arguments.add_argument("--cameras", type=int, nargs="+", default=[6, 12], help="sizes of the rig")
    arguments.add_argument("--resolvers", type=int, default=2, help="processes that resolve shadows")
    options = arguments.parse_args()
    studio = Studio(WARM_UP + (60 if options.quick else 200))
    table = Table(
        "cameras:>7d | alone, ms:>10.1f | took:>6.1f | hull node, ms:>13.1f | each resolver, ms:>18 | took :>6.1f"
        " | same bytes:>11",
        "processor ms a set, and ms from sent to answered",
    )
    found = {}
    for count in options.cameras:
        rig, sets = studio.sets(count, 1)
        groups = [tuple(rig.names[k :: options.resolvers]) for k in range(options.resolvers)]
        alone, alone_took, clouds = run(rig, sets, [])
        split, split_took, same = run(rig, sets, groups)
        resolvers = [ms for name, ms in split.items() if name != "hull_server"]
        equal = clouds == same
        text = " ".join(f"{ms:.1f}" for ms in resolvers)
        table.row(
            count, alone["hull_server"], alone_took, split["hull_server"], text, split_took, "yes" if equal else "no"
        )
        found[count] = {
            "alone_ms": round(alone["hull_server"], 2),
            "hull_ms": round(split["hull_server"], 2),
            "resolver_ms": [round(ms, 2) for ms in resolvers],
            "same_bytes": equal,
        }
    finish({"cameras": found})


if __name__ == "__main__":
    execute(main)
