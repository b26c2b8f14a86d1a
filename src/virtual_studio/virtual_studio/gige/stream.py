"""The stream channel of a camera (GVSP): cuts images into packets, sends them, sends some again, and loses some.

Headers and image stay where they are and meet in the send: no pixel is copied.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gige_vision.bootstrap import SIZE_MASK, PacketSize
from gige_vision.gvcp import ResendRequest, Status
from gige_vision.gvsp import HEADER, IP_AND_UDP, Content, ImageLeader, ImageTrailer, PacketHeader, payload_capacity

from .device import Device

LARGEST_SEND = 65507
"""Bytes of UDP payload in one datagram, and in one send that the system cuts into several."""
MOST_SEGMENTS = 64
UDP_SEGMENT = 103  # linux/udp.h: the size at which the system cuts a send into datagrams
SEND_BUFFER_BYTES = 4 << 20
MOST_REFUSALS = 64
BURST_NS = 500_000  # packets that a delay spreads leave in bursts this far apart


@dataclass(frozen=True)
class Layout:
    """How a block is cut: bytes of the block, size of a packet (IP header included)."""

    block_bytes: int
    packet_size: int

    @cached_property
    def capacity(self) -> int:
        return payload_capacity(self.packet_size)

    @cached_property
    def rows(self) -> int:
        """Payload packets of a block."""
        return -(-self.block_bytes // self.capacity)

    @property
    def segment(self) -> int:
        """Bytes of every payload packet but the last, header included."""
        return HEADER + self.capacity


Piece = list[bytes | memoryview]
"""Header and payload of one packet, or of several that leave in one send."""


class Block:
    """One block as it goes over the wire: packet 0 the leader, 1 ... n the payload, n + 1 the trailer.

    The image must not change as long as its packets may be asked for again.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.block_id = 0
        headers = [PacketHeader(Content.PAYLOAD, 0, row + 1) for row in range(layout.rows)]
        self._headers = np.frombuffer(b"".join(h.encode() for h in headers), np.uint8).reshape(layout.rows, -1).copy()
        self._header_views = [memoryview(row.data).cast("B") for row in self._headers]
        self._image = memoryview(b"")
        self._leader = self._trailer = b""

    @property
    def packets(self) -> int:
        return self.layout.rows + 2

    def fill(self, block_id: int, leader: ImageLeader, data: NDArray[np.uint8], trailer: ImageTrailer) -> None:
        """Puts a new image in: ``data`` (layout.block_bytes,), contiguous."""
        self.block_id = block_id
        self._headers[:, 2:4] = np.frombuffer(struct.pack(">H", block_id), np.uint8)
        self._image = memoryview(data.data).cast("B")
        self._leader = self._header(Content.LEADER, 0) + leader.encode()
        self._trailer = self._header(Content.TRAILER, self.layout.rows + 1) + trailer.encode()

    def packet(self, packet_id: int) -> Piece:
        """Returns one packet."""
        if packet_id == 0:
            return [self._leader]
        if packet_id == self.layout.rows + 1:
            return [self._trailer]
        start, size = (packet_id - 1) * self.layout.capacity, self.layout.capacity
        return [self._header_views[packet_id - 1], self._image[start : start + size]]

    def runs(self, first: int, end: int) -> list[Piece]:
        """Returns payload packets first ... end - 1 (ids from 1) in as few pieces, of one send each, as possible."""
        most = min(max(LARGEST_SEND // self.layout.segment, 1), MOST_SEGMENTS)
        return [
            [part for packet_id in range(start, min(start + most, end)) for part in self.packet(packet_id)]
            for start in range(first, end, most)
        ]

    def resent(self, packet_id: int) -> Piece:
        """Returns one packet, marked as sent again."""
        header, *image = self.packet(packet_id)
        return [struct.pack(">H", Status.PACKET_RESEND) + bytes(header[2:]), *image]

    def _header(self, content: Content, packet_id: int) -> bytes:
        return PacketHeader(content, self.block_id, packet_id).encode()


class StreamChannel:
    """Sends blocks to the address in the registers. Only called from within the loop."""

    def __init__(self, device: Device) -> None:
        self._registers, self._faults, self._counters = device.registers, device.faults, device.counters
        self._settings, self._loop = device.settings, device.loop
        self._rng = np.random.default_rng(device.settings.seed)
        self._blocks: list[Block] = []
        self._next = 0
        self._layout: Layout | None = None
        self._segment = 0
        self._segments_allowed = True
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._socket.bind((device.address, 0))
        device.registers["GevSCSP"] = self._socket.getsockname()[1]
        device.registers.writes["PacketSizeWord"] = self._packet_size_written

    def close(self) -> None:
        self._socket.close()

    @property
    def is_open(self) -> bool:
        """True when a client has said where to send."""
        return self._registers.integer("GevSCPHostPort") != 0

    def discard_blocks(self) -> None:
        """Forgets what was sent: a new acquisition begins."""
        for block in self._blocks:
            block.block_id = 0

    def send(self, block_id: int, leader: ImageLeader, data: NDArray[np.uint8], trailer: ImageTrailer) -> None:
        """Sends one block, at once or spread over time by the packet delay."""
        block = self._take_block(len(data))
        block.fill(block_id, leader, data, trailer)
        destination, delay_ns = self._destination, self._registers.integer("GevSCPD")
        if delay_ns:
            self._send_slowly(self._single(block), delay_ns, destination)
        else:
            for piece in self._pieces(block):
                self._transmit(piece, destination)
        self._counters["frames_sent"] += 1

    def resend(self, request: ResendRequest) -> None:
        """Answers a resend request from the last blocks; packets that are gone are reported unavailable."""
        self._counters["resend_requests"] += 1
        if self._faults.no_resend:
            return
        block = next((b for b in self._blocks if b.block_id == request.block_id and b.block_id), None)
        if block is None:
            self._counters["resend_missed"] += 1
            for packet_id in range(request.first, min(request.last, request.first + MOST_REFUSALS) + 1):
                header = PacketHeader(Content.PAYLOAD, request.block_id, packet_id, Status.PACKET_UNAVAILABLE)
                self._transmit([header.encode()], self._destination)
            return
        for packet_id in range(request.first, min(request.last, block.packets - 1) + 1):
            if self._kept(1)[0]:
                self._transmit(block.resent(packet_id), self._destination)
                self._counters["packets_resent"] += 1

    @property
    def _destination(self) -> tuple[str, int]:
        address = socket.inet_ntoa(self._registers.integer("GevSCDA").to_bytes(4, "big"))
        return address, self._registers.integer("GevSCPHostPort") & 0xFFFF

    def _take_block(self, size: int) -> Block:
        layout = Layout(size, self._registers.integer("PacketSizeWord") & SIZE_MASK)
        if layout != self._layout:
            self._layout, self._next = layout, 0
            self._blocks = [Block(layout) for _ in range(self._settings.resend_frames)]
        self._next = (self._next + 1) % len(self._blocks)
        return self._blocks[self._next]

    def _pieces(self, block: Block) -> list[Piece]:
        """Return what is sent, in as few sends as possible."""
        if not self._segments_allowed:
            return list(self._single(block))
        self._set_segment(block.layout.segment)
        if not self._faults.packet_loss:
            return [block.packet(0), *block.runs(1, block.packets - 1), block.packet(block.packets - 1)]
        kept = self._kept(block.packets)
        pieces: list[Piece] = [block.packet(0)] if kept[0] else []
        for first, end in stretches(kept[1:-1]):
            pieces += block.runs(first + 1, end + 1)
        return [*pieces, block.packet(block.packets - 1)] if kept[-1] else pieces

    def _single(self, block: Block) -> Iterator[Piece]:
        kept = self._kept(block.packets)
        return (block.packet(packet_id) for packet_id in range(block.packets) if kept[packet_id])

    def _kept(self, packets: int) -> NDArray[np.bool_]:
        """Return which packets the network does not lose; the others are counted."""
        kept = kept_packets(packets, self._faults.packet_loss, self._rng)
        if not kept.all():
            self._counters["packets_dropped"] += int(packets - kept.sum())
        return kept

    def _set_segment(self, size: int) -> None:
        if size == self._segment:
            return
        try:
            self._socket.setsockopt(socket.IPPROTO_UDP, UDP_SEGMENT, size)
            self._segment = size
        except OSError:  # a system without it
            self._segments_allowed = False

    def _transmit(self, piece: Piece, destination: tuple[str, int]) -> None:
        if self._faults.unplugged or destination[1] == 0:
            return
        if len(piece) > 2 and not self._segments_allowed:
            self._send_apart(piece, destination)
            return
        try:
            self._socket.sendmsg(piece, (), 0, destination)
        except OSError:
            if len(piece) > 2:  # segments larger than the link's packets are refused
                self._segments_allowed = False
                self._send_apart(piece, destination)
            else:
                self._counters["send_errors"] += 1

    def _send_apart(self, piece: Piece, destination: tuple[str, int]) -> None:
        """Every packet by itself."""
        self._set_segment_off()
        for start in range(0, len(piece), 2):  # header and payload
            self._transmit(piece[start : start + 2], destination)

    def _send_slowly(self, packets: Iterator[Piece], delay_ns: int, destination: tuple[str, int]) -> None:
        burst = max(BURST_NS // delay_ns, 1)
        for _ in range(burst):
            packet = next(packets, None)
            if packet is None:
                return
            self._transmit(packet, destination)
        self._loop.call_later(burst * delay_ns, lambda: self._send_slowly(packets, delay_ns, destination))

    def _packet_size_written(self) -> None:
        word = self._registers.integer("PacketSizeWord")
        size = word & SIZE_MASK
        size = min(max(size - size % 4, 576), self._settings.max_packet_size)
        self._registers["PacketSizeWord"] = (word & PacketSize.DO_NOT_FRAGMENT) | size
        if word & PacketSize.FIRE_TEST_PACKET:
            self._counters["test_packets"] += 1
            self._set_segment_off()
            self._transmit([bytes(size - IP_AND_UDP)], self._destination)

    def _set_segment_off(self) -> None:
        if self._segment:
            self._socket.setsockopt(socket.IPPROTO_UDP, UDP_SEGMENT, 0)
            self._segment = 0


def kept_packets(count: int, loss: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draws which of so many packets (count,) arrive where each is lost with probability ``loss``."""
    return rng.random(count) >= loss if loss else np.ones(count, np.bool_)


def stretches(kept: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Finds first and end of every stretch of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
