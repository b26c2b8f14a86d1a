"""Hears nodes of other machines announce themselves, in every ROS domain, whether or not they can be reached.

Every process announces itself by multicast every three seconds, with our profile five times in three (RTPS 2.3: 8.5.3,
9.6.1.1). The packet's first twenty bytes name the middleware and the machine, its port the ROS domain. Nothing is sent
to find them.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from collections.abc import Sequence
from dataclasses import dataclass

from .network import DOMAIN_PORTS, FIRST_PORT, HIGHEST_DOMAIN, collect_interfaces

FAST_DDS = b"\x01\x0f"  # the vendor's number, with which its GUIDs begin; the next two bytes are the machine's
GROUP = "239.255.0.1"
MAGIC, PREFIX = b"RTPS", slice(8, 20)
LOOPBACK = "127.0.0.1"
POLL_S = 0.2
PACKET_BYTES = 65536


@dataclass(frozen=True)
class Announcement:
    """A process of this ROS domain announced itself from this address; ``machine`` : the middleware's number of it."""

    domain: int
    address: str
    machine: str


def machine_of(gid: Sequence[int]) -> str:
    """Return the machine's number in a GUID, where the middleware is Fast DDS; else ""."""
    prefix = bytes(gid[:4])
    return prefix[2:].hex() if prefix[:2] == FAST_DDS else ""


class AnnouncementListener:
    """Collects announcements in every ROS domain while it is open; ``loopback_only`` joins no other interface."""

    def __init__(self, loopback_only: bool) -> None:
        addresses = [LOOPBACK] if loopback_only else [LOOPBACK, *(i.address for i in collect_interfaces() if i.up)]
        self._sockets = {}
        for domain in range(HIGHEST_DOMAIN + 1):
            with contextlib.suppress(OSError):  # another program holds the port
                self._sockets[_listener(domain, addresses)] = domain
        self._heard: set[Announcement] = set()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="announcements", daemon=True)

    @property
    def heard(self) -> tuple[Announcement, ...]:
        """The announcements so far, in order of domain and address."""
        return tuple(sorted(set(self._heard), key=lambda one: (one.domain, one.address, one.machine)))

    def __enter__(self) -> AnnouncementListener:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.set()
        self._thread.join()
        for link in self._sockets:
            link.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            ready, _, _ = select.select(list(self._sockets), [], [], POLL_S)
            for link in ready:
                packet, (address, _) = link.recvfrom(PACKET_BYTES)
                if packet.startswith(MAGIC):
                    self._heard.add(Announcement(self._sockets[link], address, machine_of(packet[PREFIX])))


def _listener(domain: int, addresses: Sequence[str]) -> socket.socket:
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        link.bind((GROUP, FIRST_PORT + DOMAIN_PORTS * domain))
        for address in addresses:
            with contextlib.suppress(OSError):  # an interface without multicast
                link.setsockopt(
                    socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + socket.inet_aton(address)
                )
    except OSError:
        link.close()
        raise
    return link
