"""What one camera client publishes and receives: silhouettes with their camera_info, pictures on request, diagnostics,
and the clock by which cameras play footage."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, TimeReference

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import with_intrinsics
from capture_rig.mask_levels import FOREGROUND, SHADOW_CANDIDATE, UNCERTAIN
from mocap_packets.silhouette import Silhouette
from sagoma_ros.health import NodeHealth
from sagoma_ros.images import camera_info_message, image_message, preview_message, silhouette_message
from sagoma_ros.messages import to_ns, to_stamp
from sagoma_ros.qos import LATCHED, LATCHED_BY_MANY, RESULT, SILHOUETTE_PUBLISHER, graph_topic

from .background.causes import KEY as FINDINGS_KEY
from .background.causes import findings_text
from .background.model import BackgroundModel
from .diagnostics import (
    NO_RESULT,
    CameraState,
    Level,
    RecentStatistics,
    assess,
    background_findings,
    background_values,
    frame_values,
    source_values,
)
from .frame_processor import FrameProcessor, FrameResult
from .frame_source import Frame, FrameSource, Mask
from .frame_source import Image as Picture
from .settings import CameraClientSettings
from .sources.footage_source import FootageClock, SharedClock
from .sources.grab_loop import GrabLoop

PREVIEW_PERIOD_S = 0.2
SILHOUETTE_TOPIC = "silhouette/compressed"
FOOTAGE_CLOCK_TOPIC = "footage/clock"
PERSON_BGR, CANDIDATE_BGR = (0, 255, 0), (0, 140, 255)
LINE_PX = 2


def camera_from_message(info: CameraInfo, camera: CameraModel, where: str = "set_camera_info") -> CameraModel:
    """Return ``camera`` with the intrinsics of ``info``. Raises InputError naming ``where``, the field and value."""
    K, R = np.reshape(info.k, (3, 3)), np.reshape(info.r, (3, 3))
    if not R.any():  # zero where the sender did not fill it in
        R = np.eye(3)
    return with_intrinsics(
        camera, info.width, info.height, K.tolist(), info.distortion_model, list(info.d), R.tolist(), where
    )


class CameraTopics:
    """The publishers of one camera client, made by ``create(message type, topic, QoS)``."""

    def __init__(
        self,
        create: Callable[[type, str, Any], Any],
        frame_id: str,
        settings: CameraClientSettings,
        to_calibrate: bool = False,
    ) -> None:
        """``to_calibrate``: images are offered for the calibration, and sent while there is a subscriber."""
        self._frame_id, self._raw_always = frame_id, settings.publish_raw
        self._silhouettes = create(CompressedImage, SILHOUETTE_TOPIC, SILHOUETTE_PUBLISHER)
        self._infos = create(CameraInfo, "camera_info", SILHOUETTE_PUBLISHER)
        self._means = create(Image, "background/mean", LATCHED)
        offered = settings.publish_raw or to_calibrate
        self._raws = create(Image, "image_raw", SILHOUETTE_PUBLISHER) if offered else None
        self._previews = create(CompressedImage, "preview/compressed", RESULT) if settings.publish_preview else None
        self._info: tuple[CameraModel, CameraInfo] | None = None
        self._last_preview_s = -np.inf

    @property
    def has_listener(self) -> bool:
        """Whether there is a subscriber to the silhouettes, or to images that are sent only then."""
        return _is_heard(self._silhouettes) or (not self._raw_always and _is_heard(self._raws))

    def publish_image(self, frame: Frame) -> None:
        """Publish the frame as it came, with ``publish_raw`` or while somebody subscribes to calibrate the camera."""
        if self._raws is not None and (self._raw_always or _is_heard(self._raws)):
            self._raws.publish(image_message(frame.image, frame.stamp_ns, self._frame_id))

    def publish_uncalibrated(self, frame: Frame) -> None:
        """Publish the camera_info of a frame whose lens is unknown: K[0] = 0 says so (REP-104)."""
        info = CameraInfo(height=frame.image.shape[0], width=frame.image.shape[1])
        info.header.stamp, info.header.frame_id = to_stamp(frame.stamp_ns), self._frame_id
        self._infos.publish(info)

    def publish_silhouette(self, frame: Frame, seen: FrameResult, silhouette: Silhouette) -> None:
        """Publish the silhouette and its camera_info under one stamp; now and then a preview, while somebody looks."""
        assert seen.canvas is not None
        self._infos.publish(self._info_of(seen.canvas, frame.stamp_ns))
        self._silhouettes.publish(silhouette_message(silhouette.mask, frame.stamp_ns, self._frame_id))
        now_s = time.monotonic()
        if now_s - self._last_preview_s >= PREVIEW_PERIOD_S and _is_heard(self._previews):
            assert self._previews is not None
            self._last_preview_s = now_s
            outlined = outline(frame.image, silhouette.image_mask)
            self._previews.publish(preview_message(outlined, frame.stamp_ns, self._frame_id))

    def _info_of(self, canvas: CameraModel, stamp_ns: int) -> CameraInfo:
        """Return its camera_info, made once a canvas and stamped anew: setting its arrays costs more than all else."""
        if self._info is None or self._info[0] is not canvas:
            self._info = (canvas, camera_info_message(canvas, stamp_ns, self._frame_id))
        info = self._info[1]
        info.header.stamp = to_stamp(stamp_ns)
        return info

    def publish_background(self, model: BackgroundModel) -> None:
        """Publish the mean of the background in use."""
        self._means.publish(image_message(np.rint(model.mean).astype(np.uint8), 0, self._frame_id))


def _is_heard(publisher: Publisher | None) -> bool:
    return publisher is not None and publisher.get_subscription_count() > 0


def outline(image: Picture, mask: Mask) -> Picture:
    """Draw the outlines of a silhouette into its image.

    Gives the image (H, W[, 3]), which may come at half size, at half size, BGR, the person's outline green, that of
    shadow candidates orange. ``mask`` (H, W) is :attr:`mocap_packets.silhouette.Silhouette.image_mask`.
    """
    if image.shape[:2] != mask.shape:
        image = np.asarray(cv2.resize(image, mask.shape[::-1], interpolation=cv2.INTER_NEAREST))
    shown = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    for above, most, colour in (
        (UNCERTAIN, SHADOW_CANDIDATE, CANDIDATE_BGR),
        (SHADOW_CANDIDATE, FOREGROUND, PERSON_BGR),
    ):
        contours, _ = cv2.findContours(cv2.inRange(mask, above + 1, most), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(shown, contours, -1, colour, LINE_PX)
    return np.asarray(cv2.resize(shown, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


class CameraReport:
    """Reports on one activation of a camera client: figures, findings, and one level and line for people."""

    def __init__(self, health: NodeHealth, logger: RcutilsLogger, settings: CameraClientSettings) -> None:
        self._health, self._logger, self._settings = health, logger, settings
        self._recent = RecentStatistics()
        self._logged = ""

    def update(
        self,
        processor: FrameProcessor,
        source: FrameSource,
        loop: GrabLoop,
        last: tuple[Frame, FrameResult] | None,
        placed: bool,
    ) -> None:
        """Report now; ``last`` : the newest frame and its results, ``placed`` : the camera's pose is known."""
        now_s = time.time()
        values = source_values(source) | (frame_values(*last) if last else {}) | background_values(processor, now_s)
        for key, value in values.items():
            self._health.set(key, value)
        findings = background_findings(processor, source, self._settings, now_s)
        self._health.set(FINDINGS_KEY, findings_text(findings))
        state = CameraState(
            loop.state,
            loop.frames,
            loop.reason,
            source.connection,
            self._recent.update(time.monotonic(), source.statistics),
            calibrated=processor.camera is not None,
            placed=placed,
            has_background=processor.background is not None,
            refused=processor.refused,
            findings=findings,
            result=last[1] if last else NO_RESULT,
        )
        self._log_state(*assess(state))

    def _log_state(self, level: Level, text: str) -> None:
        """Set the level and line of the diagnostics; log when the kind of trouble changes."""
        self._health.status(bytes([level]), text)
        if level is Level.ERROR:
            self._health.set("last_error", text)
        kind = "".join(letter for letter in text.partition(":")[0] if not letter.isdigit())
        if kind == self._logged:
            return
        self._logged = kind
        if level is Level.OK:
            self._logger.info(text)
        elif level is Level.WARN:
            self._logger.warning(text)
        else:
            self._logger.error(text)


class FootageClockTopic:
    """The topic ``footage/clock``: cameras agree on the clock by which they play; :attr:`shared` is the one that holds.

    From its activation to its deactivation each camera keeps there, for whoever comes later, the clock that it plays
    by: ``header.stamp`` is the instant of the system clock at which frame 0 leaves, ``time_ref`` that frame's stamp.
    """

    def __init__(self, node: Node, camera: str) -> None:
        self._node, self._camera, self._topic = node, camera, graph_topic(node, FOOTAGE_CLOCK_TOPIC)
        self.shared = SharedClock(self._announce)
        self._publisher: Publisher | None = None
        self._subscription: Subscription | None = None

    def open(self) -> None:
        """Take part: this camera is about to play."""
        self._publisher = self._node.create_publisher(TimeReference, self._topic, LATCHED)
        self._subscription = self._node.create_subscription(TimeReference, self._topic, self._on_clock, LATCHED_BY_MANY)

    def close(self) -> None:
        """Take part no longer, and take the announcement back."""
        publisher, subscription, self._publisher, self._subscription = self._publisher, self._subscription, None, None
        if publisher is not None and subscription is not None:
            self._node.destroy_subscription(subscription)
            self._node.destroy_publisher(publisher)

    @property
    def cameras(self) -> int:
        """How many cameras take part, this one among them."""
        return self._node.count_publishers(self._topic)

    def _announce(self, clock: FootageClock) -> None:
        publisher = self._publisher
        if publisher is not None:
            message = TimeReference(time_ref=to_stamp(clock.epoch_ns), source=self._camera)
            message.header.stamp = to_stamp(clock.begin_ns)
            publisher.publish(message)

    def _on_clock(self, message: TimeReference) -> None:
        if message.header.stamp.sec > 0:  # a message without a time would begin before all others
            self.shared.offer(FootageClock(to_ns(message.header.stamp), to_ns(message.time_ref)))
