"""Listens to how ROS nodes announce themselves by multicast, in every domain: who is out there, and at which address.

Nothing is sent. Each process announces itself every three seconds (RTPS 2.3: 8.5.3, 9.6.1.1); the packet's first twenty
bytes say which middleware and which machine, the port says which domain.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from collections.abc import Sequence
from types import TracebackType

from ..machine.collect_network import DOMAIN_PORTS, FIRST_PORT, HIGHEST_DOMAIN, collect_interfaces
from .facts import Announcement
from .middleware import machine_of

GROUP = "239.255.0.1"
MAGIC, PREFIX = b"RTPS", slice(8, 20)
LOOPBACK = "127.0.0.1"
LOOK_S = 0.2
PACKET_BYTES = 65536


class AnnouncementEar:
    """Collects announcements while it is open; a context manager. ``loopback_only`` joins no other interface."""

    def __init__(self, loopback_only: bool) -> None:
        addresses = [LOOPBACK] if loopback_only else [LOOPBACK, *(i.address for i in collect_interfaces() if i.up)]
        self._sockets = {}
        for domain in range(HIGHEST_DOMAIN + 1):
            with contextlib.suppress(OSError):  # a port that somebody else holds for himself
                self._sockets[_listener(domain, addresses)] = domain
        self._heard: set[Announcement] = set()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="announcements", daemon=True)

    @property
    def heard(self) -> tuple[Announcement, ...]:
        """What came so far, in order of domain and address."""
        return tuple(sorted(set(self._heard), key=lambda one: (one.domain, one.address, one.machine)))

    def __enter__(self) -> AnnouncementEar:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._thread.join()
        for link in self._sockets:
            link.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            ready, _, _ = select.select(list(self._sockets), [], [], LOOK_S)
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
