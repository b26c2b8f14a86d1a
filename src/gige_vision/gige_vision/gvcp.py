"""GVCP, the control protocol of GigE Vision: commands and acknowledges over UDP port 3956.

A command is ``0x42 flags command length request-id`` and its payload, an acknowledge ``status command length
request-id`` and its payload; all fields are big endian. Source: GigE Vision 2.x, "GigE Vision Control Protocol".
"""

from __future__ import annotations

import ipaddress
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from . import bootstrap

PORT = 3956
KEY = 0x42

ACKNOWLEDGE = 0x01
"""Flag of every command: the sender wants an answer."""
ALLOW_BROADCAST_ACK = 0x10
"""Flag of DISCOVERY: the device may answer by broadcast."""
SCHEDULED = 0x80
"""Flag of ACTION: a time of execution follows."""

_HEADER = struct.Struct(">BBHHH")
_ANSWER = struct.Struct(">HHHH")


class MalformedPacket(ValueError):
    """The bytes are no packet of the expected kind."""


def _unpack(layout: struct.Struct, data: bytes, what: str) -> tuple[Any, ...]:
    """Return the fields at the beginning of ``data``. Raises MalformedPacket where it is too short for them."""
    if len(data) < layout.size:
        raise MalformedPacket(f"{len(data)} bytes are no {what}")
    return layout.unpack_from(data)


def _payload(data: bytes, length: int) -> bytes:
    """Return the payload behind a header. Raises MalformedPacket where it is shorter than the header promises."""
    payload = data[_HEADER.size :]
    if len(payload) < length:
        raise MalformedPacket(f"the header promises {length} bytes, {len(payload)} follow")
    return payload[:length]


class Command(IntEnum):
    """Commands; the acknowledge of each is the next odd number."""

    DISCOVERY = 0x0002
    PACKET_RESEND = 0x0040
    READ_REGISTER = 0x0080
    WRITE_REGISTER = 0x0082
    READ_MEMORY = 0x0084
    WRITE_MEMORY = 0x0086
    ACTION = 0x0100

    @property
    def acknowledge(self) -> int:
        return int(self) + 1


class Status(IntEnum):
    """Status codes of acknowledges and of stream packets, as far as they are used here."""

    SUCCESS = 0x0000
    PACKET_RESEND = 0x0100
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    NO_REFERENCE_TIME = 0x8013
    OVERFLOW = 0x8015
    ACTION_LATE = 0x8016


@dataclass(frozen=True)
class CommandPacket:
    """A command as it travels; ``command`` is a plain number, because a device must answer unknown ones too."""

    command: int
    payload: bytes = b""
    request_id: int = 1
    flags: int = ACKNOWLEDGE

    @property
    def wants_answer(self) -> bool:
        return bool(self.flags & ACKNOWLEDGE)

    def encode(self) -> bytes:
        return _HEADER.pack(KEY, self.flags, self.command, len(self.payload), self.request_id) + self.payload

    @classmethod
    def decode(cls, data: bytes) -> CommandPacket:
        """Decode a packet. Raises MalformedPacket."""
        key, flags, command, length, request_id = _unpack(_HEADER, data, "GVCP command")
        if key != KEY:
            raise MalformedPacket(f"a GVCP command begins with 0x{KEY:02x}, not 0x{key:02x}")
        return cls(command, _payload(data, length), request_id, flags)


@dataclass(frozen=True)
class AcknowledgePacket:
    """An answer as it travels; ``acknowledge`` is the command's number plus one."""

    acknowledge: int
    payload: bytes = b""
    request_id: int = 1
    status: int = Status.SUCCESS

    def encode(self) -> bytes:
        return _ANSWER.pack(self.status, self.acknowledge, len(self.payload), self.request_id) + self.payload

    @classmethod
    def decode(cls, data: bytes) -> AcknowledgePacket:
        """Decode a packet. Raises MalformedPacket."""
        status, acknowledge, length, request_id = _unpack(_ANSWER, data, "GVCP acknowledge")
        return cls(acknowledge, _payload(data, length), request_id, status)


# --- payloads: registers, memory, resend requests, actions

PACKET_ID_MASK = 0x00FFFFFF

_WORD, _PAIR = struct.Struct(">I"), struct.Struct(">II")
_RESEND, _READ_MEMORY = struct.Struct(">HHII"), struct.Struct(">IHH")
_SCHEDULED_ACTION = struct.Struct(">IIIQ")


def encode_words(values: Iterable[int]) -> bytes:
    """Encode 32-bit words: the payload of READREG (addresses) and of its acknowledge (values)."""
    return b"".join(_WORD.pack(value) for value in values)


def decode_words(payload: bytes) -> tuple[int, ...]:
    """Decode 32-bit words. Raises MalformedPacket unless the payload is one or more whole words."""
    if not payload or len(payload) % 4:
        raise MalformedPacket(f"{len(payload)} bytes are not a row of 32-bit words")
    return tuple(word for (word,) in _WORD.iter_unpack(payload))


def decode_writes(payload: bytes) -> tuple[tuple[int, int], ...]:
    """Decode pairs of address and value: the payload of WRITEREG. Raises MalformedPacket unless they are whole."""
    if not payload or len(payload) % 8:
        raise MalformedPacket(f"{len(payload)} bytes are not pairs of address and value")
    return tuple(_PAIR.iter_unpack(payload))


def decode_memory_read(payload: bytes) -> tuple[int, int]:
    """Decode the payload of READMEM: address and number of bytes. Raises MalformedPacket."""
    address, _, count = _unpack(_READ_MEMORY, payload, "READMEM")
    return address, count


def encode_memory(address: int, data: bytes) -> bytes:
    """Encode the payload of WRITEMEM and of READMEM's acknowledge: the address and the bytes."""
    return _WORD.pack(address) + data


def decode_memory(payload: bytes) -> tuple[int, bytes]:
    """Decode address and bytes. Raises MalformedPacket."""
    return _unpack(_WORD, payload, "WRITEMEM")[0], payload[4:]


def decode_resend(payload: bytes) -> tuple[int, int, int]:
    """Decode the payload of PACKETRESEND, which is not acknowledged: block, and first and last packet (both included).

    Raises MalformedPacket.
    """
    _, block_id, first, last = _unpack(_RESEND, payload, "PACKETRESEND")
    return block_id, first & PACKET_ID_MASK, last & PACKET_ID_MASK


@dataclass(frozen=True)
class Action:
    """A scheduled ACTION: every device whose keys fit and whose mask meets this one acts at ``time_ns`` of PTP."""

    device_key: int
    group_key: int
    group_mask: int
    time_ns: int

    def command(self, request_id: int = 1) -> CommandPacket:
        payload = _SCHEDULED_ACTION.pack(self.device_key, self.group_key, self.group_mask, self.time_ns)
        return CommandPacket(Command.ACTION, payload, request_id, ACKNOWLEDGE | SCHEDULED)

    @classmethod
    def decode(cls, packet: CommandPacket) -> Action:
        """Decode a packet. Raises MalformedPacket."""
        return cls(*_unpack(_SCHEDULED_ACTION, packet.payload, "scheduled ACTION"))


# --- the answer to DISCOVERY: the first 0xF8 bytes of a device's bootstrap registers

_TEXTS = {
    "manufacturer": (bootstrap.MANUFACTURER_NAME, 32),
    "model": (bootstrap.MODEL_NAME, 32),
    "serial": (bootstrap.SERIAL_NUMBER, 16),
    "user_id": (bootstrap.USER_NAME, 16),
}
_ADDRESSES = {"address": bootstrap.CURRENT_IP, "subnet_mask": bootstrap.CURRENT_SUBNET}


@dataclass(frozen=True)
class DeviceRecord:
    """Identity of a device."""

    address: str
    manufacturer: str = ""
    model: str = ""
    serial: str = ""
    user_id: str = ""
    mac: bytes = bytes(6)
    subnet_mask: str = "255.0.0.0"

    @classmethod
    def decode(cls, record: bytes) -> DeviceRecord:
        """Decode the record. Raises MalformedPacket when it is too short or its texts are not UTF-8."""
        if len(record) < bootstrap.DISCOVERY_SIZE:
            raise MalformedPacket(f"{len(record)} bytes are no discovery record")
        texts = {name: decode_text(record[offset : offset + size]) for name, (offset, size) in _TEXTS.items()}
        addresses = {
            name: str(ipaddress.IPv4Address(record[offset : offset + 4])) for name, offset in _ADDRESSES.items()
        }
        return cls(**texts, **addresses, mac=bytes(record[bootstrap.MAC_HIGH + 2 : bootstrap.MAC_HIGH + 8]))


def encode_text(text: str, size: int) -> bytes:
    """UTF-8, zero-terminated, padded to ``size`` bytes; cut at a character where it is too long."""
    data = text.encode()
    if len(data) >= size:
        data = data[: size - 1].decode(errors="ignore").encode()
    return data.ljust(size, b"\0")


def decode_text(data: bytes) -> str:
    """Return the text up to the first zero. Raises MalformedPacket when it is not UTF-8."""
    try:
        return bytes(data).split(b"\0", 1)[0].decode()
    except UnicodeDecodeError as error:
        raise MalformedPacket(f"a text of the device is not UTF-8 ({error})") from None
