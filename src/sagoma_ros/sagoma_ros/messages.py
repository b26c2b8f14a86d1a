"""Pieces that many messages hold: stamps as whole nanoseconds (equal means the same instant), and named values."""

from __future__ import annotations

from collections.abc import Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import KeyValue

from capture_rig.stamps import NS_PER_S


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
