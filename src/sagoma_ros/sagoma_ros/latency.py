"""mocap/latency: where the time of a frame set went, from exposure to joint state."""

from __future__ import annotations

from dataclasses import asdict

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from mocap_packets.table import SetAges

from .health import HOST
from .messages import key_values, to_stamp

LATENCY_TOPIC = "mocap/latency"


def latency_message(stamp_ns: int, ages: SetAges) -> DiagnosticArray:
    """Return a set's age at each point, in milliseconds since its exposure, under its capture stamp."""
    values = key_values({f"{point}_ms": f"{age_ns / 1e6:.3f}" for point, age_ns in asdict(ages).items()})
    message = DiagnosticArray(
        status=[DiagnosticStatus(level=DiagnosticStatus.OK, name="mocap: latency", hardware_id=HOST, values=values)]
    )
    message.header.stamp = to_stamp(stamp_ns)
    return message
