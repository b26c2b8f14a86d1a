"""The node of one camera PC: frames in, undistorted silhouettes with their camera_info out."""

from __future__ import annotations

import datetime
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeVar

import cv2
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import save_camera_info
from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from mocap_packets.thinning import FrameSelector
from sagoma_ros import mask_png
from sagoma_ros.health import LOG_EVERY_S
from sagoma_ros.images import read_support
from sagoma_ros.messages import HOST, LATENCY_TOPIC, THINNING_TOPIC, read_thinning, to_ns
from sagoma_ros.middleware import release_free_memory
from sagoma_ros.node import SagomaNode
from sagoma_ros.process import run_node
from sagoma_ros.qos import LATCHED, RESULT, graph_topic

from .background.model import BackgroundModel
from .background.training import KEY, PROGRESS_KEY, BackgroundTrainer
from .background.training_verdict import describe_background
from .camera_ros import CameraReport, CameraTopics, FootageClockTopic, camera_from_message
from .configuration import check_size, connect_source, load_calibration, unplaced_camera
from .frame_processor import FrameProcessor, warm_up_silhouettes
from .frame_source import POLL_S, REPORT_PERIOD_S, Frame, FrameSource
from .frame_stages_ros import FrameStages
from .settings import CameraClientSettings
from .sources.grab_loop import GrabLoop, GrabState
from .sources.topic_source_ros import TopicSource

T = TypeVar("T")

TRAINING_GRACE_S = 10.0  # a training goes on when the camera comes back sooner
SUPPORT_TOPIC = "silhouette/support"  # from the hull server; without it the client works as well
PROVENANCE = ("camera_serial", "camera_model", "exposure_us", "gain", "pixel_format", "temperature_c")  # of its details
CONSUMER_WAIT_S, CAMERAS_WAIT_S = 5.0, 300.0  # timeouts of footage: for a subscriber, for cameras that still start
SETTLE_S = 4 * POLL_S  # from the first match until both ends of a new connection know each other


class CameraNode(SagomaNode):
    """Publishes one silhouette for every frame, stamped with the frame's capture time."""

    Settings = CameraClientSettings

    def __init__(self, name: str = "camera_client", **options: object) -> None:
        super().__init__(name, **options)
        cv2.setNumThreads(1)
        self.source: FrameSource | None = None
        self.loop: GrabLoop | None = None
        self._stages: FrameStages | None = None
        self.processor: FrameProcessor | None = None
        self.trainer = BackgroundTrainer(self._use_background)
        self.selector = FrameSelector()  # which frames the hull server can take
        self._held = ExitStack()  # destroys everything made at configure
        self._matched_s: float | None = None
        self._footage_clock: FootageClockTopic | None = None
        self._awaited = 0  # how many cameras are waited for before it begins
        # these live as long as the node, so that every request is answered; learning in a callback group of its own,
        # because its answer takes seconds and must not hold up the timer and the acknowledgements
        self.create_service(
            Trigger, "~/learn_background", self._on_learn, callback_group=MutuallyExclusiveCallbackGroup()
        )
        self.create_service(SetCameraInfo, "set_camera_info", self._on_set_camera_info)

    # --- lifecycle ----------------------------------------------------------------------------------------------------

    def configure(self) -> None:
        settings: CameraClientSettings = self.settings
        name = settings.camera_name or self.get_namespace().rsplit("/", 1)[-1]
        known = self._calibration = load_calibration(settings, name)
        self.processor = FrameProcessor(known.camera, settings, known.volume, known.placed)
        self._topics = CameraTopics(
            self._publisher, f"{self.tf_prefix}{name}_optical", settings, to_calibrate=not known.placed
        )
        self._footage_clock = FootageClockTopic(self, name)
        self._awaited = len(load_rig(settings.rig_file).names) if settings.footage.wait_for_cameras else 0
        self.source = connect_source(settings, known, self._accept, self._footage_clock.shared, self._topic_source)
        mask_png.warm_up()
        if not self.source.shape:
            self.processor.check_background_file()
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # it reports while simulated time stands still, too
        self._hold(self.destroy_timer, self.create_timer(REPORT_PERIOD_S, self._on_report, clock=steady))
        self._subscribe(Image, SUPPORT_TOPIC, self._on_support, RESULT)
        if settings.source != "footage" or settings.footage.rate > 0:
            self._subscribe(DiagnosticArray, graph_topic(self, THINNING_TOPIC), self._on_thinning, LATCHED)
        else:
            self._subscribe(DiagnosticArray, graph_topic(self, LATENCY_TOPIC), self._on_acknowledgement, RESULT)
        info_file = settings.camera_info_file
        if info_file and not Path(info_file).exists() and settings.rig_file:
            self.get_logger().warning(f"{info_file} does not exist yet: the rig's intrinsics are in use")
        self.get_logger().info(f"camera {name}: {self.source.description}")

    def activate(self) -> None:
        assert self.source is not None and self.processor is not None and self._footage_clock is not None
        live, health, logger = self.settings.source != "footage", self.health, self.get_logger()
        self._matched_s = None
        self._report = CameraReport(health, logger, self.settings)
        self._stages = FrameStages(self.processor, self._topics, health, logger, self.settings)
        self.loop = GrabLoop(
            self.source,
            self._on_frame,
            self._stages.add_error,
            ready=lambda: live or self._consumer_listens(),
            ready_timeout_s=0.0 if live else (CAMERAS_WAIT_S if self._awaited else CONSUMER_WAIT_S),
        )
        if live:
            self.source.start()  # so that a camera that refuses fails the transition
        else:
            self._footage_clock.open()
        self.loop.start()

    def deactivate(self) -> None:
        if self._footage_clock is not None:
            self._footage_clock.close()
        if self.loop is not None:
            self.loop.stop()
            self.loop = None
        if self._stages is not None:
            self._stages.close()
        self.trainer.cancel("the camera was suspended")

    def cleanup(self) -> None:
        self._held.close()
        self.processor = self._stages = None
        if self.source is not None:
            self.source.close()
            self.source = None

    # --- connection ---------------------------------------------------------------------------------------------------

    def _topic_source(self) -> FrameSource:
        topic, channels, namespace = self.settings.topic, self.settings.channels, self.get_namespace()
        return TopicSource(topic, channels, namespace, self.context, self._use_lens)

    def _use_lens(self, info: CameraInfo) -> None:
        """Use the lens of a driver's camera_info instead of the rig's. Raises InputError."""
        assert self.processor is not None
        where = self.settings.topic.camera_info
        self.processor.use_camera(camera_from_message(info, self.processor.camera or self._blank(info), where))

    def _accept(self, source: FrameSource) -> None:
        """Check a new connection before its first frame, and take the background that fits it."""
        assert self.processor is not None
        for warning in source.warnings:
            self.get_logger().warning(warning)
        self.health.hardware_id = str(source.details.get("camera_serial") or HOST)
        if self.processor.camera is not None:
            check_size(source, self.processor.camera)
        warm_up_silhouettes(len(source.shape) == 3)
        try:
            taken = self.processor.use_shape(source.shape)
        except InputError as error:
            if self.settings.background:
                raise
            taken = False  # it would be replaced anyway
            self.get_logger().warning(f"the background learned last is not used: {error}")
        refused = self.processor.refuse_unfit_background(source.details)
        if refused is not None:
            self.health.set("background", "")
            self.get_logger().warning(f"the background is not used: {refused.line}")
        elif taken:
            self._show_background()
        release_free_memory()

    # --- what is made at configure, and destroyed at cleanup ----------------------------------------------------------

    def _publisher(self, kind: type, topic: str, qos: QoSProfile) -> Publisher:
        return self._hold(self.destroy_publisher, self.create_publisher(kind, topic, qos))

    def _subscribe(self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        self._hold(self.destroy_subscription, self.create_subscription(kind, topic, callback, qos))

    def _hold(self, destroy: Callable[[T], object], entity: T) -> T:
        self._held.callback(destroy, entity)
        return entity

    # --- when footage begins ------------------------------------------------------------------------------------------

    def _consumer_listens(self) -> bool:
        paced = self.settings.footage.rate == 0
        acknowledged = not paced or self.count_publishers(graph_topic(self, LATENCY_TOPIC)) > 0
        assert self._footage_clock is not None
        if not self._topics.has_listener or not acknowledged or self._footage_clock.cameras < self._awaited:
            return False
        self._matched_s = self._matched_s or time.monotonic()
        return time.monotonic() >= self._matched_s + SETTLE_S

    # --- frames, on the grab loop's thread; what the server says of them ----------------------------------------------

    def _on_frame(self, frame: Frame) -> None:
        assert self._stages is not None
        self.trainer.add(frame.image)
        if self.selector.keeps(frame.stamp_ns, time.monotonic_ns()):
            self._stages.begin(frame)
        else:
            self.health.count("frames_thinned")

    def _on_acknowledgement(self, message: DiagnosticArray) -> None:
        if self.source is not None:
            self.source.acknowledge(to_ns(message.header.stamp))

    def _on_thinning(self, message: DiagnosticArray) -> None:
        try:
            self.selector.update(read_thinning(message, THINNING_TOPIC), time.monotonic_ns())
        except InputError as error:
            self.health.count("bad_rules")
            self.get_logger().warning(str(error), throttle_duration_sec=LOG_EVERY_S)

    def _on_support(self, message: Image) -> None:
        if self.processor is None or self.processor.camera is None:
            return
        canvas = self.processor.camera.undistorted_view().camera
        try:
            self.processor.add_support(read_support(message, canvas.name, canvas.width, SUPPORT_TOPIC))
        except InputError as error:
            self.health.count("bad_reports")
            self.get_logger().warning(str(error), throttle_duration_sec=LOG_EVERY_S)

    # --- services: background training, calibration -------------------------------------------------------------------

    async def _on_learn(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        source, loop, processor, settings = self.source, self.loop, self.processor, self.settings
        if source is None or loop is None or processor is None or loop.state is not GrabState.RUNNING:
            response.message = "no frames are coming: activate the camera first"
            return response
        if source.lost:
            reason = source.connection.reason if source.connection is not None else ""
            response.message = f"no frames are coming: {reason or 'the camera is away'}"
            return response
        about = {key: source.details[key] for key in PROVENANCE if key in source.details}
        about["created"] = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        wanted = settings.background_frames, source.description, settings.background_file
        learned = Future()
        try:
            over = self.trainer.begin(*wanted, processor.background, about)
        except InputError as error:
            response.message = str(error)
            return response
        over.add_done_callback(lambda over: learned.set_result(over.result()))
        report = await learned
        response.success, response.message = report.success, report.text
        self.health.set(KEY, report.to_json())
        self.health.set(PROGRESS_KEY, self.trainer.progress)
        self.health.publish()  # before the answer, for programs that wait for both
        self.get_logger().info(response.message)
        return response

    def _use_background(self, model: BackgroundModel) -> BackgroundModel:
        assert self.processor is not None
        used = self.processor.use_learned_background(model)
        self._show_background()
        release_free_memory()
        return used

    def _show_background(self) -> None:
        assert self.processor is not None and self.processor.background is not None
        self._topics.publish_background(self.processor.background)
        self.health.set("background", describe_background(self.processor.background))

    def _on_set_camera_info(
        self, request: SetCameraInfo.Request, response: SetCameraInfo.Response
    ) -> SetCameraInfo.Response:
        if self.processor is None:
            response.status_message = "not configured: configure the node first"
            return response
        try:
            camera = camera_from_message(request.camera_info, self.processor.camera or self._blank(request.camera_info))
            path = self.settings.camera_info_file
            if path:
                save_camera_info(path, camera)
            self.processor.use_camera(camera)
        except InputError as error:
            response.status_message = str(error)
            return response
        response.success = True
        response.status_message = f"in use; saved to {path}" if path else "in use until cleanup: set camera_info_file"
        self.get_logger().info(f"calibration by set_camera_info: {response.status_message}")
        return response

    def _blank(self, info: CameraInfo) -> CameraModel:
        """Return this camera before its intrinsics are known: of the source's size, or of any size while it is away."""
        shape = self.source.shape if self.source is not None else ()
        height, width = shape[:2] or (info.height, info.width)
        return unplaced_camera(self._calibration.name, width, height)

    # --- report -------------------------------------------------------------------------------------------------------

    def _on_report(self) -> None:
        source, loop, processor, stages = self.source, self.loop, self.processor, self._stages
        if loop is None or source is None or processor is None or stages is None:
            return
        self.health.set(PROGRESS_KEY, self.trainer.progress)
        self._report.update(processor, source, loop, stages.last, placed=self._calibration.placed)
        connection = source.connection
        if loop.state in (GrabState.ENDED, GrabState.FAILED):
            self.trainer.cancel(f"{loop.state.value} {loop.reason}".strip())
        elif connection is not None and connection.state.away and connection.down_s > TRAINING_GRACE_S:
            self.trainer.cancel(f"the camera went away ({connection.reason})")


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable camera_client."""
    sys.exit(run_node(CameraNode, args))


if __name__ == "__main__":
    main()
