"""The bag's own time on /clock while it is played, for nodes that follow simulated time (`use_sim_time`).

It is the time of recording, as ``ros2 bag play --clock`` gives it, and goes as fast as the bag is played.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from sagoma_ros.messages import to_stamp

from ..graph.topics import CLOCK_TOPIC, LOSSLESS

CLOCK_HZ = 100.0  # latencies by a clock of steps are that coarse: 10 ms, a set at 100 Hz


@dataclass
class Playback:
    """How the bag's time runs beside that of the player: it shows ``log_ns`` at ``at_s``, ``rate`` times as fast."""

    log_ns: int
    at_s: float
    rate: float

    def due_s(self, log_ns: int) -> float:
        """Return when the player's clock shows a time of the bag."""
        return self.at_s + (log_ns - self.log_ns) / 1e9 / self.rate

    def ticks(self, after_s: float, until_s: float, hz: float) -> Iterator[tuple[float, int]]:
        """Yield when the bag's clock ticks after one time of the player's, up to another, and what it then shows."""
        number = int((after_s - self.at_s) * hz + 1e-6) + 1
        while (tick_s := self.at_s + number / hz) < until_s:
            yield tick_s, self.log_ns + round((tick_s - self.at_s) * self.rate * 1e9)
            number += 1


class SimulatedClock:
    """Publishes /clock, ``hz`` times a second of the player's clock."""

    def __init__(self, node: Node, hz: float = CLOCK_HZ) -> None:
        self.hz = hz
        self._publisher = node.create_publisher(Clock, CLOCK_TOPIC, LOSSLESS)

    def show(self, time_ns: int) -> None:
        """Publish a time."""
        self._publisher.publish(Clock(clock=to_stamp(time_ns)))
