"""Serialised messages read where they lie, and written into place: for those that come hundreds of times a second.

A subscription with ``raw=True`` hands over a message's bytes as they came (CDR: OMG DDS-XTypes 1.3, 7.4.3). Making a
message object of them costs more than all that a node does with most of its fields; and what a node sends is, but for
its stamp and data, the same every time.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple, TypeVar

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header

from capture_rig.errors import InputError

from .messages import NS_PER_S, to_ns

T = TypeVar("T")

LITTLE_ENDIAN_CDR = b"\x00\x01"
_LEAD_IN = 4  # bytes before the first field; fields are aligned from here
_STAMP_AND_LENGTH = struct.Struct("<iII")
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
AFTER_STAMP = _LEAD_IN + 8


class RawImage(NamedTuple):
    """What is read of a CompressedImage; ``data`` are its bytes within the message."""

    stamp_ns: int
    format: str
    data: memoryview | bytes


def read_compressed_image(message: bytes) -> RawImage:
    """Read a serialised sensor_msgs/CompressedImage; by rclpy what is laid out otherwise than by us.

    Raises InputError for bytes that are none.
    """
    try:
        return _read(message)
    except (struct.error, ValueError):
        image = read_message(message, CompressedImage)
        return RawImage(to_ns(image.header.stamp), image.format, bytes(image.data))


def read_message(message: bytes, kind: type[T]) -> T:
    """Read a serialised message of any type. Raises InputError for bytes that are none."""
    try:
        return deserialize_message(message, kind)
    except Exception as error:  # whatever the middleware raises
        what = f"{len(message)} bytes are no {kind.__name__} ({error})"
        raise InputError(what, remedy="The message is damaged; check the network and its publisher.") from None


def same_but_for_stamp(message: bytes, other: bytes | None) -> bool:
    """Whether two serialised messages that start with a header are equal but for their stamps."""
    return other is not None and message[AFTER_STAMP:] == other[AFTER_STAMP:]


class StampedMessage:
    """A message that begins with a header and is sent again and again under other stamps."""

    def __init__(self, message: Any) -> None:
        self._bytes = bytearray(serialize_message(message))

    def at(self, stamp_ns: int) -> bytes:
        """Return the serialised message with this stamp."""
        _STAMP.pack_into(self._bytes, _LEAD_IN, *divmod(stamp_ns, NS_PER_S))
        return bytes(self._bytes)


class CompressedImageWriter:
    """Serialises sensor_msgs/CompressedImage messages of one frame id and format."""

    def __init__(self, frame_id: str, format: str) -> None:
        empty = CompressedImage(header=Header(frame_id=frame_id), format=format)
        # strings end with a NUL; serialisers differ in whether they fill up the end
        length = _aligned(_LEAD_IN + _STAMP_AND_LENGTH.size + len(frame_id.encode()) + 1) + _LENGTH.size
        length = _aligned(length + len(format.encode()) + 1)
        self._begin = bytearray(serialize_message(empty)[:length])

    def write(self, stamp_ns: int, data: bytes) -> bytes:
        """Return a serialised message."""
        _STAMP.pack_into(self._begin, _LEAD_IN, *divmod(stamp_ns, NS_PER_S))
        return b"".join((self._begin, _LENGTH.pack(len(data)), data))


def _read(message: bytes) -> RawImage:
    """Raises struct.error or ValueError for bytes that are not laid out so, or too few."""
    if message[:2] != LITTLE_ENDIAN_CDR:
        raise ValueError("not little-endian CDR")
    sec, nanosec, frame_length = _STAMP_AND_LENGTH.unpack_from(message, _LEAD_IN)
    place = _aligned(_LEAD_IN + _STAMP_AND_LENGTH.size + frame_length)
    (format_length,) = _LENGTH.unpack_from(message, place)
    place += _LENGTH.size
    format_bytes = message[place : place + format_length - 1]  # without the NUL
    place = _aligned(place + format_length)
    (size,) = _LENGTH.unpack_from(message, place)
    place += _LENGTH.size
    if not 0 < format_length <= len(message) or place + size > len(message):
        raise ValueError("longer than the message")
    return RawImage(sec * NS_PER_S + nanosec, format_bytes.decode(), memoryview(message)[place : place + size])


def _aligned(place: int) -> int:
    """The next multiple of four bytes behind the lead-in, which is one itself."""
    return -(-place // 4) * 4
