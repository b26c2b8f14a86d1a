"""Plays a clip of silhouettes to a running server at a fixed rate and takes its answers: the cameras of bench/live.py.

    python bench/live_player.py CLIP PID...

A process of its own, so that its processor time is not the server's. CLIP is a pickle: the rig's file, and the frames
of a `scenes.Clip`. Every line on standard input is a turn to play, as JSON
{"hz", "seconds"}; every line on standard output its `Turn`. Messages are serialised beforehand as a camera client sends
them, camera_info with every silhouette, and get a fresh stamp when they are sent: all cameras' the same.
"""

from __future__ import annotations

import json
import pickle
import struct
import sys
import threading
import time
import zlib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage

from capture_rig import InputError, load_rig
from sagoma_ros.images import camera_info_message, silhouette_message
from sagoma_ros.qos import LATCHED, SILHOUETTE_PUBLISHER
from sagoma_tools.graph.diagnostics_table import DiagnosticsTable
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import CAMERA_INFO_SUFFIX, LOSSLESS, SILHOUETTE_SUFFIX, message_class
from sagoma_tools.recording.reader import header_stamp_ns

JOINT_STATES, HULL_SERVER = "/mocap/joint_states", "/hull_server"
ANSWERS = "/ekf/prediction"  # one to each frame set, of either server
START_HZ = 15.0  # slow enough for any machine: the person is found before the load begins
FOUND_SETS = 10  # joint states of the held first frame, from which on the person moves
SETTLE_S = 2.0  # at the full rate before counting begins
FIND_TIMEOUT_S, ANSWER_TIMEOUT_S, REPORT_TIMEOUT_S = 300.0, 3.0, 5.0  # found: a server may have to compile its kernels
STAMP = struct.Struct("<iI")  # behind the four bytes that lead in a serialised message (CDR, little-endian)
STAMP_OFFSET, NS_PER_S = 4, 1_000_000_000


@dataclass(frozen=True)
class Turn:
    """A server's figures of one turn: sets ``sent`` over ``span_s``, ``answered`` by the filter, ``tracked`` of those.

    cpu_s : processor time of all server processes. ages_ms : capture stamp to joint state. incomplete : sets that the
    hull server closed without a camera.
    """

    sent: int
    span_s: float
    answered: int
    tracked: int
    incomplete: int
    cpu_s: float
    ages_ms: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Phase:
    """One rate of :meth:`Player.phases`: what was sent of it, as the rule says; times since its beginning.

    answered_s : when the sets were exposed that were answered. ages : of those with a joint state, that instant and
    the age in ms. incomplete : sets that the hull server closed without a camera.
    """

    hz: float
    seconds: float
    sent: int
    answered_s: list[float]
    incomplete: int
    ages: list[list[float]]


def followed_rule(link: RosLink) -> Any:
    """The rule by which cameras thin out, kept up to date; older trees have none, and get no phases."""
    try:
        from mocap_packets.thinning import FrameSelector
        from sagoma_ros.messages import THINNING_TOPIC as TOPIC
        from sagoma_ros.messages import read_thinning
    except ImportError:
        return None
    selector = FrameSelector()
    link.node.create_subscription(
        DiagnosticArray, TOPIC, lambda rule: selector.update(read_thinning(rule, TOPIC), time.monotonic_ns()), LATCHED
    )
    return selector


def published_type(link: RosLink, topic: str) -> str:
    """Return the type of a topic that a server of any age publishes, as soon as it is there."""
    deadline_s = time.monotonic() + FIND_TIMEOUT_S
    while time.monotonic() < deadline_s:
        found = dict(link.node.get_topic_names_and_types()).get(topic)
        if found:
            return found[0]
        threading.Event().wait(0.05)
    raise InputError("nobody publishes", where=topic, remedy="Start the server first.")


class Arrivals:
    """The stamps of a topic's messages, and when each came, ns since the epoch."""

    def __init__(self, link: RosLink, topic: str) -> None:
        self._changed, self._came_ns = threading.Condition(), dict[int, int]()
        kind = message_class(published_type(link, topic))
        self._subscription = link.node.create_subscription(kind, topic, self._take, LOSSLESS, raw=True)

    def wait_for(self, stamp_ns: int, timeout_s: float) -> bool:
        """True as soon as the message of this stamp or of a later one has come."""
        with self._changed:
            return self._changed.wait_for(lambda: max(self._came_ns, default=-1) >= stamp_ns, timeout_s)

    def since(self, stamp_ns: int) -> dict[int, int]:
        """Stamp -> arrival of the messages from this stamp on."""
        with self._changed:
            return {stamp: came for stamp, came in self._came_ns.items() if stamp >= stamp_ns}

    def _take(self, data: bytes) -> None:
        came_ns = time.time_ns()
        with self._changed:
            self._came_ns[header_stamp_ns(data)] = came_ns
            self._changed.notify_all()


class Player:
    """Publishes the clip's frames, forwards and backwards in turn, and takes the server's answers."""

    def __init__(self, link: RosLink, clip: Path, pids: list[int]) -> None:
        self._servers = [psutil.Process(pid) for pid in pids]
        self._answers, self._joints = Arrivals(link, ANSWERS), Arrivals(link, JOINT_STATES)
        self._diagnostics = DiagnosticsTable(link.node)
        rig_file, frames = pickle.loads(clip.read_bytes())
        self._channels = []  # of each camera: its two publishers, camera_info, a silhouette a frame
        for camera in load_rig(rig_file).cameras:
            canvas = camera.undistorted_view().camera
            info = serialize_message(camera_info_message(canvas, 0, f"{camera.name}_optical"))
            masks = [_serialised(*frame[camera.name], f"{camera.name}_optical") for frame in frames]
            infos = link.node.create_publisher(CameraInfo, f"/{camera.name}{CAMERA_INFO_SUFFIX}", SILHOUETTE_PUBLISHER)
            images = link.node.create_publisher(
                CompressedImage, f"/{camera.name}{SILHOUETTE_SUFFIX}", SILHOUETTE_PUBLISHER
            )
            self._channels.append((infos, images, bytearray(info), masks))
        self._selector = followed_rule(link)
        self._frames, self._still = len(frames), threading.Event()

    def play(self, hz: float, seconds: float) -> Turn:
        """Find the person in the first frame, play SETTLE_S, then count for so long."""
        self._find()
        settling = round(SETTLE_S * hz)
        self._send(hz, 0, settling)
        incomplete, cpu_s = self._incomplete(time.monotonic()), self._cpu_s()
        began_ns, sent = time.time_ns(), round(seconds * hz)
        last_ns = self._send(hz, settling, sent)
        span_s = (time.time_ns() - began_ns) / NS_PER_S
        self._answers.wait_for(last_ns, ANSWER_TIMEOUT_S)
        cpu_s = self._cpu_s() - cpu_s
        ages = [(came - stamp) / 1e6 for stamp, came in self._joints.since(began_ns).items()]
        answered = len(self._answers.since(began_ns))
        incomplete = self._incomplete(time.monotonic()) - incomplete
        return Turn(sent, span_s, answered, len(ages), incomplete, cpu_s, ages)

    def phases(self, phases: list[tuple[float, float]]) -> list[Phase]:
        """Find the person, then play at each rate (Hz) for its seconds, as cameras do that follow the server's rule."""
        self._find()
        played = []
        for hz, seconds in phases:
            asked_s, sent = time.monotonic(), list[int]()
            incomplete = self._incomplete(asked_s)
            began_ns = time.time_ns()
            self._send(hz, 0, round(hz * seconds), sent=sent)
            played.append((hz, seconds, began_ns, sent, incomplete))
        self._answers.wait_for(sent[-1], ANSWER_TIMEOUT_S)
        last = self._incomplete(time.monotonic())
        answers, joints = self._answers.since(played[0][2]), self._joints.since(played[0][2])
        result = []
        for k, (hz, seconds, began_ns, sent, incomplete) in enumerate(played):
            after = played[k + 1][4] if k + 1 < len(played) else last
            ages = [[(stamp - began_ns) / NS_PER_S, (joints[stamp] - stamp) / 1e6] for stamp in sent if stamp in joints]
            answered = [(stamp - began_ns) / NS_PER_S for stamp in sent if stamp in answers]
            result.append(Phase(hz, seconds, len(sent), answered, after - incomplete, ages))
        return result

    def _find(self) -> None:
        began_ns, deadline_s = time.time_ns(), time.monotonic() + FIND_TIMEOUT_S
        while len(self._joints.since(began_ns)) < FOUND_SETS:
            self._send(START_HZ, 0, 1, hold=True)
            if not all(server.is_running() and server.status() != psutil.STATUS_ZOMBIE for server in self._servers):
                raise RuntimeError("a process of the server has ended")
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"the server found nobody within {FIND_TIMEOUT_S:g} s")

    def _send(self, hz: float, first: int, count: int, hold: bool = False, sent: list[int] | None = None) -> int:
        """Send so many frames, one a period; returns the last stamp.

        sent : gets the stamps of those that are sent: all, or those that the hull server's rule keeps.
        """
        due_s, stamp_ns = time.monotonic(), 0
        for frame in range(first, first + count):
            self._still.wait(max(0.0, due_s - time.monotonic()))
            due_s += 1.0 / hz
            stamp_ns = time.time_ns()
            if sent is not None:
                if not self._selector.keeps(stamp_ns, time.monotonic_ns()):
                    continue
                sent.append(stamp_ns)
            stamp = STAMP.pack(*divmod(stamp_ns, NS_PER_S))
            place = 0 if hold else self._place(frame)
            for infos, images, info, masks in self._channels:
                for publisher, message in ((infos, info), (images, masks[place])):
                    message[STAMP_OFFSET : STAMP_OFFSET + STAMP.size] = stamp
                    publisher.publish(bytes(message))
        self._still.wait(max(0.0, due_s - time.monotonic()))
        return stamp_ns

    def _place(self, frame: int) -> int:
        """Frames count on backwards from the clip's end, and forwards again from its start."""
        last = self._frames - 1
        frame %= max(2 * last, 1)
        return min(frame, 2 * last - frame)

    def _incomplete(self, asked_s: float) -> int:
        """The hull server's count of incomplete sets, as of a report made after this time."""

        def reported() -> bool:
            report = self._diagnostics.report(HULL_SERVER)
            return report is not None and report.heard_s > asked_s

        self._diagnostics.wait_until(reported, REPORT_TIMEOUT_S)
        report = self._diagnostics.report(HULL_SERVER)
        return int(report.values.get("sets_incomplete", 0)) if report is not None else 0

    def _cpu_s(self) -> float:
        times = [server.cpu_times() for server in self._servers]
        return sum(each.user + each.system for each in times)


def _serialised(packed: bytes, shape: tuple[int, int], frame_id: str) -> bytearray:
    mask = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(shape)
    return bytearray(serialize_message(silhouette_message(mask, 0, frame_id)))


def main() -> None:
    """Play turns until standard input ends."""
    with RosLink("bench_player") as link:
        player = Player(link, Path(sys.argv[1]), [int(pid) for pid in sys.argv[2:]])
        for line in sys.stdin:
            asked = json.loads(line)
            if "phases" in asked:
                print(json.dumps([asdict(phase) for phase in player.phases(asked["phases"])]), flush=True)
            else:
                print(json.dumps(asdict(player.play(**asked))), flush=True)


if __name__ == "__main__":
    main()
