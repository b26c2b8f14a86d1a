"""Where the time of frame sets goes (`mocap_packets.latency`), to and from messages."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Int64MultiArray, MultiArrayDimension

from capture_rig.errors import InputError
from mocap_packets.latency import HullTimes, SetLatency

from .health import HOST
from .messages import key_values, to_stamp

TIMES_TOPIC, LATENCY_TOPIC = "hull/times", "mocap/latency"
_FIELDS = ("stamp_ns", "received_ns", "hull_ns")


def times_message(times: HullTimes, stamp_ns: int = 0, frame_id: str = "") -> Int64MultiArray:
    """Return the hull server's times of one set, in the order of the labelled dimension."""
    message = Int64MultiArray(data=[getattr(times, name) for name in _FIELDS])
    message.layout.dim = [MultiArrayDimension(label=" ".join(_FIELDS), size=len(_FIELDS), stride=len(_FIELDS))]
    return message


def read_times(message: Int64MultiArray, where: str) -> HullTimes:
    """Return the inverse of :func:`times_message`. Raises InputError for another number of times."""
    if len(message.data) != len(_FIELDS):
        remedy = "Run the same version of hull server and filter."
        raise InputError(f"{len(message.data)} times, not {len(_FIELDS)}", where=where, remedy=remedy)
    return HullTimes(*message.data)


def latency_message(latency: SetLatency) -> DiagnosticArray:
    """Return a set's age at each point, in milliseconds since its exposure, under its capture stamp."""
    ages = {f"{point}_ms": f"{age_ms:.3f}" for point, age_ms in latency.ages_ms().items()}
    status = DiagnosticStatus(
        level=DiagnosticStatus.OK, name="mocap: latency", hardware_id=HOST, values=key_values(ages)
    )
    message = DiagnosticArray(status=[status])
    message.header.stamp = to_stamp(latency.stamp_ns)
    return message
