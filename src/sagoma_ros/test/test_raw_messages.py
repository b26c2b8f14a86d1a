"""Messages read from their bytes: the same as rclpy reads, and whatever bytes come."""

from __future__ import annotations

import array
import struct

import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage
from std_msgs.msg import Header

from sagoma_ros.raw import CompressedImageWriter, StampedMessage, _read, read_compressed_image, same_but_for_stamp

TEXT = st.text("a_/ 0é€😀\x01\x7f\uffff", max_size=20)  # one to four bytes a character


def serialised(sec: int, nanosec: int, frame: str, format: str, data: bytes) -> bytes:
    header = Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame)
    return serialize_message(CompressedImage(header=header, format=format, data=array.array("B", data)))


@given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1), TEXT, TEXT, st.binary(max_size=40))
def test_image_is_read_as_it_was_written(sec: int, nanosec: int, frame: str, format: str, data: bytes) -> None:
    image = _read(serialised(sec, nanosec, frame, format, data))
    assert (image.stamp_ns, image.format, bytes(image.data)) == (sec * 10**9 + nanosec, format, data)


@given(st.binary(max_size=80))
def test_bytes_that_are_no_image_are_refused_and_never_read_beyond(message: bytes) -> None:
    try:
        image = _read(b"\x00\x01\x00\x00" + message)
    except (struct.error, ValueError):
        return
    assert len(image.data) <= len(message)


def test_every_shorter_message_is_refused() -> None:
    message = serialised(1, 2, "cam01_optical", "mono8; png", b"PNG")
    least = len(message) - len(message.rstrip(b"\0")) if message.endswith(b"\0") else 0  # padding
    for length in range(4, len(message) - least):
        with pytest.raises((struct.error, ValueError)):
            _read(message[:length])


def test_other_byte_order_is_left_to_rclpy() -> None:
    message = serialised(1, 2, "cam01_optical", "mono8; png", b"PNG")
    with pytest.raises(ValueError, match="not little-endian"):
        _read(b"\x00\x00" + message[2:])
    assert read_compressed_image(message).format == "mono8; png"


def test_messages_are_compared_without_their_stamps() -> None:
    def info(stamp: int, width: int) -> bytes:
        return serialize_message(CameraInfo(header=Header(stamp=Time(sec=stamp), frame_id="cam01"), width=width))

    assert same_but_for_stamp(info(1, 640), info(2, 640))
    assert not same_but_for_stamp(info(1, 640), info(1, 641))
    assert not same_but_for_stamp(info(1, 640), None)


@given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 10**9 - 1), TEXT, TEXT, st.binary(max_size=40))
def test_image_is_written_as_rclpy_writes_it(sec: int, nanosec: int, frame: str, format: str, data: bytes) -> None:
    written = CompressedImageWriter(frame, format).write(sec * 10**9 + nanosec, data)
    assert _read(written) == _read(serialised(sec, nanosec, frame, format, data))  # bytes between fields may differ
    read = deserialize_message(written, CompressedImage)
    assert (read.header.stamp.sec, read.header.stamp.nanosec, read.header.frame_id) == (sec, nanosec, frame)
    assert (read.format, bytes(read.data)) == (format, data)


def test_message_is_stamped_again_and_again() -> None:
    message = CameraInfo(header=Header(frame_id="cam01"), width=640, d=[0.1, 0.2])
    again = StampedMessage(message)
    for stamp in (Time(sec=5, nanosec=6), Time(sec=-3, nanosec=999_999_999)):
        message.header.stamp = stamp
        stamped = again.at(stamp.sec * 10**9 + stamp.nanosec)
        assert deserialize_message(stamped, CameraInfo) == message
