"""Blocks on the wire, received by a bare socket and put together by the standard's rules."""

import ipaddress
import socket
import struct
from collections import Counter
from typing import NamedTuple

import numpy as np
import pytest

from gige_vision.gvcp import Status
from gige_vision.gvsp import Content, image_leader, image_trailer, payload_capacity
from virtual_studio.gige.camera import feature_table
from virtual_studio.gige.device import CameraSettings, Device, Faults
from virtual_studio.gige.loop import EventLoop
from virtual_studio.gige.registers import Registers
from virtual_studio.gige.stream import RESEND_FRAMES, StreamChannel

DATA = np.random.default_rng(1).integers(0, 256, 100_003).astype(np.uint8)
LEADER, TRAILER = image_leader(5, 0x01080001, (100_003, 1), (0, 0)), image_trailer(1)


class Header(NamedTuple):
    status: int
    block_id: int
    content: int
    packet_id: int


class Wire:
    """A stream channel and the socket that it sends to."""

    def __init__(self, packet_size=1500, **faults):
        self.receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.receiver.bind(("127.0.0.1", 0))
        self.receiver.settimeout(0.3)
        settings = CameraSettings(max_packet_size=65500)
        self.registers = Registers(feature_table(settings, "127.0.0.1", 640, 480, colour=False))
        self.loop, self.faults, self.counters = EventLoop(), Faults(**faults), Counter()
        device = Device("127.0.0.1", settings, self.registers, self.faults, self.counters, self.loop)
        self.channel = StreamChannel(device)
        self.capacity = payload_capacity(packet_size)
        self.block_packets = -(-len(DATA) // self.capacity) + 2
        self.registers["GevSCDA"] = int(ipaddress.IPv4Address("127.0.0.1"))
        self.registers["GevSCPHostPort"] = self.receiver.getsockname()[1]
        self.registers["PacketSizeWord"] = packet_size
        self.loop.start()

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        self.loop.stop()
        self.channel.close()
        self.receiver.close()

    def send(self, *block_ids, data=DATA):
        for block_id in block_ids or (1,):
            self.loop.call(lambda number=block_id: self.channel.send(number, LEADER, data, TRAILER))

    def resend(self, *wanted):
        self.loop.call(lambda: self.channel.resend(*wanted))

    def packets(self, count=None):
        """What arrived: (header, body, bytes of the datagram)."""
        received = []
        while count is None or len(received) < count:
            try:
                datagram = self.receiver.recv(1 << 16)
            except TimeoutError:
                break
            status, block_id, word = struct.unpack_from(">HHI", datagram)
            received.append((Header(status, block_id, word >> 24, word & 0xFFFFFF), datagram[8:], len(datagram)))
        return received


def payload(packets):
    """The bytes between leader and trailer."""
    return b"".join(body for _, body, _ in packets[1:-1])


def told(packets):
    return [(header.block_id, header.packet_id, header.status) for header, _, _ in packets]


@pytest.mark.parametrize("packet_size", [576, 1500, 9000, 65500])
def test_block_is_leader_payload_and_trailer_with_rising_packet_ids(packet_size):
    with Wire(packet_size) as wire:
        wire.send(7)
        packets = wire.packets(wire.block_packets)
    assert told(packets) == [(7, number, Status.SUCCESS) for number in range(len(packets))]
    contents = [header.content for header, _, _ in packets]
    assert contents == [Content.LEADER, *[Content.PAYLOAD] * (len(packets) - 2), Content.TRAILER]
    assert (packets[0][1], packets[-1][1]) == (LEADER, TRAILER)
    assert payload(packets) == DATA.tobytes()
    assert all(size + 28 == packet_size for _, _, size in packets[1:-2])  # IP and UDP headers are counted


def test_packets_that_the_network_lost_never_arrive_and_the_others_are_intact():
    with Wire(1500, packet_loss=0.3) as wire, Wire(1500, packet_loss=0.3) as of_the_same_seed:
        wire.send()
        of_the_same_seed.send()
        packets = wire.packets()
        assert told(of_the_same_seed.packets()) == told(packets)
        assert len(packets) == wire.block_packets - wire.counters["packets_dropped"]
    assert 5 < wire.counters["packets_dropped"] < 50
    for header, body, _ in packets:
        if header.content == Content.PAYLOAD:
            start = (header.packet_id - 1) * wire.capacity
            assert body == DATA[start : start + wire.capacity].tobytes()


def test_resent_packets_are_the_ones_asked_for_and_marked():
    with Wire(1500) as wire:
        wire.send(1)
        wire.send(2, data=DATA[::-1].copy())
        wire.packets(2 * wire.block_packets)
        wire.resend(1, 3, 5)
        packets = wire.packets(3)
    assert told(packets) == [(1, number, Status.PACKET_RESEND) for number in (3, 4, 5)]
    assert packets[0][1] == DATA[2 * 1464 : 3 * 1464].tobytes()


def test_packets_of_a_block_that_is_gone_are_said_to_be_unavailable():
    with Wire(9000) as wire:
        wire.send(*range(1, 2 + RESEND_FRAMES))
        wire.packets((1 + RESEND_FRAMES) * wire.block_packets)
        wire.resend(1, 2, 3)
        packets = wire.packets(2)
    assert told(packets) == [(1, number, Status.PACKET_UNAVAILABLE) for number in (2, 3)]
    assert wire.counters["resend_missed"] == 1
