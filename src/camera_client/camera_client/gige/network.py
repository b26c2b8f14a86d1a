"""The network side of a GigE Vision camera that Aravis leaves to us: is it there, and can we receive fast enough."""

from __future__ import annotations

import ipaddress
import os
import socket
import stat
import struct

from capture_rig.errors import InputError

GVCP_PORT = 3956
DISCOVERY_COMMAND = struct.pack(">BBHHH", 0x42, 0x01, 0x0002, 0, 1)  # key, "answer me", DISCOVERY_CMD, 0 bytes, id 1
DISCOVERY_ACK = 0x0003
ANSWER_TIMEOUT_S, ATTEMPTS = 0.3, 3


def host_address_for(address: str) -> str:
    """Our own IPv4 address on the way to the camera at ``address``, after the camera has answered there.

    Sends the GVCP discovery command to this one address (never to a broadcast address). Raises InputError when
    ``address`` is no IPv4 unicast address or no GigE Vision camera answers.
    """
    where = "aravis.address"
    try:
        ip = ipaddress.IPv4Address(address)
    except ValueError:
        raise InputError(f"{address!r} is not an IPv4 address", where=where,
                         remedy="Give the camera's address, such as 192.168.1.10.") from None  # fmt: skip
    if ip.is_multicast or ip.is_unspecified or str(ip).endswith(".255"):
        raise InputError(f"{address} is not the address of one device", where=where, remedy="Give the camera's own.")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(ANSWER_TIMEOUT_S)
        try:
            link.connect((address, GVCP_PORT))
            if any(_answers(link) for _ in range(ATTEMPTS)):
                return link.getsockname()[0]
            reason = "nothing answered"
        except OSError as error:
            reason = error.strerror or str(error)
    raise InputError(f"no GigE Vision camera answers at {address} ({reason})", where=where,
                     remedy="Check power, cable, and that camera and host share a subnet (ping it).")  # fmt: skip


def _answers(link: socket.socket) -> bool:
    link.send(DISCOVERY_COMMAND)
    try:
        answer = link.recv(1024)
    except TimeoutError:
        return False
    return len(answer) >= 8 and struct.unpack(">HHHH", answer[:8])[1] == DISCOVERY_ACK


def enlarge_receive_buffer(port: int, wanted_bytes: int) -> str:
    """Set SO_RCVBUF of this process's UDP socket bound to ``port``; returns a warning, "" when all is well.

    Aravis sizes the socket only when the first packet has come, by which time most of the first frames are lost; its
    socket is found among the process's own descriptors.
    """
    for name in os.listdir("/proc/self/fd"):
        try:
            if not stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                continue
            candidate = socket.socket(fileno=os.dup(int(name)))
        except OSError:  # closed meanwhile
            continue
        with candidate:
            if _is_udp_on(candidate, port):
                candidate.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted_bytes)
                return _buffer_warning(candidate, wanted_bytes)
    return f"the stream's socket on port {port} was not found; its receive buffer stays at the system's default"


def _is_udp_on(candidate: socket.socket, port: int) -> bool:
    try:
        return (
            candidate.family == socket.AF_INET
            and candidate.type == socket.SOCK_DGRAM
            and candidate.getsockname()[1] == port
        )
    except OSError:
        return False


def _buffer_warning(link: socket.socket, wanted_bytes: int) -> str:
    granted = link.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # Linux reports twice the payload size
    if granted >= wanted_bytes:
        return ""
    return (
        f"the system grants a receive buffer of {granted} bytes instead of {wanted_bytes}, frames may be lost; "
        f"run: sudo sysctl -w net.core.rmem_max={wanted_bytes}"
    )
