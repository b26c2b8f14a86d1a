"""GVCP, the control protocol of GigE Vision: commands and acknowledges over UDP port 3956.

A command is ``0x42 flags command length request-id`` and its payload, an acknowledge ``status command length
request-id`` and its payload; all fields are big endian. Source: GigE Vision 2.x, "GigE Vision Control Protocol".
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

PORT = 3956
KEY = 0x42
MAX_DATA = 536
"""Bytes of payload a GVCP packet can carry: 576 of IP, less the headers of IP, UDP and GVCP."""

ACKNOWLEDGE = 0x01
"""Flag of every command: the sender wants an answer."""
ALLOW_BROADCAST_ACK = 0x10
"""Flag of DISCOVERY: the device may answer by broadcast."""
EXTENDED_IDS = 0x10
"""Flag of PACKETRESEND: block ids of 64 bits."""
SCHEDULED = 0x80
"""Flag of ACTION: a time of execution follows."""

_HEADER = struct.Struct(">BBHHH")
_ANSWER = struct.Struct(">HHHH")


class MalformedPacket(ValueError):
    """The bytes are no packet of the expected kind."""


class Command(IntEnum):
    """Commands; the acknowledge of each is the next odd number."""

    DISCOVERY = 0x0002
    FORCE_IP = 0x0004
    PACKET_RESEND = 0x0040
    READ_REGISTER = 0x0080
    WRITE_REGISTER = 0x0082
    READ_MEMORY = 0x0084
    WRITE_MEMORY = 0x0086
    PENDING = 0x0088  # exists as acknowledge only
    EVENT = 0x00C0
    EVENT_DATA = 0x00C2
    ACTION = 0x0100

    @property
    def acknowledge(self) -> int:
        return int(self) + 1


class Status(IntEnum):
    """Status codes of acknowledges and of stream packets."""

    SUCCESS = 0x0000
    PACKET_RESEND = 0x0100
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    BUSY = 0x8007
    LOCAL_PROBLEM = 0x8008
    MESSAGE_MISMATCH = 0x8009
    INVALID_PROTOCOL = 0x800A
    NO_MESSAGE = 0x800B
    PACKET_UNAVAILABLE = 0x800C
    DATA_OVERRUN = 0x800D
    INVALID_HEADER = 0x800E
    WRONG_CONFIG = 0x800F
    PACKET_NOT_YET_AVAILABLE = 0x8010
    PACKET_AND_PREVIOUS_REMOVED = 0x8011
    PACKET_REMOVED = 0x8012
    NO_REFERENCE_TIME = 0x8013
    PACKET_TEMPORARILY_UNAVAILABLE = 0x8014
    OVERFLOW = 0x8015
    ACTION_LATE = 0x8016
    LEADER_TRAILER_OVERFLOW = 0x8017
    ERROR = 0x8FFF


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
        """Raises MalformedPacket."""
        if len(data) < _HEADER.size:
            raise MalformedPacket(f"{len(data)} bytes are no GVCP command")
        key, flags, command, length, request_id = _HEADER.unpack_from(data)
        if key != KEY:
            raise MalformedPacket(f"a GVCP command begins with 0x{KEY:02x}, not 0x{key:02x}")
        if len(data) < _HEADER.size + length:
            raise MalformedPacket(f"the header promises {length} bytes, {len(data) - _HEADER.size} follow")
        return cls(command, data[_HEADER.size : _HEADER.size + length], request_id, flags)


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
        """Raises MalformedPacket."""
        if len(data) < _ANSWER.size:
            raise MalformedPacket(f"{len(data)} bytes are no GVCP acknowledge")
        status, acknowledge, length, request_id = _ANSWER.unpack_from(data)
        if len(data) < _ANSWER.size + length:
            raise MalformedPacket(f"the header promises {length} bytes, {len(data) - _ANSWER.size} follow")
        return cls(acknowledge, data[_ANSWER.size : _ANSWER.size + length], request_id, status)


def status_text(status: int) -> str:
    """A status code in words, such as "access denied (0x8006)"."""
    try:
        return f"{Status(status).name.lower().replace('_', ' ')} (0x{status:04x})"
    except ValueError:
        return f"unknown status 0x{status:04x}"
