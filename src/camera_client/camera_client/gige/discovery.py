"""Finds a camera by its IP address (asking no other device), or by serial number or name on a given interface.

Aravis's own discovery broadcasts on every interface of the machine, the office network too; this one does not.
"""

from __future__ import annotations

import ipaddress
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass

import psutil

from capture_rig.errors import InputError
from gige_vision.gvcp import (
    ALLOW_BROADCAST_ACK,
    PORT,
    AcknowledgePacket,
    Command,
    CommandPacket,
    DeviceRecord,
    MalformedPacket,
)

from ..frame_source import SourceUnavailable
from ..settings import AravisSettings

DISCOVERY = CommandPacket(Command.DISCOVERY)
ANSWER_TIMEOUT_S, ATTEMPTS = 0.3, 3
LISTEN_S = ATTEMPTS * ANSWER_TIMEOUT_S  # to a broadcast's answers: the standard gives a device up to 1 s
BROADCAST = "255.255.255.255"


@dataclass(frozen=True)
class FoundCamera:
    """A camera that answered, and our own IPv4 address on the way to it."""

    device: DeviceRecord
    host: str


def described(wanted: AravisSettings) -> str:
    """Return which camera is wanted, in words: the one at an address, or with a serial number or user-defined name."""
    named = {"serial": wanted.serial, "user id": wanted.user_id}
    words = [f"{name} {value}" for name, value in named.items() if value]
    return "camera " + (wanted.address or " and ".join(words) or "(not chosen)")


def find_camera(wanted: AravisSettings) -> FoundCamera:
    """Return the one camera that is ``wanted``.

    With an address, the discovery command goes to this address alone. Without, it is broadcast on the interface named,
    and only there. Raises SourceUnavailable when it does not answer, InputError when the choice is unclear, another
    camera answers at the address, or the camera cannot be reached from its subnet.
    """
    if wanted.address:
        found = discover_at(wanted.address)
        if not _fits(found.device, wanted):
            raise InputError(
                f"is {_named(found.device)}, not serial {wanted.serial or '(any)'} and user id "
                f"{wanted.user_id or '(any)'}",
                where=described(wanted),
                remedy="Correct aravis.address, or aravis.serial and aravis.user_id.",
            )
        return found
    if not (wanted.serial or wanted.user_id):
        raise InputError(
            "no camera is chosen",
            where="aravis.address",
            remedy="Give aravis.address, aravis.serial or aravis.user_id.",
        )
    link = select_interface(wanted.interface)
    return FoundCamera(_single_match(discover_on(link), wanted, link), link.host)


def discover_at(address: str) -> FoundCamera:
    """The camera at an IPv4 address. Raises InputError for an address of no device, SourceUnavailable for silence."""
    try:
        ip = ipaddress.IPv4Address(address)
    except ValueError:
        ip = ipaddress.IPv4Address(0)
    if ip.is_multicast or ip.is_unspecified or ip.packed[3] == 255:
        remedy = "Give the camera's address, such as 192.168.1.10."
        raise InputError(f"{address!r} is not the IPv4 address of one device", where="aravis.address", remedy=remedy)
    reason = "nothing answered"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        try:
            link.connect((address, PORT))
            for _ in range(ATTEMPTS):
                link.send(DISCOVERY.encode())
                for device in _answers(link, time.monotonic() + ANSWER_TIMEOUT_S):
                    return FoundCamera(device, link.getsockname()[0])
        except OSError as error:
            reason = error.strerror or str(error)
    raise SourceUnavailable(
        f"no GigE Vision camera answers at {address} ({reason})",
        where="aravis.address",
        remedy="Check power, cable, and that camera and host share a subnet (ping it).",
    )


def discover_on(link: Interface, listen_s: float = LISTEN_S) -> tuple[DeviceRecord, ...]:
    """Broadcast a discovery on one interface and collect the answers, each camera once, in the order of serials.

    Raises InputError when the system does not let us.
    """
    found: dict[bytes, DeviceRecord] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, link.name.encode() + b"\0")
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            sock.bind(("", 0))  # an answer from another subnet comes by broadcast
            flags = DISCOVERY.flags | ALLOW_BROADCAST_ACK
            sock.sendto(CommandPacket(Command.DISCOVERY, flags=flags).encode(), (BROADCAST, PORT))
        except OSError as error:
            raise InputError(
                f"cannot broadcast on {link} ({error.strerror})",
                where="aravis.interface",
                remedy="Give aravis.address instead, or another interface.",
            ) from None
        for device in _answers(sock, time.monotonic() + listen_s):
            found[device.mac + device.address.encode()] = device
    return tuple(sorted(found.values(), key=lambda device: (device.serial, device.address)))


def select_interface(name: str) -> Interface:
    """Return the interface with this name or own address. Raises InputError with a list."""
    present = interfaces()
    for link in present:
        if name in (link.name, link.host):
            return link
    what = f"there is no interface {name!r} with an IPv4 address" if name else "a search needs an interface"
    listed = ", ".join(map(str, present)) or "none"
    remedy = f"Name one of: {listed}. Or give aravis.address."
    raise InputError(what, where="aravis.interface", remedy=remedy)


def _single_match(answers: tuple[DeviceRecord, ...], wanted: AravisSettings, link: Interface) -> DeviceRecord:
    fitting, who = [device for device in answers if _fits(device, wanted)], described(wanted)
    if not fitting:
        others = ", ".join(map(_named, answers)) or "no camera"
        remedy = "Check power and cable, and the serial number or user id."
        raise SourceUnavailable(f"does not answer on {link}; {others} did", where=who, remedy=remedy)
    if len(fitting) > 1:
        what = f"is not one camera but {len(fitting)} on {link}: {', '.join(map(_named, fitting))}"
        raise InputError(what, where=who, remedy="Choose by aravis.serial or aravis.address.")
    [device] = fitting
    if ipaddress.IPv4Address(device.address) not in link.address.network:
        raise InputError(
            f"answers on {link}, but its own address {device.address}/{device.subnet_mask} is in another subnet",
            where=who,
            remedy=f"Give the camera a free address in {link.address.network} (its maker's IP tool, or DHCP), or this "
            "interface one in the camera's subnet.",
        )
    return device


def _fits(device: DeviceRecord, wanted: AravisSettings) -> bool:
    return wanted.serial in ("", device.serial) and wanted.user_id in ("", device.user_id)


def _named(device: DeviceRecord) -> str:
    user_id = f", user id {device.user_id}" if device.user_id else ""
    return f"{device.manufacturer} {device.model} (serial {device.serial}{user_id}) at {device.address}"


def _answers(sock: socket.socket, deadline_s: float) -> Iterator[DeviceRecord]:
    """Yield the devices that answer the discovery until then, ignoring other packets."""
    while (left_s := deadline_s - time.monotonic()) > 0:
        sock.settimeout(left_s)
        try:
            answer = AcknowledgePacket.decode(sock.recv(2048))
            if answer.acknowledge == Command.DISCOVERY.acknowledge and answer.status == 0:
                yield DeviceRecord.decode(answer.payload)
        except TimeoutError:
            return
        except MalformedPacket:
            continue


# --- the host's network interfaces


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
    """Return this machine's interfaces that have an IPv4 address."""
    found = []
    for name, entries in psutil.net_if_addrs().items():
        for entry in [entry for entry in entries if entry.family == socket.AF_INET][:1]:
            found.append(Interface(name, ipaddress.IPv4Interface(f"{entry.address}/{entry.netmask or 32}")))
    return tuple(found)
