"""Detects boards in the live pictures of a rig's cameras: their image_raw topics, best effort.

The board on the floor is detected in a few pictures of each camera, the carried board in synchronised frame sets.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import Image

from capture_rig.errors import InputError
from mocap_packets.frame_set import FrameSet, FrameSetCollector
from rig_calibration.boards.board import Board, TargetDetection
from rig_calibration.boards.detector import find_board
from rig_calibration.extrinsics.board_frames import motion_advice
from rig_calibration.extrinsics.calibrate import MOVING
from sagoma_ros.images import decode_image
from sagoma_ros.inputs import Worker
from sagoma_ros.messages import to_ns
from sagoma_ros.qos import SILHOUETTE_SUBSCRIBER

from ..console import doing, until_stopped
from ..graph import PATIENCE_S, ROUND_S
from ..graph.ros_link import settled
from .rig_detections import CameraDetections, Cameras, CamerasDetections, Corners, detections_of, find_floor

TOLERANCE_NS = 10_000_000
"""Exposures further apart are not one frame set: a board carried at 0.5 m/s moves 5 mm meanwhile."""
DEADLINE_NS = 2_000_000_000
TOPIC = "image_raw"
IMAGE_TYPE = "sensor_msgs/msg/Image"
FLOOR_SHOTS = 5

Ask = Callable[[str], None]
"""Prompts the person and waits until it is done."""


class MotionRecorder:
    """Sorts the cameras' images into frame sets by stamp and detects the board in one set after the other.

    Sets that arrive during a detection are dropped, never queued. A context manager: closing ends the subscriptions.
    """

    def __init__(self, node: Node, topics: Mapping[str, str], board: Board) -> None:
        self._node, self._topics, self._board = node, dict(topics), board
        self._collector: FrameSetCollector[Image] = FrameSetCollector(
            topics, tolerance_ns=TOLERANCE_NS, deadline_ns=DEADLINE_NS
        )
        self._found = {name: CameraDetections(partial(self._find, name)) for name in sorted(topics)}
        self.changed = threading.Event()
        self.error: Exception | None = None
        self.examined = self.received = 0
        self._worker: Worker[FrameSet[Image]] = Worker(
            "board finder", self._process, depth=1, on_drop=lambda: None, on_error=self._fail
        )
        self._subscriptions = [
            node.create_subscription(Image, topic, partial(self._on_image, name), SILHOUETTE_SUBSCRIBER)
            for name, topic in topics.items()
        ]

    def progress(self) -> tuple[int, str]:
        """Return the number of frames that tie cameras together so far, and the missing ties."""
        return motion_advice(tuple(self._topics), detections_of(self._found))

    def seen(self) -> CamerasDetections:
        """Return the detections of each camera that has delivered pictures."""
        return {name: found for name, found in self._found.items() if found.examined}

    def __enter__(self) -> MotionRecorder:
        return self

    def __exit__(self, *error: object) -> None:
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._worker.close()

    def _on_image(self, name: str, message: Image) -> None:
        self.received += 1
        for closed in self._collector.add(name, to_ns(message.header.stamp), message, time.monotonic_ns()):
            if len(closed.frames) > 1:
                self._worker.put(closed)

    def _process(self, frames: FrameSet[Image]) -> None:
        """Search one frame set, on the worker's thread."""
        for name, message in frames.frames.items():
            with suppress(InputError):  # one bad picture: the next may be better
                self._found[name].examine(decode_image(message, self._topics[name]), self.examined)
        self.examined += 1
        self.changed.set()

    def _find(self, name: str, image: np.ndarray, frame_index: int) -> TargetDetection | None:
        return find_board(image, self._board, camera=name, frame_index=frame_index, target=MOVING)

    def _fail(self, error: Exception) -> None:
        self.error = error
        self.changed.set()


def watch_recorder(recorder: MotionRecorder, stop: threading.Event) -> None:
    """Show the progress until it suffices or the person stops it. Raises InputError when no frame set comes."""
    begun_s, done = time.monotonic(), doing("carried board")
    while not stop.is_set():
        recorder.changed.wait(ROUND_S)
        recorder.changed.clear()
        if recorder.error is not None:
            raise recorder.error
        shared, advice = recorder.progress()
        if recorder.examined == 0 and time.monotonic() - begun_s > PATIENCE_S:
            apart = f"no two cameras' within {TOLERANCE_NS / 1e6:g} ms of each other"
            came = f"{recorder.received} pictures came, but {apart}" if recorder.received else "no picture comes"
            raise InputError(came, remedy="Synchronise the cameras (docs/how-to/camera_pcs.md).")
        examined = f"{shared} of {recorder.examined} frames seen by two or more cameras"
        done(f"{examined}; {advice or 'enough'}")
        if not advice:
            return


class LiveSources:
    """Pictures of the running cameras. Raises InputError naming cameras that do not publish.

    ``ask`` is called before the board is to lie on the floor, and before it is to be carried; ``stop`` ends the
    carrying early.
    """

    def __init__(
        self, node: Node, wanted: Sequence[str], without: Sequence[str], carried: bool, ask: Ask, stop: threading.Event
    ) -> None:
        self._topics = {name: topic for name, topic in find_topics(node, wanted).items() if name not in without}
        self.names = tuple(sorted(self._topics))
        self._node, self._carried, self._ask, self._stop = node, carried, ask, stop

    def detect_floor(self, board: Board, corners: Corners) -> CamerasDetections:
        self._ask("Lay the board on the floor, print upwards, and leave it")
        shots = grab(self._node, self._topics, FLOOR_SHOTS)
        return find_floor(shots, board, corners)

    def detect_moving(self, board: Board, cameras: Cameras) -> CamerasDetections:
        if not self._carried:
            return {}
        self._ask("Carry the board through the room, slowly, its print towards the cameras; Ctrl-C ends it early")
        topics = {name: self._topics[name] for name in sorted(cameras)}
        with MotionRecorder(self._node, topics, board) as recorder:
            watch_recorder(recorder, self._stop)
            until_stopped()
        return recorder.seen()

    def detect_wand(self, marks_m: Sequence[float], cameras: Cameras) -> CamerasDetections:
        return {}


def find_topics(node: Node, wanted: Sequence[str], timeout_s: float = PATIENCE_S) -> dict[str, str]:
    """Return the topics /NAME/image_raw of the ``wanted`` cameras, or of all. Raises InputError for absent ones."""
    settled(lambda: {*_image_topics(node)}.intersection(wanted or _image_topics(node)), len(wanted) or 1, timeout_s)
    found = _image_topics(node)
    missing = ", ".join(sorted(set(wanted) - set(found)))
    if found and not missing:
        return {name: found[name] for name in wanted or found}
    raise InputError(
        f"no node publishes /{missing or 'NAME'}/{TOPIC}",
        remedy="Start the camera clients with publish_raw (or without a rig), check ROS_DOMAIN_ID. "
        f"Published: {', '.join(sorted(found)) or 'none'}.",
    )


def grab(node: Node, topics: Mapping[str, str], count: int) -> dict[str, list[tuple[int, np.ndarray]]]:
    """Return the next ``count`` pictures of every camera, numbered. Raises InputError for a camera that sends none."""
    pictures: dict[str, list[np.ndarray]] = {name: [] for name in topics}
    changed = threading.Condition()

    def add(name: str, message: Image) -> None:
        with changed:
            if len(pictures[name]) < count:
                pictures[name].append(decode_image(message, topics[name]))
                changed.notify_all()

    subscriptions = [
        node.create_subscription(Image, topic, partial(add, name), SILHOUETTE_SUBSCRIBER)
        for name, topic in topics.items()
    ]
    with changed:
        changed.wait_for(lambda: all(len(taken) == count for taken in pictures.values()), PATIENCE_S)
    for subscription in subscriptions:
        node.destroy_subscription(subscription)
    silent = [name for name, taken in pictures.items() if not taken]
    if silent:
        remedy = "Check the camera client: sagoma doctor; or leave it out (--without)."
        raise InputError(f"no picture came from {', '.join(silent)} for {PATIENCE_S:g} s", remedy=remedy)
    return {name: list(enumerate(taken)) for name, taken in pictures.items()}


def _image_topics(node: Node) -> dict[str, str]:
    """Return the image_raw topics with a publisher, by the camera's name."""
    topics = [name for name, kinds in node.get_topic_names_and_types() if IMAGE_TYPE in kinds]
    named = {
        topic.split("/")[-2]: topic for topic in sorted(topics) if topic.count("/") > 1 and topic.endswith(f"/{TOPIC}")
    }
    return {name: topic for name, topic in named.items() if node.count_publishers(topic)}
