"""Loopback addresses for simulated cameras."""

from __future__ import annotations

import ipaddress
import random
import socket

from capture_rig.errors import InputError
from gige_vision.gvcp import PORT

FIRST, LAST = int(ipaddress.IPv4Address("127.0.32.1")), int(ipaddress.IPv4Address("127.255.255.200"))
_ATTEMPTS = 1000


def free_addresses(count: int) -> list[str]:
    """Finds so many loopback addresses whose GVCP port is free; another call gives other ones.

    Raises InputError where the system lends none (a system without the whole of 127.0.0.0/8).
    """
    found: list[str] = []
    for _ in range(_ATTEMPTS):
        if len(found) == count:
            return found
        address = str(ipaddress.IPv4Address(random.randint(FIRST, LAST)))
        if not address.endswith((".0", ".255")) and address not in found and is_free(address):
            found.append(address)
    raise InputError(
        f"found only {len(found)} of {count} free loopback addresses",
        where=f"port {PORT}",
        remedy="Simulated cameras need the whole of 127.0.0.0/8 on the loopback interface.",
    )


def is_free(address: str) -> bool:
    """Tells whether a camera can listen at this address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, PORT))
        except OSError:
            return False
        return True


def consecutive_addresses(first: str, count: int) -> list[str]:
    """Lists ``count`` addresses from ``first`` on. Raises InputError unless all are unicast loopback addresses."""
    try:
        addresses = [ipaddress.IPv4Address(first) + i for i in range(count)]
    except ipaddress.AddressValueError:
        addresses = []
    if not addresses or not all(a.is_loopback and a.packed[3] not in (0, 255) for a in addresses):
        raise InputError(
            f"{count} cameras from address {first!r} on are not on the loopback interface",
            where="--address",
            remedy="Give an address such as 127.0.1.1.",
        )
    return [str(a) for a in addresses]
