"""Blocks cut into stream packets, without moving a pixel."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gige_vision.gvcp import Status
from gige_vision.gvsp import EXTENDED_HEADER, HEADER, Content, ImageLeader, ImageTrailer, PacketHeader, payload_capacity

LARGEST_SEND = 65507
"""Bytes of UDP payload in one datagram, and in one send that the system cuts into several."""
MOST_SEGMENTS = 64


@dataclass(frozen=True)
class Layout:
    """How a block is cut: bytes of the block, size of a packet (IP header included), long ids or short ones."""

    block_bytes: int
    packet_size: int
    extended: bool = False

    @property
    def header(self) -> int:
        return EXTENDED_HEADER if self.extended else HEADER

    @cached_property
    def capacity(self) -> int:
        return payload_capacity(self.packet_size, self.extended)

    @cached_property
    def rows(self) -> int:
        """Payload packets of a block."""
        return -(-self.block_bytes // self.capacity)

    @property
    def segment(self) -> int:
        """Bytes of every payload packet but the last, header included."""
        return self.header + self.capacity


Piece = list[bytes | memoryview]
"""Header and payload of one packet, or of several that leave in one send."""


class Block:
    """One block as it goes over the wire: packet 0 the leader, 1 ... n the payload, n + 1 the trailer.

    Headers and image stay where they are and meet in the send; nothing is copied. The image must not change as long as
    its packets may be asked for again.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.block_id = 0
        headers = [PacketHeader(Content.PAYLOAD, 0, row + 1, extended=layout.extended) for row in range(layout.rows)]
        self._headers = np.frombuffer(b"".join(h.encode() for h in headers), np.uint8).reshape(layout.rows, -1).copy()
        self._header_views = [memoryview(row.data).cast("B") for row in self._headers]
        self._image = memoryview(b"")
        self._leader = self._trailer = b""

    @property
    def packets(self) -> int:
        return self.layout.rows + 2

    def fill(self, block_id: int, leader: ImageLeader, data: NDArray[np.uint8], trailer: ImageTrailer) -> None:
        """Put a new block in: ``data`` (layout.block_bytes,), contiguous."""
        layout, self.block_id = self.layout, block_id
        id_bytes = np.frombuffer(struct.pack(">Q" if layout.extended else ">H", block_id), np.uint8)
        first = 8 if layout.extended else 2
        self._headers[:, first : first + len(id_bytes)] = id_bytes
        self._image = memoryview(data.data).cast("B")
        self._leader = self._header(Content.LEADER, 0) + leader.encode()
        self._trailer = self._header(Content.TRAILER, layout.rows + 1) + trailer.encode()

    def packet(self, packet_id: int) -> Piece:
        """One packet."""
        if packet_id == 0:
            return [self._leader]
        if packet_id == self.layout.rows + 1:
            return [self._trailer]
        start, size = (packet_id - 1) * self.layout.capacity, self.layout.capacity
        return [self._header_views[packet_id - 1], self._image[start : start + size]]

    def runs(self, first: int, end: int) -> list[Piece]:
        """Payload packets first ... end - 1 (ids from 1), as few pieces as one send each can take."""
        most = min(max(LARGEST_SEND // self.layout.segment, 1), MOST_SEGMENTS)
        return [
            [part for packet_id in range(start, min(start + most, end)) for part in self.packet(packet_id)]
            for start in range(first, end, most)
        ]

    def resent(self, packet_id: int) -> Piece:
        """One packet, marked as sent again."""
        header, *image = self.packet(packet_id)
        return [struct.pack(">H", Status.PACKET_RESEND) + bytes(header[2:]), *image]

    def _header(self, content: Content, packet_id: int) -> bytes:
        return PacketHeader(content, self.block_id, packet_id, extended=self.layout.extended).encode()
