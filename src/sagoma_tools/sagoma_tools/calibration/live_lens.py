"""Calibrates a lens from a running camera: collects views of a board, solves, saves, sends the result to the client.

The board is detected as fast as the machine allows; images that arrive meanwhile are dropped.
"""

from __future__ import annotations

import argparse
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rclpy.node import Node
from rich.console import Console
from sensor_msgs.msg import CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo

from capture_rig.errors import InputError
from capture_rig.stop_signals import StopOnSignal
from capture_rig.verdict import REDO
from rig_calibration.boards.board import Board
from rig_calibration.intrinsics.calibrate import AUTO, calibrate_intrinsics
from rig_calibration.intrinsics.result import Intrinsics
from rig_calibration.intrinsics.selection import BoardImageProcessor, ImageResult, ViewCollector
from sagoma_ros.images import camera_info_message, decode_image, preview_message
from sagoma_ros.messages import to_ns
from sagoma_ros.qos import RESULT, SILHOUETTE_SUBSCRIBER
from sagoma_ros.worker import Worker

from ..graph.ros_link import RosLink, call_all
from .intrinsics import save_results
from .live_display import LiveReport, LiveState, draw_preview, panel, plain_line, state_of

COMPRESSED = "/compressed"
PREVIEW = "calibration/preview/compressed"
REFRESH_S = 0.25
SERVICE_TIMEOUT_S = 10.0


def calibrate_live(args: argparse.Namespace, board: Board, console: Console) -> Intrinsics:
    """Collect, calibrate, save; Ctrl-C ends collecting only. Raises InputError: no images, too few views."""
    name = args.name or camera_name_of(args.topic)
    collector = ViewCollector(board, model="plumb_bob" if args.model == AUTO else args.model)
    watcher = BoardImageProcessor(board, name, collector)
    with RosLink("sagoma_calibrate") as link:
        with StopOnSignal() as stop:
            camera = LiveCamera(link.node, args.topic, watcher)
            try:
                _collect(camera, link.node, stop, args, console)
            finally:
                camera.close()
        console.print(f"{name}: calibrating from {len(collector)} views", highlight=False)
        result = calibrate_intrinsics(collector.best(), board, name=name, model=args.model)
        save_results(Path(args.output), result, board, args.topic)
        console.print(f"results in {args.output}")
        if args.offer:
            console.print(f"{name}: {offer(link.node, namespace_of(args.topic), result)}", highlight=False)
    return result


def offer(node: Node, namespace: str, result: Intrinsics) -> str:
    """Send the calibration to the camera client of ``namespace``, unless its verdict is redo; the result in words."""
    if result.verdict.grade == REDO:
        return "not handed to the camera client: it must be done again"
    service = f"{namespace}/set_camera_info"
    camera = result.camera
    request = SetCameraInfo.Request(camera_info=camera_info_message(camera, 0, f"{camera.name}_optical"))
    reply = call_all(node, SetCameraInfo, {service: request}, SERVICE_TIMEOUT_S, repeatable=True)[service]
    if reply is None:
        return f"{service} did not answer: is the camera client running?"
    return f"the camera client {'took it' if reply.success else 'refused it'}: {reply.status_message}"


def _collect(camera: LiveCamera, node: Node, stop: threading.Event, args: argparse.Namespace, console: Console) -> None:
    """Show the progress until the views suffice, the user stops it, or the time is over."""
    begun_s = time.monotonic()
    with LiveReport(console) as report:
        while not stop.is_set() and not camera.state.enough:
            camera.changed.wait(REFRESH_S)
            camera.changed.clear()
            state = camera.state
            report.update(panel(state), plain_line(state), state.views, last=state.enough)
            passed_s = time.monotonic() - begun_s
            if camera.error is not None:
                raise camera.error
            if camera.received == 0 and passed_s > args.wait:
                raise InputError(f"no image came for {args.wait:g} s", where=args.topic, remedy=_who_publishes(node))
            if args.seconds is not None and passed_s > args.seconds:
                return
            if args.views is not None and camera.state.views >= args.views:
                return


def _who_publishes(node: Node) -> str:
    images = sorted(
        name for name, kinds in node.get_topic_names_and_types() if any(kind.endswith("/Image") for kind in kinds)
    )
    listed = f"Image topics there are: {', '.join(images)}" if images else "There is no image topic at all"
    return f"{listed}; start the camera client, and check ROS_DOMAIN_ID."


@dataclass(frozen=True, eq=False)
class _Pair:
    """An image and the one that came just before it."""

    before: Image | CompressedImage
    image: Image | CompressedImage
    number: int


class LiveCamera:
    """Subscribes to ``topic`` (best effort), feeds ``watcher`` on a worker thread, and publishes a preview.

    ``changed`` is set after every image that was processed; ``error`` is the exception that ended it, if there was one.
    """

    def __init__(self, node: Node, topic: str, watcher: BoardImageProcessor) -> None:
        self._topic, self._watcher = topic, watcher
        self.changed = threading.Event()
        self.error: Exception | None = None
        self.received = self.dropped = 0
        self._last: Image | CompressedImage | None = None
        self.state: LiveState = state_of(watcher, "waiting for images", 0, 0)
        self._preview = node.create_publisher(CompressedImage, f"{namespace_of(topic)}/{PREVIEW}", RESULT)
        self._worker: Worker[_Pair] = Worker(
            "board watcher", self._process, depth=1, on_drop=self._count_drop, on_error=self._fail
        )
        kind = CompressedImage if topic.endswith(COMPRESSED) else Image
        self._subscription = node.create_subscription(kind, topic, self._on_image, SILHOUETTE_SUBSCRIBER)

    def close(self) -> None:
        """Stop processing; the views collected so far stay."""
        self._worker.close()

    def _on_image(self, message: Image | CompressedImage) -> None:
        self.received += 1
        if self._last is not None:
            self._worker.put(_Pair(self._last, message, self.received - 1))
        self._last = message

    def _count_drop(self) -> None:
        self.dropped += 1

    def _fail(self, error: Exception) -> None:
        self.error = error
        self.changed.set()

    def _process(self, pair: _Pair) -> None:
        """Search one image, on the worker's thread."""
        try:
            image, before = decode_image(pair.image, self._topic), decode_image(pair.before, self._topic)
        except InputError as error:  # one bad message: the next may be better
            self._update_state(str(error))
            return
        seen = self._watcher.process(image, before, pair.number)
        self._update_state("taken" if seen.taken else seen.reason)
        if self._preview.get_subscription_count():
            self._publish_preview(pair.image, image, seen)

    def _update_state(self, last: str) -> None:
        self.state = state_of(self._watcher, last, self.received, self.dropped)
        self.changed.set()

    def _publish_preview(self, message: Image | CompressedImage, image: np.ndarray, seen: ImageResult) -> None:
        picture = draw_preview(image, seen, self._watcher.collector.coverage, self.state.advice)
        header = message.header
        self._preview.publish(preview_message(picture, to_ns(header.stamp), header.frame_id))


def namespace_of(topic: str) -> str:
    """/cam01 of /cam01/image_raw and of /cam01/image_raw/compressed."""
    return topic.removesuffix(COMPRESSED).rpartition("/")[0]


def camera_name_of(topic: str) -> str:
    """cam01 of /cam01/image_raw; "camera" of a topic without namespace."""
    return namespace_of(topic).rpartition("/")[2] or "camera"
