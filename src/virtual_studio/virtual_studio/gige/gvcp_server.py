"""The control channel of a camera (GVCP): answers commands from its registers; one application has control."""

from __future__ import annotations

import errno
import ipaddress
import socket
import time

from capture_rig.errors import InputError
from gige_vision import bootstrap
from gige_vision.bootstrap import CONTROL
from gige_vision.gvcp import (
    PORT,
    AcknowledgePacket,
    Action,
    Command,
    CommandPacket,
    MalformedPacket,
    Status,
    decode_memory,
    decode_memory_read,
    decode_resend,
    decode_words,
    decode_writes,
    encode_memory,
    encode_words,
)

from .acquisition import Acquisition
from .device import Device
from .loop import Timer
from .registers import RegisterError
from .stream import StreamChannel

Peer = tuple[str, int]
LARGEST_COMMAND = 2048


class GvcpServer:
    """Serves one camera's control channel on its address, port 3956. Raises InputError if the address is not free.

    ``owner`` is the application that has control: the first to request it, until it releases it or its heartbeat stops;
    then the acquisition ends.
    """

    def __init__(self, device: Device, acquisition: Acquisition, stream: StreamChannel) -> None:
        self._registers, self._faults, self._counters = device.registers, device.faults, device.counters
        self._loop, self._acquisition, self._stream = device.loop, acquisition, stream
        self._socket = _bound(device.address)
        self._loop.add_reader(self._socket, self._receive)
        device.registers.writes["GevHeartbeatTimeout"] = self._watch
        self.owner: Peer | None = None
        self._heard_ns = 0
        self._timer: Timer | None = None

    def close(self) -> None:
        self._release()
        self._loop.remove_reader(self._socket)
        self._socket.close()

    def _request_control(self, peer: Peer, value: int) -> None:
        """Handle a write to the privilege register. Raises RegisterError (access denied) while a peer owns it."""
        if self.owner not in (None, peer):
            raise RegisterError(Status.ACCESS_DENIED)
        if not value & CONTROL:
            if self.owner is not None:
                self._release()
            return
        self._registers["ControlPrivilege"] = CONTROL
        self._registers["PrimaryPort"] = peer[1]
        self._registers["PrimaryAddress"] = int(ipaddress.IPv4Address(peer[0]))
        self.owner, self._heard_ns = peer, time.monotonic_ns()
        self._watch()

    def _release(self) -> None:
        """Free the control, and end the stream."""
        self.owner = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for key in ("ControlPrivilege", "PrimaryPort", "PrimaryAddress", "GevSCPHostPort", "GevSCDA"):
            self._registers[key] = 0
        self._acquisition.stop()

    def _watch(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        if self.owner is None:
            return
        left_ns = self._registers.integer("GevHeartbeatTimeout") * 1_000_000 - (time.monotonic_ns() - self._heard_ns)
        if left_ns <= 0:
            self._counters["heartbeats_lost"] += 1
            self._release()
            return
        self._timer = self._loop.call_later(left_ns, self._watch)

    def _receive(self) -> None:
        while True:
            try:
                data, peer = self._socket.recvfrom(LARGEST_COMMAND)
            except OSError:  # nothing more
                return
            if self._faults.unplugged:
                continue
            try:
                self._handle(CommandPacket.decode(data), peer)
            except MalformedPacket:
                self._counters["malformed_commands"] += 1

    def _handle(self, packet: CommandPacket, peer: Peer) -> None:
        self._counters["commands"] += 1
        if peer == self.owner:  # any command of the owner is a heartbeat
            self._heard_ns = time.monotonic_ns()
        if packet.command == Command.PACKET_RESEND:
            # stream receivers send requests from a socket of their own, on the owner's machine
            if self.owner is not None and self.owner[0] == peer[0]:
                self._stream.resend(*decode_resend(packet.payload))
            return
        answer = self._answer(packet, peer)
        if answer is not None and packet.wants_answer:
            self._send(answer, peer)

    def _answer(self, packet: CommandPacket, peer: Peer) -> AcknowledgePacket | None:
        """Return the answer to a command; None for an action that is meant for other cameras."""
        status, payload = Status.SUCCESS, b""
        try:
            if packet.command != Command.ACTION:
                payload = self._payload(packet, peer)
            elif not self._acquisition.execute_action(Action.decode(packet)):
                return None
        except RegisterError as error:
            status = error.status
        return AcknowledgePacket(packet.command + 1, payload, packet.request_id, status)

    def _payload(self, packet: CommandPacket, peer: Peer) -> bytes:
        registers, payload = self._registers, packet.payload
        if packet.command == Command.DISCOVERY:
            return registers.read(0, bootstrap.DISCOVERY_SIZE)
        if packet.command == Command.READ_REGISTER:
            return b"".join(registers.read(address, 4) for address in decode_words(payload))
        if packet.command == Command.READ_MEMORY:
            address, size = decode_memory_read(payload)
            return encode_memory(address, registers.read(address, size))
        if packet.command == Command.WRITE_REGISTER:
            for address, value in decode_writes(payload):
                self._write(address, value.to_bytes(4, "big"), peer)
            return encode_words([len(payload) // 8])
        if packet.command == Command.WRITE_MEMORY:
            address, data = decode_memory(payload)
            self._write(address, data, peer)
            return encode_words([len(data)])
        raise RegisterError(Status.NOT_IMPLEMENTED)

    def _write(self, address: int, data: bytes, peer: Peer) -> None:
        if address == bootstrap.CONTROL_PRIVILEGE and len(data) == 4:
            self._request_control(peer, int.from_bytes(data, "big"))
            return
        if self.owner != peer:
            raise RegisterError(Status.ACCESS_DENIED)
        self._registers.write(address, data)

    def _send(self, answer: AcknowledgePacket, peer: Peer) -> None:
        try:
            self._socket.sendto(answer.encode(), peer)
        except OSError:  # the peer is gone, or this camera was switched off meanwhile
            self._counters["answers_lost"] += 1


def _bound(address: str) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        sock.bind((address, PORT))
    except OSError as error:
        sock.close()
        reason = "another camera is there" if error.errno == errno.EADDRINUSE else error.strerror
        raise InputError(
            f"cannot listen on port {PORT} ({reason})",
            where=f"camera {address}",
            remedy="Choose another loopback address (127.x.y.z).",
        ) from None
    return sock
