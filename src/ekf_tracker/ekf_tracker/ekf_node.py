"""The EKF as a lifecycle node: 15 measured points in, the body's state out, one answer to every set of points."""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Callable
from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from capture_rig.errors import InputError
from mocap_packets.fit import NOTHING_SEEN, ReferencePoints
from mocap_packets.state import BodyState, NoState, Prediction, Tracking
from sagoma_ros.exchange import Delivery, HeardPublisher, PacketPublisher, PacketSubscription
from sagoma_ros.health import ERROR, OK, WARN
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import (
    Text,
    covariance_message,
    joint_state_message,
    packet_cloud,
    prediction_message,
    read_reference_points,
)
from sagoma_ros.process import run_node
from sagoma_ros.qos import LATCHED, RESULT
from stick_figure.body_file import load_body, parse_body
from stick_figure.skeleton import ANGLE_NAMES, TANGENT_NAMES

from .filter import ArticulatedEkf, warm_up
from .humans_ros import Humans, NoHumans, make_humans
from .latency_ros import LatencyReport
from .settings import EkfNodeSettings
from .state import POSE
from .state_ros import skeleton_markers, state_message, torso_message

POINTS_TOPIC, BODY_TOPIC = "icp/reference_points", "icp/body"
NS_PER_S = 1_000_000_000
RESTART_AFTER_SETS = 10  # with stamps of the past, in a row: the clock was set back
HEALTH = {Tracking.ACQUIRING: WARN, Tracking.TRACKING: OK, Tracking.DOUBTFUL: WARN, Tracking.LOST: ERROR}


class EkfNode(SagomaNode):
    """icp/reference_points (and icp/body) to mocap/*; ekf/prediction is published last, once for every set."""

    Settings = EkfNodeSettings

    def __init__(self, **options: object) -> None:
        super().__init__("ekf_tracker", **options)
        self._closing: list[Callable[[], object]] = []  # releases what configure has opened
        self._answering = threading.RLock()  # points may come on the tracker's thread, body and requests on ours
        self._humans: Humans = NoHumans()
        self._filter = ArticulatedEkf()
        self._active = False

    def configure(self) -> None:
        """Load the body if a file names it, compile the filter, open topics."""
        self._waiting: deque[tuple[int, ReferencePoints, int]] = deque()
        self._body_text = ""
        self._backwards, self._next_skeleton_ns = 0, 0
        body = load_body(self.settings.body_file) if self.settings.body_file else None
        self._filter = ArticulatedEkf(body, self.settings.filter)
        warm_up()
        self._humans = make_humans(self, self.settings.publish_humans, self.settings.body_id, self.settings.frame_id)
        self._open_publishers()
        self._latency = LatencyReport(self)
        self._closing.append(self._latency.close)
        service = self.create_service(Trigger, "~/reset", self._on_reset)
        wall_time = Clock(clock_type=ClockType.STEADY_TIME)  # a person waits, whatever time the sets are of
        wait_s = max(self.settings.body_wait_s, 1e-3)
        self._body_timeout = self.create_timer(wait_s, self._answer_waiting, clock=wall_time, autostart=False)
        self._closing += [partial(self.destroy_service, service), partial(self.destroy_timer, self._body_timeout)]
        if body is None:
            self._closing.append(PacketSubscription(self, String, BODY_TOPIC, self._on_body, LATCHED).close)
        self._closing.append(PacketSubscription(self, PointCloud2, POINTS_TOPIC, self._on_points).close)

    def activate(self) -> None:
        """Answer sets from now on."""
        with self._answering:
            self._active = True

    def deactivate(self) -> None:
        """Ignore sets from now on; the state is kept."""
        with self._answering:
            self._active = False

    def cleanup(self) -> None:
        """Close topics, forget body and state."""
        for close in self._closing:
            close()
        self._closing.clear()
        with self._answering:
            self._humans.close()
            self._humans, self._filter = NoHumans(), ArticulatedEkf()

    def _open_publishers(self) -> None:
        def publisher(kind: type, topic: str) -> HeardPublisher:
            opened = HeardPublisher(self, kind, topic)
            self._closing.append(opened.close)
            return opened

        self._joint_states = publisher(JointState, "mocap/joint_states")
        self._torso = publisher(PoseWithCovarianceStamped, "mocap/torso")
        self._joint_covariance = publisher(Float64MultiArray, "mocap/joint_covariance")
        self._reference_points = publisher(PointCloud2, "mocap/reference_points")
        self._skeleton = publisher(MarkerArray, "mocap/skeleton")
        self._state = publisher(DiagnosticStatus, "mocap/state")
        self._prediction = PacketPublisher[Prediction](self, JointState, "ekf/prediction", _prediction_message)
        self._closing.append(self._prediction.close)

    def _on_body(self, delivery: Delivery[Text]) -> None:
        text = (delivery.packet or delivery.message).data
        with self._answering:
            if text == self._body_text:
                return
            try:
                body = parse_body(text, BODY_TOPIC)
            except InputError as error:
                self._drop("bad_body", error)
                return
            self._body_text = text
            self._filter.follow(body)
            self.get_logger().info(f"body of {BODY_TOPIC}: stature {body.stature:.2f} m")
            self._answer_waiting()

    def _on_points(self, points: Delivery[ReferencePoints]) -> None:
        with self._answering:
            if self._active:
                self._take(points.stamp_ns, self._read(points), self._latency.now_ns())

    def _take(self, stamp_ns: int, measured: ReferencePoints, fitted_ns: int) -> None:
        if self._filter.body is None and measured.visible.any():  # the body was measured with this set, and will come
            self._waiting.append((stamp_ns, measured, fitted_ns))
            if len(self._waiting) > RESULT.depth:
                self._answer(*self._waiting.popleft())
            self._body_timeout.reset()
            return
        self._answer(stamp_ns, measured, fitted_ns)

    def _answer_waiting(self) -> None:
        with self._answering:
            self._body_timeout.cancel()
            while self._waiting:
                self._answer(*self._waiting.popleft())

    def _read(self, delivery: Delivery[ReferencePoints]) -> ReferencePoints:
        """Points, covariances, visibility; of a cloud that cannot be used, that nothing was seen."""
        try:
            if delivery.frame_id != self.settings.frame_id:
                remedy = f"Publish in '{self.settings.frame_id}', or set the parameter frame_id."
                raise InputError(f"frame_id is '{delivery.frame_id}'", where=POINTS_TOPIC, remedy=remedy)
            if delivery.packet is not None:
                return delivery.packet.as_sent()
            return read_reference_points(delivery.message, POINTS_TOPIC)
        except InputError as error:
            self._drop("bad_points", error)
            return NOTHING_SEEN

    def _answer(self, stamp_ns: int, measured: ReferencePoints, fitted_ns: int) -> None:
        """Publish the one answer that every set gets."""
        result = self._filtered(stamp_ns, measured)
        if isinstance(result, BodyState) and result.tracking != Tracking.LOST:
            self._publish_body(result)
        else:
            self._humans.absent(stamp_ns)
        self._state.publish(state_message, result, self.get_fully_qualified_name())
        self._prediction.publish(result.prediction, stamp_ns, self.settings.frame_id)
        self._latency.answered(stamp_ns, fitted_ns)
        self.health.status(HEALTH[result.tracking], f"{result.tracking}: {result.reason}")
        self.health.tick(stamp_ns)

    def _filtered(self, stamp_ns: int, measured: ReferencePoints) -> BodyState | NoState:
        if self._filter.body is None:
            self.health.count("without_body")
        if self._filter.is_past(stamp_ns):
            return self._out_of_order(stamp_ns)
        self._backwards = 0
        try:
            return self._filter.step(stamp_ns, *measured)
        except InputError as error:
            self._drop("bad_points", error)
            return self._filter.step(stamp_ns, *NOTHING_SEEN)

    def _out_of_order(self, stamp_ns: int) -> NoState:
        self._backwards += 1
        remedy = "Send each frame set once, in stamp order."
        self._drop("stamp_back", InputError(f"stamp {stamp_ns} ns is of the past", where=POINTS_TOPIC, remedy=remedy))
        if self._backwards >= RESTART_AFTER_SETS:
            self.get_logger().warning(f"{self._backwards} sets in a row are of the past: starting anew")
            self._start_anew()
        return NoState(stamp_ns, "stamp is not later than the last set's")

    def _publish_body(self, state: BodyState) -> None:
        frame, body = self.settings.frame_id, self._filter.body
        assert body is not None
        self._joint_states.publish(joint_state_message, ANGLE_NAMES, state.angles, state.rates, state.stamp_ns, frame)
        self._torso.publish(torso_message, state, frame)
        self._joint_covariance.publish(covariance_message, TANGENT_NAMES, state.covariance[POSE, POSE])
        self._reference_points.publish(packet_cloud, state.reference_points, state.stamp_ns, frame)
        if state.stamp_ns >= self._next_skeleton_ns:
            rate = self.settings.skeleton_rate_hz
            self._next_skeleton_ns = state.stamp_ns + (round(NS_PER_S / rate) if rate else 0)
            with_ellipsoids = self.settings.skeleton_covariance
            self._skeleton.publish(skeleton_markers, state, body, frame, with_ellipsoids)
        self._humans.present(state, body)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._start_anew()
        response.success, response.message = True, "the next set with a visible torso starts anew"
        return response

    def _start_anew(self) -> None:
        with self._answering:
            self._backwards, self._next_skeleton_ns = 0, 0
            self._filter.reset()

    def _drop(self, counter: str, error: InputError) -> None:
        self.health.count(counter)
        self.get_logger().warning(str(error), throttle_duration_sec=5.0)


def _prediction_message(prediction: Prediction, stamp_ns: int, frame_id: str) -> JointState:
    return prediction_message(prediction, frame_id)


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable ``ekf_tracker``."""
    sys.exit(run_node(EkfNode, args))


if __name__ == "__main__":
    main()
