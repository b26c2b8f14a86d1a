"""Calibrates a lens from a running camera: collects views of a board, solves, saves, sends the result to the client.

The board is detected as fast as the machine allows; images that arrive meanwhile are dropped.
"""

from __future__ import annotations

import argparse
import threading
import time
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
from rclpy.node import Node
from rich.console import Console
from sensor_msgs.msg import CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo

from capture_rig.errors import InputError
from capture_rig.stop_signals import StopOnSignal
from capture_rig.verdict import REDO
from rig_calibration.boards.board import Board, TargetDetection
from rig_calibration.intrinsics.calibrate import AUTO, calibrate_intrinsics
from rig_calibration.intrinsics.result import Intrinsics
from rig_calibration.intrinsics.selection import ViewCollector
from sagoma_ros.images import camera_info_message, decode_image, preview_message
from sagoma_ros.inputs import Worker
from sagoma_ros.messages import to_ns
from sagoma_ros.qos import RESULT, SILHOUETTE_SUBSCRIBER

from ..console import doing, until_stopped
from ..graph import PATIENCE_S, ROUND_S
from ..graph.ros_link import RosLink, call_all
from .intrinsics import save_results

COMPRESSED = "/compressed"
PREVIEW = "calibration/preview/compressed"
Message: TypeAlias = Image | CompressedImage


def calibrate_live(args: argparse.Namespace, board: Board, console: Console) -> Intrinsics:
    """Collect, calibrate, save; Ctrl-C ends collecting only. Raises InputError: no images, too few views."""
    name = camera_name_of(args.topic)
    collector = ViewCollector(board, name, model="plumb_bob" if args.model == AUTO else args.model)
    with RosLink("sagoma_calibrate") as link:
        with StopOnSignal() as stop:
            camera = LiveCamera(link.node, args.topic, collector)
            try:
                _collect(camera, link.node, stop, args)
            finally:
                camera.close()
                until_stopped()
        console.print(f"{name}: calibrating from {len(collector)} views")
        result = calibrate_intrinsics(collector.detections, board, name=name, model=args.model)
        save_results(Path(args.output), result, board, args.topic)
        console.print(f"results in {args.output}")
        if args.offer:
            console.print(f"{name}: {offer(link.node, camera_namespace(args.topic), result)}")
    return result


def offer(node: Node, namespace: str, result: Intrinsics) -> str:
    """Send the calibration to the camera client of ``namespace``, unless its verdict is redo; the result in words."""
    if result.verdict.grade == REDO:
        return "not handed to the camera client: it must be done again"
    service = f"{namespace}/set_camera_info"
    camera = result.camera
    request = SetCameraInfo.Request(camera_info=camera_info_message(camera, 0, f"{camera.name}_optical"))
    reply = call_all(node, SetCameraInfo, {service: request}, PATIENCE_S, repeatable=True)[service]
    if reply is None:
        return f"{service} did not answer: is the camera client running?"
    return f"the camera client {'took it' if reply.success else 'refused it'}: {reply.status_message}"


def _collect(camera: LiveCamera, node: Node, stop: threading.Event, args: argparse.Namespace) -> None:
    """Show the progress until the views suffice, the user stops it, or the time is over."""
    begun_s, done = time.monotonic(), doing("collecting views, until Ctrl-C")
    while not stop.is_set():
        camera.changed.wait(ROUND_S)
        camera.changed.clear()
        (line, views, enough), passed_s = camera.shown, time.monotonic() - begun_s
        done(line)
        if camera.error is not None:
            raise camera.error
        if camera.received == 0 and passed_s > args.wait:
            raise InputError(f"no image came for {args.wait:g} s", where=args.topic, remedy=_who_publishes(node))
        over = args.seconds is not None and passed_s > args.seconds
        if enough or over or (args.views is not None and views >= args.views):
            return


def _who_publishes(node: Node) -> str:
    images = sorted(
        name for name, kinds in node.get_topic_names_and_types() if any(kind.endswith("/Image") for kind in kinds)
    )
    listed = f"Image topics there are: {', '.join(images)}" if images else "There is no image topic at all"
    return f"{listed}; start the camera client, and check ROS_DOMAIN_ID."


class LiveCamera:
    """Subscribes to ``topic`` (best effort), feeds ``collector`` on a worker thread, and publishes a preview.

    ``changed`` is set after every image that was processed; ``error`` is the exception that ended it, if there was one.
    """

    def __init__(self, node: Node, topic: str, collector: ViewCollector) -> None:
        self._topic, self._collector = topic, collector
        self.changed = threading.Event()
        self.error: Exception | None = None
        self.received = 0
        self._show("waiting for images")
        self._preview = node.create_publisher(CompressedImage, f"{camera_namespace(topic)}/{PREVIEW}", RESULT)
        self._worker: Worker[tuple[Message, int]] = Worker(  # the image, its number
            "board watcher", self._process, depth=1, on_drop=lambda: None, on_error=self._fail
        )
        kind = CompressedImage if topic.endswith(COMPRESSED) else Image
        self._subscription = node.create_subscription(kind, topic, self._on_image, SILHOUETTE_SUBSCRIBER)

    def close(self) -> None:
        """Stop processing; the views collected so far stay."""
        self._worker.close()

    def _on_image(self, message: Message) -> None:
        self.received += 1
        self._worker.put((message, self.received - 1))

    def _fail(self, error: Exception) -> None:
        self.error = error
        self.changed.set()

    def _process(self, numbered: tuple[Message, int]) -> None:
        """Search one image, on the worker's thread."""
        message, number = numbered
        try:
            image = decode_image(message, self._topic)
        except InputError as error:  # one bad message: the next may be better
            self._show(str(error))
            return
        detection, reason = self._collector.process(image, number)
        self._show(reason or "taken")
        if self._preview.get_subscription_count():
            picture, header = draw_preview(image, detection, reason, self._collector), message.header
            self._preview.publish(preview_message(picture, to_ns(header.stamp), header.frame_id))

    def _show(self, last: str) -> None:
        """Describe the progress, on the thread that makes it: a line, the number of views, whether they suffice."""
        self.shown = plain_line(self._collector, last), len(self._collector), self._collector.enough
        self.changed.set()


def camera_namespace(topic: str) -> str:
    """/cam01 of /cam01/image_raw and of /cam01/image_raw/compressed."""
    return topic.removesuffix(COMPRESSED).rpartition("/")[0]


def camera_name_of(topic: str) -> str:
    """cam01 of /cam01/image_raw; "camera" of a topic without namespace."""
    return camera_namespace(topic).rpartition("/")[2] or "camera"


# display --------------------------------------------------------------------------------------------------------------


def plain_line(collector: ViewCollector, last: str) -> str:
    """Return the progress as a line; ``last`` : result of the last image."""
    progress = ", ".join(f"{goal} {100 * share:.0f} %" for goal, share in collector.coverage.progress().items())
    advice = collector.advice() or "enough"
    return f"{collector.camera}: {len(collector)} views; {progress}; {advice} (last image: {last})"


TAKEN, FOUND, COVERED = (60, 220, 60), (40, 160, 255), (90, 160, 60)  # BGR
TEXT_HEIGHT_SHARE = 0.035


def draw_preview(
    image: np.ndarray, detection: TargetDetection | None, reason: str, collector: ViewCollector
) -> np.ndarray:
    """Return the image (H, W[, 3]) as BGR with covered cells tinted, corners marked, and a line of advice; ``reason``:
    why the view was not taken."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    height, width = picture.shape[:2]
    cells = cv2.resize(collector.coverage.cells.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    picture[cells] = (0.75 * picture[cells] + 0.25 * np.array(COVERED)).astype(np.uint8)
    if detection is not None:
        colour, radius = FOUND if reason else TAKEN, max(2, width // 200)
        for x, y in np.rint(detection.pixels).astype(int):
            cv2.circle(picture, (int(x), int(y)), radius, colour, max(1, radius // 2))
    for line, text in enumerate((collector.advice() or "enough", reason or "taken"), 1):  # from the bottom
        scale = TEXT_HEIGHT_SHARE * height / 22
        needed = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0]
        scale *= min(1.0, 0.97 * width / max(needed, 1))
        place = (int(0.01 * width), int(height - (line - 0.6) * 1.6 * TEXT_HEIGHT_SHARE * height))
        for colour, thickness in (((0, 0, 0), 4), ((255, 255, 255), 1)):  # readable on any background
            cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, thickness, cv2.LINE_AA)
    return picture
