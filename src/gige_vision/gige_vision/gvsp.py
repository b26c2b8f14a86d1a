"""GVSP, the stream protocol of GigE Vision: a block (frame) is a leader, payload packets and a trailer over UDP.

Headers have 8 bytes; block ids have 16 bits and run 1 ... 65535. (Extended ids, of 64 bits, are not supported.)
Source: GigE Vision 2.x, "GigE Vision Streaming Protocol".
"""

from __future__ import annotations

import struct
from enum import IntEnum

from .gvcp import Status

IP_AND_UDP = 20 + 8
HEADER = 8
LAST_BLOCK_ID = 0xFFFF

_HEADER = struct.Struct(">HHI")
_LEADER = struct.Struct(">HHQIIIIIHH")
_TRAILER = struct.Struct(">HHI")
IMAGE = 0x0001  # payload type of a block


class Content(IntEnum):
    """What a packet holds."""

    LEADER = 1
    TRAILER = 2
    PAYLOAD = 3


def payload_capacity(packet_size: int) -> int:
    """Image bytes in one packet of the size that the stream channel's register states (IP header included)."""
    return packet_size - IP_AND_UDP - HEADER


def next_block_id(block_id: int) -> int:
    """Return the id after this one: 0 is never used, and ids start again at 1."""
    return block_id + 1 if block_id < LAST_BLOCK_ID else 1


def packet_header(content: Content, block_id: int, packet_id: int, status: int = Status.SUCCESS) -> bytes:
    """Return the header of a stream packet."""
    return _HEADER.pack(status, block_id, content << 24 | packet_id)


def image_leader(timestamp: int, pixel_format: int, size_px: tuple[int, int], offset_px: tuple[int, int]) -> bytes:
    """Return the leader's body: stamp of the image (ticks of the device's clock), pixel format, size.

    size_px, offset_px : across and down; rows are not padded.
    """
    return _LEADER.pack(0, IMAGE, timestamp, pixel_format, *size_px, *offset_px, 0, 0)


def image_trailer(height: int) -> bytes:
    """Return the trailer's body: the rows that were really sent."""
    return _TRAILER.pack(0, IMAGE, height)


# --- Pixel formats: their names and codes (EMVA Pixel Format Naming Convention), how many bytes an image has.
#
# Bits 16 to 23 of a code are the bits that a pixel occupies.


class PixelFormat(IntEnum):
    """Codes by their standard names, in the order in which clients prefer them."""

    BayerRG8 = 0x01080009
    BayerGR8 = 0x01080008
    BayerGB8 = 0x0108000A
    BayerBG8 = 0x0108000B
    YUV422_8 = 0x02100032
    YUV422_8_UYVY = 0x0210001F
    BGR8 = 0x02180015
    RGB8 = 0x02180014
    Mono8 = 0x01080001
    Mono10 = 0x01100003
    Mono12 = 0x01100005

    @property
    def is_colour(self) -> bool:
        return not self.name.startswith("Mono")

    def image_bytes(self, width: int, height: int) -> int:
        """Return the number of bytes of an image, given its pixels."""
        return (self >> 16 & 0xFF) * width * height // 8
