"""The stream channel of a camera: sends blocks, some packets of them again, and loses as many as it is told to."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gige_vision.bootstrap import EXTENDED_ID_MODE, SIZE_MASK, PacketSize
from gige_vision.gvcp import Status
from gige_vision.gvcp_payloads import ResendRequest
from gige_vision.gvsp import IP_AND_UDP, Content, ImageLeader, ImageTrailer, PacketHeader

from .faults import Faults
from .loop import EventLoop
from .packets import Block, Layout, Piece
from .registers import Registers
from .settings import CameraSettings

UDP_SEGMENT = 103  # linux/udp.h: the size at which the system cuts a send into datagrams
SEND_BUFFER_BYTES = 4 << 20
MOST_REFUSALS = 64
BURST_NS = 500_000  # packets that a delay spreads leave in bursts this far apart


class StreamChannel:
    """Sends blocks to whom the registers name. Only called from within the loop."""

    def __init__(
        self,
        address: str,
        registers: Registers,
        settings: CameraSettings,
        faults: Faults,
        counters: Counter[str],
        loop: EventLoop,
    ) -> None:
        self._registers, self._settings, self._faults, self._loop = registers, settings, faults, loop
        self._counters = counters
        self._rng = np.random.default_rng(settings.seed)
        self._blocks: list[Block] = []
        self._next = 0
        self._layout: Layout | None = None
        self._segment = 0
        self._segments_allowed = True
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._socket.bind((address, 0))
        registers["GevSCSP"] = self._socket.getsockname()[1]
        registers.writes["PacketSizeWord"] = self._packet_size_written

    def close(self) -> None:
        self._socket.close()

    @property
    def is_open(self) -> bool:
        """True when a client has said where to send."""
        return self._registers.integer("GevSCPHostPort") != 0

    def forget(self) -> None:
        """Nothing can be sent again any more: a new acquisition begins."""
        for block in self._blocks:
            block.block_id = 0

    def send(self, block_id: int, leader: ImageLeader, data: NDArray[np.uint8], trailer: ImageTrailer) -> None:
        """Send one block, at once or spread over time by the packet delay."""
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
        """Answer a resend request from the last blocks; packets that are gone are said to be."""
        self._counters["resend_requests"] += 1
        if self._faults.no_resend:
            return
        block = next((b for b in self._blocks if b.block_id == request.block_id and b.block_id), None)
        if block is None:
            self._counters["resend_missed"] += 1
            for packet_id in range(request.first, min(request.last, request.first + MOST_REFUSALS) + 1):
                header = PacketHeader(
                    Content.PAYLOAD, request.block_id, packet_id, Status.PACKET_UNAVAILABLE, request.extended
                )
                self._transmit([header.encode()], self._destination)
            return
        for packet_id in range(request.first, min(request.last, block.packets - 1) + 1):
            if self._faults.packet_loss and self._rng.random() < self._faults.packet_loss:
                self._counters["packets_dropped"] += 1
                continue
            self._transmit(block.resent(packet_id), self._destination)
            self._counters["packets_resent"] += 1

    @property
    def _destination(self) -> tuple[str, int]:
        address = socket.inet_ntoa(self._registers.integer("GevSCDA").to_bytes(4, "big"))
        return address, self._registers.integer("GevSCPHostPort") & 0xFFFF

    def _take_block(self, size: int) -> Block:
        packet_size = self._registers.integer("PacketSizeWord") & SIZE_MASK
        extended = bool(self._registers.integer("GevSCCFG") & EXTENDED_ID_MODE)
        layout = Layout(size, packet_size, extended)
        if layout != self._layout:
            self._layout, self._next = layout, 0
            self._blocks = [Block(layout) for _ in range(self._settings.resend_frames)]
        self._next = (self._next + 1) % len(self._blocks)
        return self._blocks[self._next]

    def _pieces(self, block: Block) -> list[Piece]:
        """What is sent, in as few sends as possible."""
        if not self._segments_allowed:
            return list(self._single(block))
        self._set_segment(block.layout.segment)
        if not self._faults.packet_loss:
            return [block.packet(0), *block.runs(1, block.packets - 1), block.packet(block.packets - 1)]
        kept = self._kept(block.packets)
        pieces: list[Piece] = [block.packet(0)] if kept[0] else []
        for first, end in _stretches(kept[1:-1]):
            pieces += block.runs(first + 1, end + 1)
        return [*pieces, block.packet(block.packets - 1)] if kept[-1] else pieces

    def _single(self, block: Block) -> Iterator[Piece]:
        kept = self._kept(block.packets)
        return (block.packet(packet_id) for packet_id in range(block.packets) if kept[packet_id])

    def _kept(self, packets: int) -> NDArray[np.bool_]:
        """Which packets the network does not lose."""
        if not self._faults.packet_loss:
            return np.ones(packets, np.bool_)
        kept = self._rng.random(packets) >= self._faults.packet_loss
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
        self._loop.call_at(time.time_ns() + burst * delay_ns, lambda: self._send_slowly(packets, delay_ns, destination))

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


def _stretches(kept: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and end of every stretch of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
