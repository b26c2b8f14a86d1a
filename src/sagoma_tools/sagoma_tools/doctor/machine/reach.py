"""Does another machine answer, and do packets as large as the interface sends get there whole?

A UDP packet to a port where nobody listens is answered by its receiver's kernel (ICMP port unreachable), which a
connected socket sees as "connection refused": proof that the packet arrived, without privileges and without a program
at the other end. With the don't-fragment bit, it proves that the whole way carries packets of that size.
"""

from __future__ import annotations

import contextlib
import errno
import socket
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..collect import collect_interface
from ..facts import InterfaceFacts
from ..findings import Finding, error, note, ok, on, warning

CLOSED_PORT = 33434  # where traceroute begins: nobody listens there
HEADERS = 28  # IPv4 and UDP
SMALL_BYTES = 64
ATTEMPTS, ANSWER_S = 3, 0.3
IP_MTU_DISCOVER, IP_PMTUDISC_PROBE = 10, 3  # linux/in.h: don't fragment, and ignore what was learned before
SIZES = (9000, 1500, 1400, 1280)


@dataclass(frozen=True)
class ReachFacts:
    """The way to another machine: the interface it takes (None: none), whether a small packet is answered, and the
    largest packet of :data:`SIZES` (at most the interface's MTU) that gets there."""

    address: str
    interface: InterfaceFacts | None
    answers: bool = False
    largest: int = 0


def examine_hosts(addresses: Sequence[str]) -> Iterator[Finding]:
    """Findings on the ways to these machines."""
    for address in addresses:
        yield from on(f"machine {address}", check_reach(collect_reach(address)))


def collect_reach(address: str) -> ReachFacts:
    """Send a few packets to ``address``, and only there."""
    interface = collect_interface(address)
    if interface is None or not _arrives(address, SMALL_BYTES):
        return ReachFacts(address, interface)
    largest_tried = min(interface.mtu, max(SIZES))
    sizes = [largest_tried, *(size for size in SIZES if size < largest_tried)]
    return ReachFacts(address, interface, True, next((size for size in sizes if _arrives(address, size)), 0))


def check_reach(facts: ReachFacts) -> Iterator[Finding]:
    """Is there a way, does it answer, does it carry whole packets?"""
    if facts.interface is None:
        yield error(
            "way",
            f"there is no way to {facts.address} from this machine",
            f"Check the address; see: ip route get {facts.address}",
        )
    elif not facts.answers:
        yield warning(
            "answer",
            f"{facts.address} does not answer through {facts.interface.name}: it is off, or a firewall is silent",
            f"ping {facts.address}; open UDP between the machines.",
        )
    elif facts.largest >= min(facts.interface.mtu, max(SIZES)):
        yield ok("mtu", f"packets of {facts.largest} bytes reach {facts.address} through {facts.interface.name}")
    else:
        name, reach = facts.interface.name, f"{facts.largest or f'less than {SIZES[-1]}'} bytes at most"
        yield error(
            "mtu",
            f"{name} sends packets of {facts.interface.mtu} bytes, but {reach} reach {facts.address}: "
            "larger messages vanish",
            "Give both machines and the switch between them one MTU: "
            f"sudo ip link set {name} mtu {facts.largest or SIZES[-1]}, or raise the others'.",
        )
    if facts.interface is not None and facts.interface.loopback:
        yield note("way", f"{facts.address} is this machine")


def _arrives(address: str, size: int) -> bool:
    """Whether a packet of ``size`` bytes, headers included, is answered by "nobody listens here"."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(ANSWER_S)
        link.setsockopt(socket.IPPROTO_IP, IP_MTU_DISCOVER, IP_PMTUDISC_PROBE)
        link.connect((address, CLOSED_PORT))
        for _ in range(ATTEMPTS):
            try:
                link.send(bytes(size - HEADERS))
                link.recv(1)
            except ConnectionRefusedError:
                return True
            except TimeoutError:
                continue
            except OSError as problem:
                if problem.errno in (errno.EMSGSIZE, errno.EHOSTUNREACH, errno.ENETUNREACH):
                    return False
                with contextlib.suppress(OSError):
                    link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    return False
