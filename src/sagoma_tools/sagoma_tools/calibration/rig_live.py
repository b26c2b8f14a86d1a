"""Pictures of a rig's calibration from the running cameras: their image_raw topics, best effort."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from rclpy.node import Node
from rich.console import Console
from sensor_msgs.msg import Image

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.boards.board import Board
from sagoma_ros.qos import SILHOUETTE_SUBSCRIBER

from .live_image import image_of
from .rig_live_recorder import MotionRecorder, watch_recorder
from .rig_sightings import Seen, find_floor
from .rig_sources import Corners, RigSources

TOPIC = "image_raw"
IMAGE_TYPE = "sensor_msgs/msg/Image"
FIND_TIMEOUT_S, SETTLE_S, POLL_S = 15.0, 3.0, 0.1
FLOOR_SHOTS, SHOTS_TIMEOUT_S = 5, 15.0

Ask = Callable[[str], None]
"""Tells the person what to do and waits until it is done."""


class LiveSources(RigSources):
    """The running cameras. ``ask`` is called before the board is to lie on the floor, and before it is to be carried;
    ``stop`` ends the carrying early. Raises InputError naming cameras that do not publish."""

    def __init__(
        self,
        node: Node,
        wanted: Sequence[str],
        without: Sequence[str],
        carried: bool,
        console: Console,
        ask: Ask,
        stop: threading.Event,
    ) -> None:
        self._topics = {name: topic for name, topic in find_topics(node, wanted).items() if name not in without}
        self.names = tuple(sorted(self._topics))
        self._node, self._carried, self._console, self._ask, self._stop = node, carried, console, ask, stop
        self._shots: dict[str, Shots] = {}

    def see_floor(self, board: Board, cameras: Mapping[str, CameraModel], corners: Corners) -> dict[str, Seen]:
        if not self._shots:
            self._ask("Lay the board on the floor, print upwards, and leave it")
            self._shots = grab(self._node, self._topics, FLOOR_SHOTS)
        return find_floor({name: self._shots[name] for name in sorted(cameras)}, board, cameras, corners)

    def see_moving(self, board: Board, cameras: Mapping[str, CameraModel]) -> dict[str, Seen]:
        if not self._carried:
            return {}
        self._ask("Carry the board through the room, slowly, its print towards the cameras; Ctrl-C ends it early")
        topics = {name: self._topics[name] for name in sorted(cameras)}
        with MotionRecorder(self._node, topics, board) as recorder:
            watch_recorder(recorder, self._console, self._stop)
        return recorder.seen()

    def see_wand(self, marks_m: Sequence[float], cameras: Mapping[str, CameraModel]) -> dict[str, Seen]:
        return {}


@dataclass(frozen=True, eq=False)
class Shots:
    """Some pictures of one camera, as footage: moments count from 0."""

    name: str
    pictures: tuple[np.ndarray, ...]

    @property
    def count(self) -> int:
        return len(self.pictures)

    def __iter__(self) -> Iterator[tuple[int, np.ndarray]]:
        return iter(enumerate(self.pictures))


def find_topics(node: Node, wanted: Sequence[str], timeout_s: float = FIND_TIMEOUT_S) -> dict[str, str]:
    """/NAME/image_raw of the cameras ``wanted``, or of all that publish. Raises InputError naming those that do not."""
    seen: dict[str, str] = {}
    deadline_s, since_s = time.monotonic() + timeout_s, time.monotonic()
    while time.monotonic() < deadline_s:
        found = _image_topics(node)
        if wanted and set(wanted) <= set(found):
            return {name: found[name] for name in wanted}
        if found != seen:
            seen, since_s = found, time.monotonic()
        elif seen and not wanted and time.monotonic() - since_s > SETTLE_S:
            return seen
        time.sleep(POLL_S)  # the graph offers no event to wait for
    missing = ", ".join(sorted(set(wanted) - set(seen)))
    raise InputError(
        f"nobody publishes /{missing or 'NAME'}/{TOPIC}",
        remedy="Start the camera clients with publish_raw (or without a rig), check ROS_DOMAIN_ID. "
        f"Published: {', '.join(sorted(seen)) or 'none'}.",
    )


def grab(node: Node, topics: Mapping[str, str], count: int, timeout_s: float = SHOTS_TIMEOUT_S) -> dict[str, Shots]:
    """The next ``count`` pictures of every camera. Raises InputError for a camera that sends none."""
    pictures: dict[str, list[np.ndarray]] = {name: [] for name in topics}
    changed = threading.Condition()

    def take(name: str, message: Image) -> None:
        with changed:
            if len(pictures[name]) < count:
                pictures[name].append(image_of(message, topics[name]))
                changed.notify_all()

    subscriptions = [
        node.create_subscription(Image, topic, partial(take, name), SILHOUETTE_SUBSCRIBER)
        for name, topic in topics.items()
    ]
    with changed:
        changed.wait_for(lambda: all(len(taken) == count for taken in pictures.values()), timeout_s)
    for subscription in subscriptions:
        node.destroy_subscription(subscription)
    silent = [name for name, taken in pictures.items() if not taken]
    if silent:
        raise InputError(
            f"no picture came from {', '.join(silent)} for {timeout_s:g} s",
            remedy="Check the camera client: sagoma doctor; or leave it out (--without).",
        )
    return {name: Shots(name, tuple(taken)) for name, taken in pictures.items()}


def _image_topics(node: Node) -> dict[str, str]:
    """By camera's name, the image_raw topics that somebody publishes."""
    topics = [name for name, kinds in node.get_topic_names_and_types() if IMAGE_TYPE in kinds]
    named = {
        topic.split("/")[-2]: topic for topic in sorted(topics) if topic.count("/") > 1 and topic.endswith(f"/{TOPIC}")
    }
    return {name: topic for name, topic in named.items() if node.count_publishers(topic)}
