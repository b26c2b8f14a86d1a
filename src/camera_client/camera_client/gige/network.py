"""Our own side of the link to a camera: network interfaces, and a socket that is large enough to stream through."""

from __future__ import annotations

import fcntl
import ipaddress
import os
import socket
import stat
import struct
from dataclasses import dataclass

_SIOCGIFADDR, _SIOCGIFNETMASK = 0x8915, 0x891B
_IFREQ = struct.Struct("256s")


@dataclass(frozen=True)
class Interface:
    """A network interface with its first IPv4 address."""

    name: str
    address: ipaddress.IPv4Interface

    @property
    def host(self) -> str:
        return str(self.address.ip)

    def __str__(self) -> str:
        return f"{self.name} ({self.address})"


def interfaces() -> tuple[Interface, ...]:
    """This machine's interfaces that have an IPv4 address."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for _, name in socket.if_nameindex():
            try:
                address, mask = (_ask(any_socket, what, name) for what in (_SIOCGIFADDR, _SIOCGIFNETMASK))
            except OSError:  # it has none
                continue
            found.append(Interface(name, ipaddress.IPv4Interface(f"{address}/{mask}")))
    return tuple(found)


def _ask(any_socket: socket.socket, what: int, name: str) -> str:
    answer = fcntl.ioctl(any_socket.fileno(), what, _IFREQ.pack(name.encode()))
    return socket.inet_ntoa(answer[20:24])


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
