"""The node of one camera PC: frames in, undistorted silhouettes with their camera_info out."""

from __future__ import annotations

import datetime
import sys
import time
from collections.abc import Callable
from typing import TypeVar

import cv2
import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from sagoma_ros.health import ERROR, OK, WARN
from sagoma_ros.images import camera_info_message, image_message, preview_message, silhouette_message
from sagoma_ros.main import run_node
from sagoma_ros.node import SagomaNode
from sagoma_ros.qos import LATCHED, RESULT, SILHOUETTE_PUBLISHER
from sagoma_ros.stamps import to_ns

from .assembly import connect_source, load_camera
from .background_files import read_background
from .background_model import BackgroundModel
from .frame_source import Frame, FrameSource
from .grab_loop import GrabLoop, GrabState
from .live_learning import LiveLearning, describe
from .memory import release_free_memory, return_large_blocks
from .settings import CameraClientSettings
from .silhouette import Silhouette, SilhouettePipeline

T = TypeVar("T")

REPORT_PERIOD_S = 0.5
SILENCE_S = 1.0
SETTLE_S = 0.2  # from the first match until both ends of a new connection know each other


class CameraNode(SagomaNode):
    """Publishes one silhouette for every frame, stamped with the frame's capture time."""

    Settings = CameraClientSettings

    def __init__(self, name: str = "camera_client", **options: object) -> None:
        super().__init__(name, **options)
        cv2.setNumThreads(1)
        self._source: FrameSource | None = None
        self._loop: GrabLoop | None = None
        self._pipeline: SilhouettePipeline | None = None
        self._learning: tuple[LiveLearning, Future] | None = None
        self._held: list[tuple] = []  # (destroy function, entity) of everything made at configure
        self._last_silhouette: Silhouette | None = None
        self._matched_s: float | None = None
        self._last_preview_ns = 0
        self._said = ""
        # lives as long as the node, so that no answer is due to a service that is gone; in a group of its own, because
        # its answer takes seconds and must not hold up the timer and the acknowledgements
        self.create_service(
            Trigger, "~/learn_background", self._on_learn, callback_group=MutuallyExclusiveCallbackGroup()
        )

    # --- lifecycle -----------------------------------------------------------------------------------------------

    def configure(self) -> None:
        settings: CameraClientSettings = self.settings
        name = settings.camera_name or self.get_namespace().rsplit("/", 1)[-1]
        self._camera = load_camera(settings.rig_file, name)
        self._frame_id = f"{name}_optical"
        self._source = connect_source(settings, self._camera)
        for warning in self._source.warnings:
            self.get_logger().warning(warning)
        self._make_publishers(settings)
        if settings.background:
            shape, path = self._source.shape, settings.background
            self._use_background(read_background(path, shape, settings.background_model))
        self._hold(self.destroy_timer, self.create_timer(REPORT_PERIOD_S, self._report))
        if settings.source == "footage" and settings.footage.rate == 0:
            topic = settings.footage.pace_topic
            self._hold(
                self.destroy_subscription,
                self.create_subscription(JointState, topic, self._on_acknowledgement, RESULT),
            )
        release_free_memory()
        self.get_logger().info(f"camera {name}: {self._source.description}")

    def activate(self) -> None:
        assert self._source is not None
        live = self.settings.source != "footage"
        self._matched_s, self._said = None, ""
        self._loop = GrabLoop(
            self._source, self._on_frame, self._on_error, ready=lambda: live or self._consumer_listens(),
            ready_timeout_s=0.0 if live else self.settings.footage.wait_for_consumer_s,
        )  # fmt: skip
        if live:
            self._source.start()  # so that a camera that refuses fails the transition
        self._loop.start()

    def deactivate(self) -> None:
        if self._loop is not None:
            self._loop.stop()
            self._loop = None
        self._cancel_learning("the camera was suspended")

    def cleanup(self) -> None:
        for destroy, entity in self._held:
            destroy(entity)
        self._held = []
        self._pipeline = self._last_silhouette = None
        if self._source is not None:
            self._source.close()
            self._source = None

    def _make_publishers(self, settings: CameraClientSettings) -> None:
        def publisher(kind: type, topic: str, qos: QoSProfile) -> Publisher:
            return self._hold(self.destroy_publisher, self.create_publisher(kind, topic, qos))

        self._silhouettes = publisher(CompressedImage, "silhouette/compressed", SILHOUETTE_PUBLISHER)
        self._infos = publisher(CameraInfo, "camera_info", SILHOUETTE_PUBLISHER)
        self._means = publisher(Image, "background/mean", LATCHED)
        self._raws = publisher(Image, "image_raw", SILHOUETTE_PUBLISHER) if settings.publish_raw else None
        self._previews = publisher(CompressedImage, "preview/compressed", RESULT) if settings.publish_preview else None

    def _hold(self, destroy: Callable[[T], object], entity: T) -> T:
        self._held.append((destroy, entity))
        return entity

    def _consumer_listens(self) -> bool:
        paced = self.settings.footage.rate == 0
        acknowledged = not paced or self.count_publishers(self.settings.footage.pace_topic) > 0
        if self._silhouettes.get_subscription_count() == 0 or not acknowledged:
            return False
        self._matched_s = self._matched_s or time.monotonic()
        return time.monotonic() >= self._matched_s + SETTLE_S

    # --- one frame, on the grab loop's thread --------------------------------------------------------------------

    def _on_frame(self, frame: Frame) -> None:
        began = time.perf_counter()
        if self._raws is not None:
            self._raws.publish(image_message(frame.image, frame.stamp_ns, self._frame_id))
        self._learn(frame)
        if self._pipeline is None:
            self.health.count("frames_without_background")
            return
        silhouette = self._pipeline.run(frame.image)
        self._publish(frame, silhouette)
        self.health.set("processing_ms", 1e3 * (time.perf_counter() - began))

    def _publish(self, frame: Frame, silhouette: Silhouette) -> None:
        stamp_ns, canvas = frame.stamp_ns, self._camera.undistorted_view().camera
        self._infos.publish(camera_info_message(canvas, stamp_ns, self._frame_id))
        self._silhouettes.publish(silhouette_message(silhouette.mask, stamp_ns, self._frame_id))
        self._publish_preview(frame, silhouette)
        self._last_silhouette = silhouette
        self.health.tick(stamp_ns if self._stamps_are_now() else None)
        for flag in silhouette.flags:
            self.health.count(f"{flag}_masks")

    def _publish_preview(self, frame: Frame, silhouette: Silhouette) -> None:
        now_ns = time.monotonic_ns()
        if self._previews is None or now_ns - self._last_preview_ns < 1e9 / self.settings.preview_rate:
            return
        self._last_preview_ns = now_ns
        outlined = outline(frame.image, silhouette.image_mask)
        self._previews.publish(preview_message(outlined, frame.stamp_ns, self._frame_id))

    def _stamps_are_now(self) -> bool:
        """Whether stamps follow the system clock, so that their age is a latency."""
        return self.settings.source != "footage" or self.settings.footage.rate == 1.0

    def _on_error(self, error: Exception) -> None:
        bad_frame = isinstance(error, InputError)
        self.health.count("bad_frames" if bad_frame else "failed_frames")
        text = str(error) if bad_frame else f"a frame failed: {error!r}"
        self.get_logger().error(text, throttle_duration_sec=5.0)

    def _on_acknowledgement(self, message: JointState) -> None:
        if self._source is not None:
            self._source.acknowledge(to_ns(message.header.stamp))

    # --- background ----------------------------------------------------------------------------------------------

    async def _on_learn(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._source is None or self._loop is None or self._loop.state is not GrabState.RUNNING:
            response.message = "no frames are coming: activate the camera first"
            return response
        if self._learning is not None:
            response.message = "learning already"
            return response
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        learning = LiveLearning(
            self.settings.background_frames, self._source.description, created=now, **self._source.details
        )
        future: Future = Future()
        self._learning = (learning, future)
        response.success, response.message = await future
        return response

    def _learn(self, frame: Frame) -> None:
        if self._learning is None:
            return
        learning, future = self._learning
        learning.add(frame.image)
        if not learning.done:
            return
        self._learning = None
        verdict = (False, learning.refusal)
        if learning.model is not None:
            verdict = (True, self._keep(learning.model))
        self.get_logger().info(verdict[1])
        future.set_result(verdict)

    def _keep(self, model: BackgroundModel) -> str:
        self._use_background(model)
        release_free_memory()
        text = describe(model)
        if not self.settings.background_file:
            return text
        try:
            model.save(self.settings.background_file)
        except InputError as error:
            return f"{text}; in use, but not saved: {error}"
        return f"{text}; saved to {self.settings.background_file}"

    def _use_background(self, model: BackgroundModel) -> None:
        settings: CameraClientSettings = self.settings
        self._pipeline = SilhouettePipeline(self._camera, model, settings.silhouette, settings.background_model)
        self._means.publish(image_message(np.rint(model.mean).astype(np.uint8), 0, self._frame_id))
        self.health.set("background", describe(model))

    def _cancel_learning(self, reason: str) -> None:
        learning, self._learning = self._learning, None
        if learning is not None:
            learning[0].cancel(reason)
            learning[1].set_result((False, learning[0].refusal))

    # --- diagnostics ---------------------------------------------------------------------------------------------

    def _report(self) -> None:
        if self._loop is None or self._source is None:
            return
        for name, count in self._source.counters.items():
            self.health.set(name, count)
        self.health.set("frames", self._loop.frames)
        self.health.set("missing_frames", self._loop.missing_frames)
        if self._last_silhouette is not None:
            self.health.set("mask_fraction", self._last_silhouette.foreground_fraction)
        level, text = self._state(self._loop)
        self.health.status(level, text)
        if self._loop.state in (GrabState.ENDED, GrabState.FAILED):
            self._cancel_learning(text)
            if text != self._said:
                self.get_logger().log(text, 20 if level == OK else 40)
        self._said = text

    def _state(self, loop: GrabLoop) -> tuple[bytes, str]:
        """Level and text of what the camera is doing."""
        if loop.state is GrabState.FAILED:
            return ERROR, str(loop.failure)
        if loop.state is not GrabState.RUNNING:
            return OK, f"{loop.state.value} after {loop.frames} frames" if loop.frames else loop.state.value
        if self._source is not None and self._source.lost:
            return ERROR, "the camera does not answer any more; suspend, stop and connect it again"
        silence_s = time.monotonic() - loop.last_frame_s
        if silence_s > SILENCE_S and self.settings.source != "footage":
            return WARN, f"no frame for {silence_s:.1f} s"
        if self._pipeline is None:
            return WARN, "no background: call ~/learn_background while the scene is empty"
        if self._last_silhouette is not None and self._last_silhouette.flags:
            return WARN, f"the mask is {' and '.join(self._last_silhouette.flags)}"
        return OK, loop.state.value


def outline(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The image at half size, BGR, with the mask's outline in green."""
    shown = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    cv2.drawContours(shown, contours, -1, (0, 255, 0), 2)
    return cv2.resize(shown, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable camera_client."""
    return_large_blocks()
    sys.exit(run_node(CameraNode, args))


if __name__ == "__main__":
    main()
