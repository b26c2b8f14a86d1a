"""Silhouettes of all cameras in, frame sets out; cameras whose calibration is not the rig's are refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from time import monotonic_ns

from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import CameraInfo, CompressedImage

from capture_rig import CameraModel, InputError
from capture_rig.mask_levels import SHADOW_CANDIDATE
from mocap_packets.frame_set import FrameSet, FrameSetCollector
from sagoma_ros.health import ERROR, LOG_EVERY_S, WARN
from sagoma_ros.images import ABSENT, decode_silhouette
from sagoma_ros.messages import check_mask_bytes, read_message, same_but_for_stamp, to_ns
from sagoma_ros.node import SagomaNode
from sagoma_ros.qos import SILHOUETTE_RELIABLE_SUBSCRIBER, SILHOUETTE_SUBSCRIBER

from .hull_pipeline import Mask
from .hull_ros import calibration_mismatch
from .overload import ThinningControl
from .settings import NodeSettings

POLL_S = 0.05  # of the counters; a frame set's deadline is met to the millisecond
SHORTEST_POLL_NS = 200_000
# Thresholds: judgement, no measurement.
GIVE_UP_SETS = 5  # misses in a row after which sets no longer wait for a camera; packet loss causes fewer
MAX_OPEN_SETS = 8  # frame sets that wait for cameras
SILENT_AFTER_NS = 1_000_000_000
NEVER_NS = 1 << 62
COUNTER_KEYS = {name: name for name in ("frames", "restarts")}  # of those whose key is not frames_NAME
COUNTER_KEYS |= {name: f"sets_{name}" for name in ("complete", "incomplete")}


class SilhouetteInput:
    """Subscribes the silhouettes and camera_infos of a rig's cameras and forms frame sets between start and stop."""

    def __init__(
        self,
        node: SagomaNode,
        canvases: Mapping[str, CameraModel],
        thinning: ThinningControl,
        on_closed: Callable[[FrameSet[Mask]], None],
    ) -> None:
        """``canvases`` : of each camera; ``on_closed`` is called with every frame set, on the executor's thread."""
        self._node, self._canvases, self._thinning, self._on_closed = node, canvases, thinning, on_closed
        self._settings: NodeSettings = node.settings
        self.refused: dict[str, str] = {}  # camera: why
        self._collector: FrameSetCollector[Mask] | None = None  # None unless started
        self._judged_infos: dict[str, bytes] = {}  # the last camera_info of each camera
        self._heard_ns: dict[str, int] = {}
        self._last_stamp_ns = 0  # of the newest set that has closed
        self._polled_at_ns = 0
        reliable = self._settings.reliable or self._settings.resend
        qos = SILHOUETTE_RELIABLE_SUBSCRIBER if reliable else SILHOUETTE_SUBSCRIBER
        self._subscriptions = [
            node.create_subscription(kind, topic, partial(callback, camera, topic), qos, raw=True)
            for camera in canvases
            for kind, topic, callback in (
                (CompressedImage, f"{camera}/silhouette/compressed", self._on_silhouette),
                (CameraInfo, f"{camera}/camera_info", self._on_camera_info),
            )
        ]
        self._poll = node.create_timer(POLL_S, self._on_poll, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def start(self) -> None:
        """Start forming frame sets."""
        self._heard_ns = dict.fromkeys(self._canvases, monotonic_ns())
        self._last_stamp_ns = 0
        self._collector = FrameSetCollector(
            self._canvases,
            tolerance_ns=round(self._settings.tolerance_s * 1e9),
            deadline_ns=round(self._settings.deadline_s * 1e9),
            max_open=self._settings.queue_depth if self._settings.reliable else MAX_OPEN_SETS,
            give_up=GIVE_UP_SETS,
        )

    def stop(self) -> None:
        """Stop; the sets still open are dropped."""
        self._collector = None

    def close(self) -> None:
        """Release subscriptions and timer."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._node.destroy_timer(self._poll)

    def counters(self) -> dict[str, int]:
        """Return the counts of frames and sets by their keys in the diagnostics; empty unless started."""
        if self._collector is None:
            return {}
        counts = asdict(self._collector.counters)
        return {COUNTER_KEYS.get(name, f"frames_{name}"): count for name, count in counts.items()}

    def _on_silhouette(self, camera: str, topic: str, message: bytes) -> None:
        if self._collector is None:
            self._node.health.count("frames_while_suspended")
            return
        now_ns = monotonic_ns()
        self._heard_ns[camera] = now_ns
        if camera in self.refused:
            self._node.health.count("frames_refused")
            return
        try:
            check_mask_bytes(len(message), topic)
            image, canvas = read_message(message, CompressedImage), self._canvases[camera]
            stamp_ns = to_ns(image.header.stamp)
            if self._settings.reliable and image.format == ABSENT:
                self._dispatch(self._collector.add_absence(camera, stamp_ns, now_ns))
                return
            if not self._thinning.admits(stamp_ns, now_ns):
                self._node.health.count("frames_thinned")
                return
            mask = decode_silhouette(image, canvas.width, canvas.height, topic, candidates=SHADOW_CANDIDATE)
        except InputError as error:
            self._node.health.count("bad_images")
            self._node.health.set("last_bad_image", error)
            self._node.get_logger().warning(str(error), throttle_duration_sec=LOG_EVERY_S)
            return
        self._dispatch(self._collector.add(camera, stamp_ns, mask, now_ns))
        self._poll_at_deadline(now_ns)

    def _on_camera_info(self, camera: str, topic: str, message: bytes) -> None:
        """Refuse a camera whose images are not made with the rig's calibration, until they are."""
        if same_but_for_stamp(message, self._judged_infos.get(camera)):
            return
        try:
            check_mask_bytes(len(message), topic)
            mismatch = calibration_mismatch(read_message(message, CameraInfo), self._canvases[camera])
        except InputError as damage:
            self._node.health.count("bad_infos")
            self._node.get_logger().warning(str(damage), throttle_duration_sec=LOG_EVERY_S)
            return
        self._judged_infos[camera] = message
        if not mismatch:
            if self.refused.pop(camera, None):
                self._node.get_logger().info(f"{topic}: agrees with the rig file again")
            return
        if self.refused.get(camera) != mismatch:
            self.refused[camera] = mismatch
            error = InputError(
                f"the images of {camera} are refused: camera_info has {mismatch}",
                where=topic,
                remedy="Give camera client and hull server the same rig file.",
            )
            self._node.get_logger().error(str(error))
            self._node.health.set(f"refused_{camera}", error)
            self._show_refused()

    def _show_refused(self) -> None:
        self._node.health.status(ERROR, f"refused: {'; '.join(f'{c}: {why}' for c, why in self.refused.items())}")

    def _on_poll(self) -> None:
        if self._collector is None:
            return
        now_ns = monotonic_ns()
        self._collector.deadline_ns = self._thinning.deadline_ns(round(self._settings.deadline_s * 1e9))
        self._dispatch(self._collector.poll(now_ns))
        silent = [camera for camera, heard in self._heard_ns.items() if now_ns - heard > SILENT_AFTER_NS]
        self._node.health.set("silent", ",".join(silent))
        if self.refused:
            self._show_refused()
        elif silent:
            self._node.health.status(WARN, f"no silhouettes from {', '.join(silent)}")
        self._poll_at_deadline(now_ns)

    def _poll_at_deadline(self, now_ns: int) -> None:
        """Let the timer call when the next frame set is due, if that is sooner than it would."""
        if self._collector is None:
            return
        deadline_ns = self._collector.next_deadline_ns()
        due_ns = min(now_ns + round(POLL_S * 1e9), deadline_ns or NEVER_NS)
        if not now_ns < self._polled_at_ns <= due_ns:
            self._polled_at_ns = due_ns
            self._poll.timer_period_ns = max(due_ns - now_ns, SHORTEST_POLL_NS)
            self._poll.reset()

    def _dispatch(self, closed: list[FrameSet[Mask]]) -> None:
        for frame_set in closed:
            back_ns, self._last_stamp_ns = self._last_stamp_ns - frame_set.stamp_ns, frame_set.stamp_ns
            if back_ns > 0:
                self._node.get_logger().warning(f"stamps went back by {back_ns / 1e9:.3f} s: a new beginning")
            self._on_closed(frame_set)
