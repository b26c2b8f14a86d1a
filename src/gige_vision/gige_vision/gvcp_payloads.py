"""What the GVCP commands carry: registers, memory, resend requests, actions; encoded and decoded."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass

from .gvcp import ACKNOWLEDGE, EXTENDED_IDS, SCHEDULED, Command, CommandPacket, MalformedPacket

PACKET_ID_MASK = 0x00FFFFFF

_WORD, _PAIR = struct.Struct(">I"), struct.Struct(">II")
_RESEND, _RESEND_EXTENDED = struct.Struct(">HHII"), struct.Struct(">HHIIQ")
_ACTION, _TIME = struct.Struct(">III"), struct.Struct(">Q")


def encode_words(values: Iterable[int]) -> bytes:
    """32-bit words: the payload of READREG (addresses) and of its acknowledge (values)."""
    return b"".join(_WORD.pack(value) for value in values)


def decode_words(payload: bytes) -> tuple[int, ...]:
    """Raises MalformedPacket unless the payload is one or more whole words."""
    if not payload or len(payload) % 4:
        raise MalformedPacket(f"{len(payload)} bytes are not a row of 32-bit words")
    return tuple(word for (word,) in _WORD.iter_unpack(payload))


def encode_writes(writes: Iterable[tuple[int, int]]) -> bytes:
    """Payload of WRITEREG: pairs of address and value."""
    return b"".join(_PAIR.pack(address, value) for address, value in writes)


def decode_writes(payload: bytes) -> tuple[tuple[int, int], ...]:
    """Raises MalformedPacket unless the payload is one or more whole pairs."""
    if not payload or len(payload) % 8:
        raise MalformedPacket(f"{len(payload)} bytes are not pairs of address and value")
    return tuple(_PAIR.iter_unpack(payload))


def encode_memory_read(address: int, count: int) -> bytes:
    """Payload of READMEM: the address and the number of bytes."""
    return struct.pack(">IHH", address, 0, count)


def decode_memory_read(payload: bytes) -> tuple[int, int]:
    """Address and number of bytes. Raises MalformedPacket."""
    if len(payload) < 8:
        raise MalformedPacket(f"{len(payload)} bytes are no READMEM")
    address, _, count = struct.unpack_from(">IHH", payload)
    return address, count


def encode_memory(address: int, data: bytes) -> bytes:
    """Payload of WRITEMEM and of READMEM's acknowledge: the address and the bytes."""
    return _WORD.pack(address) + data


def decode_memory(payload: bytes) -> tuple[int, bytes]:
    """Address and bytes. Raises MalformedPacket."""
    if len(payload) < 4:
        raise MalformedPacket(f"{len(payload)} bytes hold no address")
    return _WORD.unpack_from(payload)[0], payload[4:]


@dataclass(frozen=True)
class ResendRequest:
    """PACKETRESEND: packets first to last (both included) of one block, please. Nothing acknowledges it."""

    block_id: int
    first: int
    last: int
    channel: int = 0
    extended: bool = False

    def command(self, request_id: int = 1) -> CommandPacket:
        if self.extended:
            payload = _RESEND_EXTENDED.pack(self.channel, 0, self.first, self.last, self.block_id)
        else:
            payload = _RESEND.pack(self.channel, self.block_id, self.first, self.last)
        return CommandPacket(Command.PACKET_RESEND, payload, request_id, EXTENDED_IDS if self.extended else 0)

    @classmethod
    def decode(cls, packet: CommandPacket) -> ResendRequest:
        """Raises MalformedPacket."""
        extended = bool(packet.flags & EXTENDED_IDS)
        layout = _RESEND_EXTENDED if extended else _RESEND
        if len(packet.payload) < layout.size:
            raise MalformedPacket(f"{len(packet.payload)} bytes are no PACKETRESEND")
        channel, block_id, first, last, *long_id = layout.unpack_from(packet.payload)
        if extended:
            return cls(long_id[0], first, last, channel, True)
        return cls(block_id, first & PACKET_ID_MASK, last & PACKET_ID_MASK, channel)


@dataclass(frozen=True)
class Action:
    """ACTION: every device whose keys fit and whose mask meets this one acts, at once or at ``time_ns``.

    time_ns: when to act, in the devices' common (PTP) time; None: at once.
    """

    device_key: int
    group_key: int
    group_mask: int
    time_ns: int | None = None

    def command(self, request_id: int = 1, acknowledge: bool = True) -> CommandPacket:
        payload = _ACTION.pack(self.device_key, self.group_key, self.group_mask)
        flags = ACKNOWLEDGE if acknowledge else 0
        if self.time_ns is not None:
            payload, flags = payload + _TIME.pack(self.time_ns), flags | SCHEDULED
        return CommandPacket(Command.ACTION, payload, request_id, flags)

    @classmethod
    def decode(cls, packet: CommandPacket) -> Action:
        """Raises MalformedPacket."""
        scheduled = bool(packet.flags & SCHEDULED)
        if len(packet.payload) < _ACTION.size + (_TIME.size if scheduled else 0):
            raise MalformedPacket(f"{len(packet.payload)} bytes are no ACTION")
        time_ns = _TIME.unpack_from(packet.payload, _ACTION.size)[0] if scheduled else None
        device_key, group_key, group_mask = _ACTION.unpack_from(packet.payload)
        return cls(device_key, group_key, group_mask, time_ns)
