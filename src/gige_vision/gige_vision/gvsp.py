"""GVSP, the stream protocol of GigE Vision: a block (frame) is a leader, payload packets and a trailer over UDP.

Headers have 8 bytes (block ids of 16 bits, which run 1 ... 65535) or, with extended ids, 20 (block ids of 64 bits).
Source: GigE Vision 2.x, "GigE Vision Streaming Protocol".
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from .gvcp import MalformedPacket, Status

IP_AND_UDP = 20 + 8
HEADER, EXTENDED_HEADER = 8, 20
LAST_BLOCK_ID = 0xFFFF
EXTENDED_ID_FLAG = 0x80
CHUNKS_FOLLOW = 0x4000
"""Flag of a payload type: chunks follow the image."""

_SHORT, _LONG = struct.Struct(">HHI"), struct.Struct(">HHIQI")
_LEADER = struct.Struct(">HHQIIIIIHH")
_TRAILER, _CHUNK_TRAILER = struct.Struct(">HHI"), struct.Struct(">HHIII")
_CHUNK_TAIL = struct.Struct(">II")


class Content(IntEnum):
    """What a packet holds."""

    LEADER = 1
    TRAILER = 2
    PAYLOAD = 3
    ALL_IN = 4


class Payload(IntEnum):
    """What a block holds."""

    IMAGE = 0x0001
    CHUNKS = 0x0004
    IMAGE_WITH_CHUNKS = 0x4001


def payload_capacity(packet_size: int, extended: bool = False) -> int:
    """Image bytes in one packet of the size that the stream channel's register states (IP header included)."""
    return packet_size - IP_AND_UDP - (EXTENDED_HEADER if extended else HEADER)


def next_block_id(block_id: int, extended: bool = False) -> int:
    """Return the id after this one: 0 is never used, and ids of 16 bits start again at 1."""
    return block_id + 1 if extended or block_id < LAST_BLOCK_ID else 1


@dataclass(frozen=True)
class PacketHeader:
    """The header of every stream packet."""

    content: int
    block_id: int
    packet_id: int
    status: int = Status.SUCCESS
    extended: bool = False

    def encode(self) -> bytes:
        if self.extended:
            infos = (EXTENDED_ID_FLAG | self.content) << 24
            return _LONG.pack(self.status, 0, infos, self.block_id, self.packet_id)
        return _SHORT.pack(self.status, self.block_id, self.content << 24 | self.packet_id)

    @classmethod
    def decode(cls, data: bytes) -> tuple[PacketHeader, bytes]:
        """Return the header and what follows it. Raises MalformedPacket."""
        if len(data) < HEADER:
            raise MalformedPacket(f"{len(data)} bytes are no GVSP packet")
        status, block_id, infos = _SHORT.unpack_from(data)
        content = infos >> 24 & 0x0F
        if not infos >> 24 & EXTENDED_ID_FLAG:
            return cls(content, block_id, infos & 0xFFFFFF, status), data[HEADER:]
        if len(data) < EXTENDED_HEADER:
            raise MalformedPacket(f"{len(data)} bytes are no GVSP packet with extended ids")
        _, _, _, block_id, packet_id = _LONG.unpack_from(data)
        return cls(content, block_id, packet_id, status, True), data[EXTENDED_HEADER:]


@dataclass(frozen=True)
class ImageLeader:
    """The leader's body: when the image was taken (ticks of the device's clock) and what it is, in pixels."""

    timestamp: int
    pixel_format: int
    width: int
    height: int
    offset_x: int = 0
    offset_y: int = 0
    padding_x: int = 0
    padding_y: int = 0
    payload: int = Payload.IMAGE

    def encode(self) -> bytes:
        return _LEADER.pack(
            0,
            self.payload,
            self.timestamp,
            self.pixel_format,
            self.width,
            self.height,
            self.offset_x,
            self.offset_y,
            self.padding_x,
            self.padding_y,
        )

    @classmethod
    def decode(cls, body: bytes) -> ImageLeader:
        """Decode the packet's body. Raises MalformedPacket."""
        if len(body) < _LEADER.size:
            raise MalformedPacket(f"{len(body)} bytes are no image leader")
        _, payload, timestamp, *fields = _LEADER.unpack_from(body)
        pixel_format, width, height, offset_x, offset_y, padding_x, padding_y = fields
        return cls(timestamp, pixel_format, width, height, offset_x, offset_y, padding_x, padding_y, payload)


@dataclass(frozen=True)
class ImageTrailer:
    """The trailer's body: the height that was really sent, and how many bytes image and chunks have together."""

    height: int
    chunk_bytes: int | None = None

    def encode(self) -> bytes:
        if self.chunk_bytes is None:
            return _TRAILER.pack(0, Payload.IMAGE, self.height)
        return _CHUNK_TRAILER.pack(0, Payload.IMAGE_WITH_CHUNKS, self.chunk_bytes, self.height, 0)

    @classmethod
    def decode(cls, body: bytes) -> ImageTrailer:
        """Decode the packet's body. Raises MalformedPacket."""
        if len(body) < _TRAILER.size:
            raise MalformedPacket(f"{len(body)} bytes are no image trailer")
        _, payload, first = _TRAILER.unpack_from(body)
        if not payload & CHUNKS_FOLLOW:
            return cls(first)
        if len(body) < _CHUNK_TRAILER.size:
            raise MalformedPacket(f"{len(body)} bytes are no trailer of an image with chunks")
        _, _, chunk_bytes, height, _ = _CHUNK_TRAILER.unpack_from(body)
        return cls(height, chunk_bytes)


def encode_chunk(chunk_id: int, data: bytes) -> bytes:
    """Return a chunk: its data, and behind it its id and length."""
    return data + _CHUNK_TAIL.pack(chunk_id, len(data))


def decode_chunks(block: bytes) -> dict[int, bytes]:
    """Return the chunks of a block by id, read from its end (the image itself is one of them).

    Raises MalformedPacket when the lengths do not add up.
    """
    chunks: dict[int, bytes] = {}
    end = len(block)
    while end > 0:
        start = end - _CHUNK_TAIL.size
        if start < 0:
            raise MalformedPacket("the block does not end with a chunk")
        chunk_id, length = _CHUNK_TAIL.unpack_from(block, start)
        if length > start:
            raise MalformedPacket(f"chunk 0x{chunk_id:08x} claims {length} bytes of {start}")
        chunks[chunk_id] = block[start - length : start]
        end = start - length
    return chunks
