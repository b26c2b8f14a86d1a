"""mocap/latency: where the time of each frame set went, from exposure to joint state, while somebody listens."""

from __future__ import annotations

import threading

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from std_msgs.msg import Int64MultiArray

from capture_rig.errors import InputError
from mocap_packets.latency import HullTimes, LatencyMatcher, SetLatency
from sagoma_ros.intra_process import Delivery, LazyPublisher, PacketSubscription
from sagoma_ros.latency import LATENCY_TOPIC, TIMES_TOPIC, latency_message, read_times
from sagoma_ros.node import SagomaNode

LOOK_S = 0.5  # for somebody who listens


class LatencyReport:
    """Publishes one message a frame set; asks the hull server for its times only while somebody listens."""

    def __init__(self, node: SagomaNode) -> None:
        self._node, self._book, self._lock = node, LatencyMatcher(), threading.Lock()
        self._publisher = LazyPublisher(node, DiagnosticArray, LATENCY_TOPIC)
        self._times: PacketSubscription[HullTimes] | None = None
        self._timer = node.create_timer(LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def now_ns(self) -> int:
        """Return the time by the clock of stamps; 0, and nothing is asked, while nobody listens."""
        return 0 if self._times is None else self._node.get_clock().now().nanoseconds

    def answered(self, stamp_ns: int, fitted_ns: int) -> None:
        """Take note that a set's joint state is published now; ``fitted_ns``: when its fit had come."""
        if self._times is not None and fitted_ns:
            with self._lock:
                joined = self._book.answered(stamp_ns, fitted_ns, self.now_ns())
            self._publish(joined)

    def forget(self) -> None:
        """Drop sets that are known by half: stamps begin anew."""
        with self._lock:
            self._book.forget()

    def close(self) -> None:
        """Release topics and timer."""
        self._node.destroy_timer(self._timer)
        self._follow(False)
        self._publisher.close()

    def _look(self) -> None:
        self._follow(self._publisher.is_wanted)

    def _follow(self, heard: bool) -> None:
        if heard and self._times is None:
            self._times = PacketSubscription(self._node, Int64MultiArray, TIMES_TOPIC, self._on_times)
        elif not heard and self._times is not None:
            self._times.close()
            self._times = None

    def _on_times(self, delivery: Delivery[HullTimes]) -> None:
        try:
            times = delivery.packet or read_times(delivery.message, TIMES_TOPIC)
        except InputError as error:
            self._node.health.count("bad_times")
            self._node.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        with self._lock:
            joined = self._book.left_hull(times)
        self._publish(joined)

    def _publish(self, joined: SetLatency | None) -> None:
        if joined is not None:
            self._publisher.publish(latency_message, joined)
