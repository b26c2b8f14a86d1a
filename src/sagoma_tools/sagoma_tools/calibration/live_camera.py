"""Watches a camera's image topic for a board, as fast as the machine allows: what it cannot keep up with is dropped."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image

from capture_rig.errors import InputError
from rig_calibration.intrinsics.watching import BoardWatcher, Seen
from sagoma_ros.images import preview_message
from sagoma_ros.qos import RESULT, SILHOUETTE_SUBSCRIBER
from sagoma_ros.stamps import to_ns
from sagoma_ros.worker import Worker

from .live_image import image_of
from .live_panel import LiveState, state_of
from .live_preview import draw_preview

COMPRESSED = "/compressed"
PREVIEW = "calibration/preview/compressed"


@dataclass(frozen=True, eq=False)
class _Pair:
    """An image and the one that came just before it."""

    before: Image | CompressedImage
    image: Image | CompressedImage
    number: int


class LiveCamera:
    """Subscribes to ``topic`` (best effort) and feeds ``watcher`` on a thread of its own; publishes a preview.

    ``changed`` is set after every image that was looked at. ``error`` is what ended the watching, if anything did.
    """

    def __init__(self, node: Node, topic: str, watcher: BoardWatcher) -> None:
        self._topic, self._watcher = topic, watcher
        self.changed = threading.Event()
        self.error: Exception | None = None
        self.received = self.dropped = 0
        self._last: Image | CompressedImage | None = None
        self.state: LiveState = state_of(watcher, "waiting for images", 0, 0)
        self._preview = node.create_publisher(CompressedImage, f"{namespace_of(topic)}/{PREVIEW}", RESULT)
        self._worker: Worker[_Pair] = Worker(
            "board watcher", self._look, depth=1, on_drop=self._count_drop, on_error=self._fail
        )
        kind = CompressedImage if topic.endswith(COMPRESSED) else Image
        self._subscription = node.create_subscription(kind, topic, self._on_image, SILHOUETTE_SUBSCRIBER)

    def close(self) -> None:
        """Stop looking; what has been collected stays."""
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

    def _look(self, pair: _Pair) -> None:
        """On the worker's thread."""
        try:
            image, before = image_of(pair.image, self._topic), image_of(pair.before, self._topic)
        except InputError as error:  # one bad message: the next may be better
            self._tell(str(error))
            return
        seen = self._watcher.see(image, before, pair.number)
        self._tell("taken" if seen.taken else seen.reason)
        if self._preview.get_subscription_count():
            self._publish_preview(pair.image, image, seen)

    def _tell(self, last: str) -> None:
        self.state = state_of(self._watcher, last, self.received, self.dropped)
        self.changed.set()

    def _publish_preview(self, message: Image | CompressedImage, image: np.ndarray, seen: Seen) -> None:
        picture = draw_preview(image, seen, self._watcher.collector.coverage, self.state.advice)
        header = message.header
        self._preview.publish(preview_message(picture, to_ns(header.stamp), header.frame_id))


def namespace_of(topic: str) -> str:
    """/cam01 of /cam01/image_raw and of /cam01/image_raw/compressed."""
    return topic.removesuffix(COMPRESSED).rpartition("/")[0]


def camera_name_of(topic: str) -> str:
    """cam01 of /cam01/image_raw; "camera" of a topic without namespace."""
    return namespace_of(topic).rpartition("/")[2] or "camera"
