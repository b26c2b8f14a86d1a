"""A source that takes the images of any ROS driver: sensor_msgs/Image or CompressedImage on a topic."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy as Reliability
from sensor_msgs.msg import CameraInfo, CompressedImage
from sensor_msgs.msg import Image as ImageMessage

from capture_rig.errors import InputError
from sagoma_ros.images import decode_image
from sagoma_ros.messages import NS_PER_S, read_message, to_ns

from ..frame_source import LASTING_S, POLL_S, RELEASE_S, Frame, FrameNumbers, FrameSource, SourceUnavailable
from ..settings import TopicSettings
from .footage_reader import convert_channels

T = TypeVar("T")

TYPES = {"sensor_msgs/msg/Image": ImageMessage, "sensor_msgs/msg/CompressedImage": CompressedImage}
CLOCK = "header of the topic"
DEPTH = 4  # images that may wait: older ones make room, and count as lost


class TopicSource(FrameSource):
    """Images that a driver publishes, for a camera client in ``namespace``.

    ``use_lens`` is called with the driver's camera_info, where the settings name one, before the connection is made.

    A frame's stamp is its header's plus ``stamp_offset_ms`` (a driver stamps the start or end of an exposure, or the
    arrival; ours is mid-exposure). ROS headers are not numbered: a gap between stamps of n frame periods counts as
    n - 1 lost frames. It subscribes as reliably as the publisher offers, in a node and on a thread of its own.
    """

    def __init__(
        self,
        settings: TopicSettings,
        channels: str = "auto",
        namespace: str = "/",
        context: Context | None = None,
        use_lens: Callable[[CameraInfo], None] = lambda info: None,
    ) -> None:
        super().__init__()
        self._use_lens = use_lens
        self.description = f"topic {settings.name}"
        self._settings, self._channels, self._namespace, self._context = settings, channels, namespace, context
        self._node: Node | None = None
        self._executor: SingleThreadedExecutor | None = None
        self._spinner: threading.Thread | None = None
        self._kind: type[ImageMessage] | type[CompressedImage] = ImageMessage
        self._waiting: deque[tuple[bytes, int]] = deque(maxlen=DEPTH)  # serialised images, when they arrived, ns
        self._arrived = threading.Condition()
        self._rate_hz = 0.0
        self._numbers = FrameNumbers(self._statistics)
        self._camera_info: CameraInfo | None = None

    def connect(self) -> None:
        if not self._settings.name:
            raise InputError(
                "is empty", where="parameter topic.name", remedy="Name the driver's image topic: /usb_cam1/image_raw."
            )
        self._node = Node("images", namespace=self._namespace, context=self._context, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._spinner = threading.Thread(target=self._executor.spin, name="images", daemon=True)
        try:
            self._subscribe(self._node)
        except BaseException:
            self.close()
            raise
        self._spinner.start()

    def _subscribe(self, node: Node) -> None:
        """Find the publisher; learn size, rate and lens from the first images. InputError, or SourceUnavailable."""
        topic = node.resolve_topic_name(self._settings.name)
        if topic.rpartition("/")[0] == self._namespace.rstrip("/"):
            raise InputError(
                f"{topic} is in the namespace in which the camera client publishes image_raw and camera_info itself",
                where=self.description,
                remedy=f"Start the driver in another one: --ros-args -r __ns:=/driver{self._namespace}",
            )
        publishers = self._first(lambda: node.get_publishers_info_by_topic(topic) or None, "nobody publishes it")
        kinds = {info.topic_type for info in publishers}
        if len(kinds) != 1 or kinds.isdisjoint(TYPES):
            raise InputError(
                f"carries {', '.join(sorted(kinds))}",
                where=self.description,
                remedy="Name a topic of sensor_msgs Image or CompressedImage.",
            )
        self._kind = TYPES[kinds.pop()]
        offers = {info.qos_profile.reliability for info in publishers}
        qos = QoSProfile(depth=DEPTH, reliability=max(offers, key=lambda offer: offer == Reliability.BEST_EFFORT))
        node.create_subscription(self._kind, self._settings.name, self._on_image, qos, raw=True)
        if lens := self._settings.camera_info:
            node.create_subscription(CameraInfo, lens, self._on_camera_info, qos)
        silence = f"nothing came on {{}} within {LASTING_S:.0f} s"
        self._first(lambda: self._waiting if len(self._waiting) > 1 else None, silence.format(self._settings.name))
        first, second = (self._frame(*self._waiting.popleft()) for _ in range(2))
        if lens:
            self._use_lens(self._first(lambda: self._camera_info, silence.format(lens)))
        self.shape = first.image.shape
        self._rate_hz = NS_PER_S / max(second.stamp_ns - first.stamp_ns, 1)
        if abs(age_s := (time.time_ns() - second.stamp_ns) / NS_PER_S) > 1.0:
            self.warnings = (
                f"{self.description}: its stamps differ by {age_s:.0f} s from this machine's clock; "
                "cameras agree only where all drivers stamp by one clock",
            )

    def _first(self, take: Callable[[], T | None], otherwise: str) -> T:
        """Return what ``take`` gives once it gives something; SourceUnavailable, ``otherwise``, when that lasts."""
        assert self._executor is not None
        deadline_s = time.monotonic() + LASTING_S
        while (found := take()) is None:
            if time.monotonic() >= deadline_s:
                raise SourceUnavailable(otherwise, where=self.description)
            self._executor.spin_once(timeout_sec=POLL_S)
        return found

    def start(self) -> None:
        self._waiting.clear()
        self._numbers.restart()

    def read(self, timeout_s: float) -> Frame | None:
        with self._arrived:
            if not self._arrived.wait_for(lambda: self._waiting, timeout_s):
                return None
            message, arrived_ns = self._waiting.popleft()
        try:
            frame = self._frame(message, arrived_ns)
        except InputError:  # one damaged image; where none is sound the source falls silent and is connected anew
            self.count("damaged")
            return None
        if frame.image.shape != self.shape:
            raise SourceUnavailable(
                f"images changed from {self.shape} to {frame.image.shape} (rows, columns)", where=self.description
            )
        number = self._numbers.add(frame.stamp_ns)
        return None if number is None else replace(frame, frame_id=number)

    def stop(self) -> None:
        """Do nothing: images that come meanwhile make room for each other."""

    def close(self) -> None:
        if self._executor is not None:
            self._executor.shutdown(timeout_sec=RELEASE_S)
        if self._spinner is not None and self._spinner.is_alive():
            self._spinner.join(RELEASE_S)
        if self._node is not None:
            self._node.destroy_node()
        self._node = self._executor = None
        self._waiting.clear()

    @property
    def details(self) -> dict[str, str]:
        return {"frame_rate": f"{self._rate_hz:.2f}"} | self._numbers.details()

    def _on_image(self, message: bytes) -> None:
        with self._arrived:
            self._waiting.append((message, time.time_ns()))
            self._arrived.notify()

    def _on_camera_info(self, message: CameraInfo) -> None:
        self._camera_info = message

    def _frame(self, message: bytes, arrived_ns: int) -> Frame:
        """Decode a message. Raises InputError for one that is damaged or of an unknown encoding."""
        settings = self._settings
        image = read_message(message, self._kind)
        stamp_ns, clock, uncertainty_ms = to_ns(image.header.stamp), CLOCK, settings.stamp_uncertainty_ms
        if not stamp_ns:
            self.count("without_stamp")
            stamp_ns, clock = arrived_ns, "arrival"
        stamp_ns += round(settings.stamp_offset_ms * 1e6)
        pixels = convert_channels(decode_image(image, settings.name, settings.bits), self._channels)
        return Frame(pixels, stamp_ns, 0, clock, round(uncertainty_ms * 1e6))
