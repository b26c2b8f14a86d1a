"""The node: centerline, voxels and contour rays of the hull in; reference points and fit out, one for every set."""

from __future__ import annotations

import sys
import threading
import time
from typing import TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from mocap_packets.fit import Fit, ReferencePoints
from mocap_packets.hull import NO_CONTOUR_RAYS, NO_VOXELS, Centerline, ContourRays, HullProducts, VoxelSamples
from mocap_packets.state import Prediction
from sagoma_ros.exchange import Delivery, HeardPublisher, PacketPublisher, PacketSubscription
from sagoma_ros.health import OK, WARN
from sagoma_ros.messages import key_values, to_stamp
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import Text, packet_cloud, read_finite, read_prediction
from sagoma_ros.process import run_node
from sagoma_ros.qos import LATCHED
from sagoma_ros.worker import Mailbox, Worker
from stick_figure.body import Body
from stick_figure.body_file import format_body

from .icp_ros import FilterFeedback, SaveBodyService, SavedBody
from .monitor.evidence import PART_NAMES
from .settings import IcpNodeSettings
from .tracker import ACQUIRING, TRACKING, IcpTracker, make_tracker, sight_of, warm_up

CLOUDS_KEPT = 8
T = TypeVar("T", Centerline, VoxelSamples, ContourRays)


class IcpNode(SagomaNode):
    """Fits the stick figure to every centerline, in stamp order, on a thread of its own."""

    Settings = IcpNodeSettings

    def __init__(self, name: str = "icp_tracker", **options: object) -> None:
        super().__init__(name, **options)
        self._tracker: IcpTracker | None = None
        self._worker: Worker[Delivery[Centerline]] | None = None
        self._subscriptions_held: list[PacketSubscription] = []
        self._publishers_held: list[PacketPublisher | HeardPublisher] = []
        self._lock = threading.Lock()  # tracker and last stamp: worker against ~/reset
        self._last_stamp_ns = -1
        self._state = ""
        self._published_body: Body | None = None

    # --- lifecycle -----------------------------------------------------------------------------------------------

    def configure(self) -> None:
        settings: IcpNodeSettings = self.settings
        self._tracker = make_tracker(settings, sight_of(settings))
        warm_up(settings)
        self._points_publisher = PacketPublisher[ReferencePoints](
            self, PointCloud2, "icp/reference_points", packet_cloud
        )
        self._fit_publisher = HeardPublisher(self, DiagnosticArray, "icp/fit")
        self._body_publisher = PacketPublisher[Text](self, String, "icp/body", Text.to_message, LATCHED)
        self._publishers_held = [self._points_publisher, self._fit_publisher, self._body_publisher]
        self._reset_service = self.create_service(Trigger, "~/reset", self._on_reset)
        self._save_body = SaveBodyService(self, settings.bodies)

    def activate(self) -> None:
        settings: IcpNodeSettings = self.settings
        self._feedback = FilterFeedback(settings.prediction_wait_s)
        self._voxels: Mailbox[Delivery[VoxelSamples]] = Mailbox(CLOUDS_KEPT, settings.voxels_wait_s)
        self._contour_rays: Mailbox[Delivery[ContourRays]] = Mailbox(CLOUDS_KEPT, settings.voxels_wait_s)
        self._last_stamp_ns = -1
        self._worker = Worker(
            "icp",
            self._process,
            settings.queue_depth,
            on_drop=lambda: self.health.count("dropped_sets"),
            on_error=self._on_error,
        )
        self._subscriptions_held = [
            PacketSubscription(self, PointCloud2, "hull/centerline", self._on_centerline),
            PacketSubscription(self, PointCloud2, "hull/voxels", self._on_voxels),
            PacketSubscription(self, PointCloud2, "hull/contour_rays", self._on_contour_rays),
            PacketSubscription(self, JointState, "ekf/prediction", self._on_prediction),
        ]

    def deactivate(self) -> None:
        for subscription in self._subscriptions_held:
            subscription.close()
        self._subscriptions_held = []
        if self._worker is not None:
            self._feedback.mailbox.close()
            self._voxels.close()
            self._contour_rays.close()
            self._worker.close()
            self._worker = None

    def cleanup(self) -> None:
        for publisher in self._publishers_held:
            publisher.close()
        if self._publishers_held:
            self.destroy_service(self._reset_service)
            self._save_body.close()
        self._publishers_held = []
        self._published_body = None
        self._tracker = None

    # --- callbacks -----------------------------------------------------------------------------------------------

    def _on_centerline(self, line: Delivery[Centerline]) -> None:
        if self._worker is not None:
            self._worker.put(line)

    def _on_voxels(self, voxels: Delivery[VoxelSamples]) -> None:
        if self._tracker is not None and self._tracker.needs_voxels:
            self._voxels.put(voxels.stamp_ns, voxels)

    def _on_contour_rays(self, rays: Delivery[ContourRays]) -> None:
        if self._tracker is not None and self._tracker.needs_contour_rays:
            self._contour_rays.put(rays.stamp_ns, rays)

    def _on_prediction(self, prediction: Delivery[Prediction]) -> None:
        if prediction.packet is not None:
            self._feedback.put(prediction.packet.as_sent())
            return
        try:
            self._feedback.put(read_prediction(prediction.message, self.resolve_topic_name("ekf/prediction")))
        except InputError as error:
            self._refuse("bad_predictions", error)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            if self._tracker is not None:
                self._tracker.reset()
            self._last_stamp_ns = -1
        response.success = True
        response.message = f"looking for the first pose again ({self.settings.initial_pose.source})"
        return response

    # --- one frame set, on the worker's thread -------------------------------------------------------------------

    def _process(self, centerline: Delivery[Centerline]) -> None:
        stamp_ns = centerline.stamp_ns
        if stamp_ns <= self._last_stamp_ns:
            self.health.count("backward_stamps")
            return
        line = self._read(centerline, Centerline, "centerline")
        seen = HullProducts(stamp_ns, line, self._voxels_of(stamp_ns), self._contour_rays_of(stamp_ns))
        prediction = self._feedback.after_previous_set()
        with self._lock:
            if self._tracker is None:
                return
            self._last_stamp_ns = stamp_ns
            began = time.perf_counter()
            result = self._tracker.step(seen, prediction)
            body = self._tracker.body
            self.health.set("fit_ms", 1e3 * (time.perf_counter() - began))
        self._feedback.asked(stamp_ns)
        self._publish_body(stamp_ns, body)
        self._publish(result, centerline.frame_id)

    def _voxels_of(self, stamp_ns: int) -> VoxelSamples:
        """Return the set's voxels, if they are wanted and there."""
        if self._tracker is None or not self._tracker.needs_voxels:
            return NO_VOXELS
        voxels = self._voxels.take(stamp_ns)
        if voxels is None:
            self.health.count("sets_without_voxels")
            return NO_VOXELS
        return self._read(voxels, VoxelSamples, "voxels")

    def _contour_rays_of(self, stamp_ns: int) -> ContourRays:
        """Return the set's contour rays, if they are wanted and there."""
        if self._tracker is None or not self._tracker.needs_contour_rays:
            return NO_CONTOUR_RAYS
        rays = self._contour_rays.take(stamp_ns)
        if rays is None:
            self.health.count("sets_without_contour_rays")
            return NO_CONTOUR_RAYS
        return self._read(rays, ContourRays, "contour_rays")

    def _read(self, delivery: Delivery[T], kind: type[T], name: str) -> T:
        """A packet as it was sent; of a cloud, its rows of finite numbers, none when it is damaged: the set still gets
        its answer, so that nobody waits for it."""
        if delivery.packet is not None:
            return delivery.packet.as_sent()
        try:
            packet, dropped = read_finite(delivery.message, kind, self.resolve_topic_name(f"hull/{name}"))
        except InputError as error:
            self._refuse(f"bad_{name}", error)
            return kind.from_table(np.empty(0, kind.LAYOUT))
        if dropped:
            self.health.count("dropped_points" if name == "centerline" else f"dropped_{name}", dropped)
        return packet

    def _publish_body(self, stamp_ns: int, body: Body | None) -> None:
        """The body as latched YAML, before the first points that were fitted with it: the filter takes the same."""
        if body is not None and body is not self._published_body:
            self._body_publisher.publish(Text(format_body(body, source="icp_tracker")), stamp_ns, "")
            self._published_body = body
            refined = self._tracker.refined_body if self._tracker is not None else None
            known = refined is not None and refined.keyframes > 0  # else thickness is but the average's
            self._save_body.keep(SavedBody(stamp_ns, body, refined.girths if refined and known else None))

    def _publish(self, result: Fit, frame_id: str) -> None:
        self._points_publisher.publish(result.reference_points, result.stamp_ns, frame_id)
        self._fit_publisher.publish(fit_message, result, self.settings.method)
        self.health.tick(result.stamp_ns)
        self.health.set("late_predictions", self._feedback.mailbox.timeouts)
        summary = f"{result.state}: {result.reason}" if result.reason else result.state
        self.health.status(OK if result.state == TRACKING else WARN, summary)
        # while looking for a first pose every new reason tells the person what to do; later ones hold changing figures
        told = summary if result.state == ACQUIRING else result.state
        if told != self._state:
            self._state = told
            self.get_logger().info(summary)
        if result.recovered:
            self.health.count("recoveries")
            self.get_logger().info(f"found again: {result.recovered}")

    def _refuse(self, counter: str, error: InputError) -> None:
        self.health.count(counter)
        self.get_logger().warning(str(error), throttle_duration_sec=5.0)

    def _on_error(self, error: Exception) -> None:
        self.health.count("failed_sets")
        self.get_logger().error(f"a frame set failed: {error!r}", throttle_duration_sec=5.0)


def fit_message(result: Fit, method: str) -> DiagnosticArray:
    """Return how the fit of one set went, for icp/fit. Holds no clock times, so equal inputs give equal bytes."""
    values: dict[str, object] = {"state": result.state, "method": method, "started_from": result.started_from}
    if result.solution is not None:
        values |= {
            "rms_mm": f"{1e3 * result.solution.rms_m:.3f}",
            "points": result.solution.points,
            "inliers": result.solution.inliers,
            "iterations": result.solution.iterations,
            "converged": result.solution.converged,
        }
    values |= {"visible": int(result.visible.sum()), "dropped_points": result.dropped_points}
    if result.solution is not None:
        quality = result.quality
        values |= {"explained": f"{quality.explained:.3f}", "recovered": result.recovered}
        values |= dict(zip(PART_NAMES, quality.parts, strict=True))
        if quality.hypothesis_margin is not None:
            values["hypothesis_margin"] = f"{quality.hypothesis_margin:.1f}"
    trusted = result.solution is not None and result.state == TRACKING
    status = DiagnosticStatus(
        level=DiagnosticStatus.OK if trusted else DiagnosticStatus.WARN,
        name="icp_tracker: fit",
        message=result.reason or "fitted",
        values=key_values(values),
    )
    message = DiagnosticArray(status=[status])
    message.header.stamp = to_stamp(result.stamp_ns)
    return message


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable icp_tracker."""
    sys.exit(run_node(IcpNode, args))


if __name__ == "__main__":
    main()
