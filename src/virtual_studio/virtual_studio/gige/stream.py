"""The stream channel of a camera (GVSP): cuts images into packets, sends them, sends some again, and loses some."""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from gige_vision.bootstrap import SIZE_MASK, PacketSize
from gige_vision.gvcp import Status
from gige_vision.gvsp import IP_AND_UDP, Content, packet_header, payload_capacity

from .device import Device

SEND_BUFFER_BYTES = 4 << 20
RESEND_FRAMES = 8  # kept for resend requests
BURST_NS = 500_000  # packets that a delay spreads leave in bursts this far apart

Packet = tuple[bytes, bytes | memoryview]
"""Header and body, which meet in the send: no pixel is copied."""


@dataclass(frozen=True, eq=False)
class Block:
    """One block as it goes over the wire: packet 0 the leader, 1 ... n the payload, n + 1 the trailer.

    bodies : of the packets; they must not change as long as a resend may be requested.
    """

    block_id: int
    bodies: list[bytes | memoryview]

    def packet(self, packet_id: int, status: int = Status.SUCCESS) -> Packet:
        ends = {0: Content.LEADER, len(self.bodies) - 1: Content.TRAILER}
        header = packet_header(ends.get(packet_id, Content.PAYLOAD), self.block_id, packet_id, status)
        return header, self.bodies[packet_id]


class StreamChannel:
    """Sends blocks to the address in the registers. Only called from within the loop."""

    def __init__(self, device: Device) -> None:
        self._registers, self._faults, self._counters = device.registers, device.faults, device.counters
        self._settings, self._loop = device.settings, device.loop
        self._rng = np.random.default_rng(device.settings.seed)
        self._blocks: deque[Block] = deque(maxlen=RESEND_FRAMES)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._socket.bind((device.address, 0))
        device.registers["GevSCSP"] = self._socket.getsockname()[1]
        device.registers.writes["PacketSizeWord"] = self._packet_size_written

    def close(self) -> None:
        self._socket.close()

    def discard_blocks(self) -> None:
        """Forgets the sent blocks: a new acquisition begins."""
        self._blocks.clear()

    def send(self, block_id: int, leader: bytes, data: NDArray[np.uint8], trailer: bytes) -> None:
        """Sends one block, at once or spread over time by the packet delay. ``data`` (n,) contiguous."""
        capacity = payload_capacity(self._registers.integer("PacketSizeWord") & SIZE_MASK)
        pixels = memoryview(data.data).cast("B")
        payload = (pixels[start : start + capacity] for start in range(0, len(pixels), capacity))
        block = Block(block_id, [leader, *payload, trailer])
        self._blocks.append(block)
        packets = (block.packet(packet_id) for packet_id in np.flatnonzero(self._kept(len(block.bodies))).tolist())
        self._send_on(packets, self._registers.integer("GevSCPD"), self._destination)
        self._counters["frames_sent"] += 1

    def resend(self, block_id: int, first: int, last: int) -> None:
        """Sends packets of one of the last blocks once more."""
        self._counters["resend_requests"] += 1
        if self._faults.no_resend:
            return
        block = next((block for block in self._blocks if block.block_id == block_id), None)
        if block is None:
            self._counters["resend_missed"] += 1
            return
        for packet_id in range(first, min(last, len(block.bodies) - 1) + 1):
            if self._kept(1)[0]:
                self._transmit(block.packet(packet_id, Status.PACKET_RESEND), self._destination)
                self._counters["packets_resent"] += 1

    @property
    def _destination(self) -> tuple[str, int]:
        address = socket.inet_ntoa(self._registers.integer("GevSCDA").to_bytes(4, "big"))
        return address, self._registers.integer("GevSCPHostPort") & 0xFFFF

    def _kept(self, packets: int) -> NDArray[np.bool_]:
        """Draw which of n packets (n,) the network does not lose; count the others."""
        loss = self._faults.packet_loss
        kept = self._rng.random(packets) >= loss if loss else np.ones(packets, np.bool_)
        if not kept.all():
            self._counters["packets_dropped"] += int(packets - kept.sum())
        return kept

    def _send_on(self, packets: Iterator[Packet], delay_ns: int, destination: tuple[str, int]) -> None:
        """Send all packets, or the next burst of them, and the others later."""
        burst, sent = max(BURST_NS // delay_ns, 1) if delay_ns else None, 0
        for packet in islice(packets, burst):
            self._transmit(packet, destination)
            sent += 1
        if burst is not None and sent == burst:
            self._loop.call_later(burst * delay_ns, lambda: self._send_on(packets, delay_ns, destination))

    def _transmit(self, packet: Packet, destination: tuple[str, int]) -> None:
        if self._faults.unplugged or destination[1] == 0:
            return
        try:
            self._socket.sendmsg(packet, (), 0, destination)
        except OSError:
            self._counters["send_errors"] += 1

    def _packet_size_written(self) -> None:
        word = self._registers.integer("PacketSizeWord")
        size = word & SIZE_MASK
        size = min(max(size - size % 4, 576), self._settings.max_packet_size)
        self._registers["PacketSizeWord"] = (word & PacketSize.DO_NOT_FRAGMENT) | size
        if word & PacketSize.FIRE_TEST_PACKET:
            self._counters["test_packets"] += 1
            self._transmit((bytes(size - IP_AND_UDP), b""), self._destination)
