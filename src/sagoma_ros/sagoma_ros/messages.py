"""Stamps as whole nanoseconds, so that equality means the same instant."""

from builtin_interfaces.msg import Time

NS_PER_S = 1_000_000_000


def to_ns(stamp: Time) -> int:
    """Nanoseconds since the epoch of a message stamp."""
    return stamp.sec * NS_PER_S + stamp.nanosec


def to_stamp(ns: int) -> Time:
    """Message stamp of ``ns`` nanoseconds since the epoch."""
    seconds, nanoseconds = divmod(ns, NS_PER_S)
    return Time(sec=seconds, nanosec=nanoseconds)
