"""Stamps as whole nanoseconds (equal means the same instant) and named values of messages; latencies and thinning;
limits of messages, and reading them from their bytes.

Larger messages are refused and counted before memory is allocated for them: a subscription with ``raw=True`` delivers a
message's bytes. The middleware keeps up to a queue (`qos.DEPTH`) of messages of any size; these limits bound the memory
of the nodes.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypeVar

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import deserialize_message

from capture_rig.errors import InputError
from capture_rig.stamps import NS_PER_S
from mocap_packets.people import AnsweredSet
from mocap_packets.table import AGE_POINTS, SetAges
from mocap_packets.thinning import FrameDecimation

HOST = socket.gethostname()
T = TypeVar("T")


def to_ns(stamp: Time) -> int:
    """Nanoseconds since the epoch of a message stamp."""
    return stamp.sec * NS_PER_S + stamp.nanosec


def to_stamp(ns: int) -> Time:
    """Message stamp of ``ns`` nanoseconds since the epoch."""
    seconds, nanoseconds = divmod(ns, NS_PER_S)
    return Time(sec=seconds, nanosec=nanoseconds)


def key_values(values: Mapping[str, object]) -> list[KeyValue]:
    """Values by name, as text, for a DiagnosticStatus."""
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by their keys."""
    return {pair.key: pair.value for pair in status.values}


# mocap/latency --------------------------------------------------------------------------------------------------------


LATENCY_TOPIC = "mocap/latency"
"""Acknowledges a frame set: last of its messages, one to each set, with the time that each stage took."""


def latency_message(answered: AnsweredSet) -> DiagnosticArray:
    """Return a set's age at each point, in milliseconds since its exposure, under its capture stamp."""
    ages_ms = {f"{point}_ms": f"{age_ns / 1e6:.3f}" for point, age_ns in asdict(answered.ages).items()}
    values = key_values(ages_ms if answered.ages.hull else {})
    message = DiagnosticArray(
        status=[DiagnosticStatus(level=DiagnosticStatus.OK, name="mocap: latency", hardware_id=HOST, values=values)]
    )
    message.header.stamp = to_stamp(answered.stamp_ns)
    return message


def read_latency(message: DiagnosticArray, where: str) -> AnsweredSet:
    """Return the inverse of :func:`latency_message`, to a microsecond. Raises InputError for anything else."""
    values = values_of(message.status[0]) if message.status else {}
    try:
        ages = [round(1e6 * float(values[f"{point}_ms"])) for point in AGE_POINTS] if values else []
    except (KeyError, ValueError, OverflowError) as error:
        what, remedy = f"is no latency of a frame set ({error!r})", "Run the same version of all nodes."
        raise InputError(what, where=where, remedy=remedy) from None
    return AnsweredSet(to_ns(message.header.stamp), SetAges(*ages))


# the rule of thinning -------------------------------------------------------------------------------------------------


THINNING_TOPIC = "hull/thinning"
"""Of the rule by which all clients thin out (`mocap_packets.thinning`), in a message that people can read."""
_INTEGERS = ("resume_ns", "phase_ns", "keep", "of")


def thinning_message(rule: FrameDecimation, text: str = "") -> DiagnosticArray:
    """Return a rule as one status, stamped with the first capture stamp that it holds for; ``text`` : the reason."""
    thins = rule.keep < rule.of
    status = DiagnosticStatus(
        level=DiagnosticStatus.WARN if thins else DiagnosticStatus.OK,
        name="hull_server: thinning",
        hardware_id=HOST,
        message=text or ("thinned" if thins else "every frame"),
        values=key_values({name: getattr(rule, name) for name in _INTEGERS} | {"period_ns": f"{rule.period_ns:.3f}"}),
    )
    message = DiagnosticArray(status=[status])
    message.header.stamp = to_stamp(rule.from_ns)
    return message


def read_thinning(message: DiagnosticArray, where: str) -> FrameDecimation:
    """Return the inverse of :func:`thinning_message`. Raises InputError for a message that holds no rule."""
    try:
        values = values_of(message.status[0])
        numbers = {name: int(values[name]) for name in _INTEGERS}
        rule = FrameDecimation(from_ns=to_ns(message.header.stamp), period_ns=float(values["period_ns"]), **numbers)
    except (IndexError, KeyError, ValueError) as error:
        remedy = "Run the same version on camera PCs and server."
        raise InputError(f"is no rule of thinning: {error!r}", where=where, remedy=remedy) from error
    if not (0 < rule.keep <= rule.of and 0.0 < rule.period_ns < math.inf):
        remedy = "Restart the hull server."
        raise InputError(f"keeps {rule.keep} of {rule.of} every {rule.period_ns} ns", where=where, remedy=remedy)
    return rule


# sizes ----------------------------------------------------------------------------------------------------------------

MOST_CLOUD_BYTES = 8 << 20  # a hull of 5 mm voxels on five cameras sends less than 1 MB
MOST_TEXT_BYTES = 1 << 20  # the bodies of 250 persons have a quarter of it
MOST_JOINTS = 10_000  # 250 persons have 24 numbers each
MOST_MASK_BYTES = 4 << 20  # a mask of noise of 20 megapixels at one bit a pixel; those of people have 2 to 6 KB
AFTER_STAMP = 4 + 8  # bytes: encapsulation, and the stamp of a header (CDR: OMG DDS-XTypes 1.3, 7.4.3)
_COUNTED = {"position": MOST_JOINTS, "name": MOST_JOINTS, "joint_names": MOST_JOINTS, "transforms": MOST_JOINTS}


def oversize(message: Any) -> str:
    """Name the part of a message that is larger than any node sends; empty for none."""
    data = getattr(message, "data", ())
    most = MOST_TEXT_BYTES if isinstance(data, str) else MOST_CLOUD_BYTES
    size = len(data) * getattr(data, "itemsize", 1)
    if size > most:
        return f"{size} bytes of data, at most {most} are taken"
    for name, most in _COUNTED.items():
        if len(getattr(message, name, ())) > most:
            return f"{len(getattr(message, name))} entries of {name}, at most {most} are taken"
    return ""


def check_mask_bytes(count: int, where: str) -> None:
    """Raises InputError for a camera's message that is larger than any silhouette or camera_info."""
    if count > MOST_MASK_BYTES:
        what = f"a message of {count} bytes, at most {MOST_MASK_BYTES} are taken"
        raise InputError(what, where=where, remedy="Check what publishes there.")


def read_message(message: bytes, kind: type[T]) -> T:
    """Read a serialised message of any type. Raises InputError for invalid bytes."""
    try:
        return deserialize_message(message, kind)
    except Exception as error:  # whatever the middleware raises
        what = f"{len(message)} bytes are no {kind.__name__} ({error})"
        raise InputError(what, remedy="The message is damaged; check the network and its publisher.") from None


def same_but_for_stamp(message: bytes, other: bytes | None) -> bool:
    """Whether two serialised messages that start with a header are equal but for their stamps."""
    return other is not None and message[AFTER_STAMP:] == other[AFTER_STAMP:]
