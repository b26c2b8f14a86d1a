"""The overload control among messages: answers of the tracker in, hull/thinning out."""

from __future__ import annotations

from time import monotonic_ns

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType

from mocap_packets.frame_set import FrameSet
from mocap_packets.people import Predictions
from sagoma_ros.intra_process import Delivery, PacketSubscription
from sagoma_ros.messages import THINNING_TOPIC, thinning_message
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import PREDICTIONS
from sagoma_ros.qos import LATCHED

from .thinning_control import ThinningControl

UPDATE_S = 0.1
# Thresholds: chosen with the simulated graphs of test_hull_thinning_control.py.
NO_TRACKER_NS = 1_000_000_000  # without an answer: the hull's products are the end of the graph


class NoOverloadControl:
    """Takes every frame set: for replays, and footage that is not played at its own rate."""

    summary = ""

    def deadline_ns(self, usual_ns: int) -> int:
        return usual_ns

    def close(self) -> None:
        pass

    def admits(self, camera: str, stamp_ns: int, now_ns: int) -> bool:
        return True

    def closed(self, frame_set: FrameSet, age_ns: int) -> None:
        pass

    def hand_over(self, stamp_ns: int) -> None:
        pass

    def finished(self, stamp_ns: int, carver_ns: int, slicer_ns: int) -> None:
        pass


class OverloadControl(NoOverloadControl):
    """The part of the hull node that thins out frame sets while the graph cannot process them all."""

    def __init__(self, node: SagomaNode) -> None:
        self._node, self._control = node, ThinningControl()
        self._publisher = node.create_publisher(DiagnosticArray, THINNING_TOPIC, LATCHED)
        self._answers = PacketSubscription(node, PREDICTIONS, self._on_answer)
        self._timer = node.create_timer(UPDATE_S, self._update, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._answered_ns = 0
        self._logged = ""

    def close(self) -> None:
        """Release timer and topics."""
        self._answers.close()
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)

    def deadline_ns(self, usual_ns: int) -> int:
        return self._control.deadline_ns(usual_ns)

    def admits(self, camera: str, stamp_ns: int, now_ns: int) -> bool:
        """Add a frame; False when the rule leaves its exposure out."""
        admitted = self._control.admits(camera, stamp_ns, now_ns)
        if not admitted:
            self._node.health.count("frames_thinned")
        return admitted

    def closed(self, frame_set: FrameSet, age_ns: int) -> None:
        """Add a frame set that has closed, ``age_ns`` after its exposure."""
        self._control.add_closed(frame_set.stamp_ns, frame_set.frames, age_ns, monotonic_ns())

    def hand_over(self, stamp_ns: int) -> None:
        """Add a set whose products the tracker gets now; any thread."""
        self._control.add_handed_over(stamp_ns, monotonic_ns())

    def finished(self, stamp_ns: int, carver_ns: int, slicer_ns: int) -> None:
        """Add what carver and slicer took for a set; any thread."""
        now_ns = monotonic_ns()
        self._control.add_work(0, carver_ns, now_ns)
        self._control.add_work(1, slicer_ns, now_ns)
        if now_ns - self._answered_ns > NO_TRACKER_NS:
            self._control.add_answer(stamp_ns, now_ns)

    def _on_answer(self, answer: Delivery[Predictions]) -> None:
        self._answered_ns = monotonic_ns()
        self._control.add_answer(answer.stamp_ns, self._answered_ns)

    def _update(self) -> None:
        rule = self._control.update(monotonic_ns())
        self.summary = summary = self._control.summary
        self._node.health.set("thinning", summary)
        if rule is not None:
            self._publisher.publish(thinning_message(rule, summary))
        kind = summary.partition(":")[0]
        if kind != self._logged:
            self._logged = kind
            self._node.get_logger().info(summary or "every frame is processed again")
