"""Finding a camera: by its IP address (asking nobody else), or by serial number or name on a given interface.

Aravis's own discovery broadcasts on every interface of the machine, the office network too; this one does not.
"""

from __future__ import annotations

import ipaddress
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass

from capture_rig.errors import InputError
from gige_vision.discovery import DeviceRecord
from gige_vision.gvcp import ALLOW_BROADCAST_ACK, PORT, AcknowledgePacket, Command, CommandPacket, MalformedPacket

from ..frame_source import SourceUnavailable
from .network import Interface, interfaces

DISCOVERY = CommandPacket(Command.DISCOVERY)
ANSWER_TIMEOUT_S, ATTEMPTS = 0.3, 3
LISTEN_S = 0.5  # to a broadcast's answers: the standard gives a device up to 1 s, those we met took milliseconds
BROADCAST = "255.255.255.255"


@dataclass(frozen=True)
class Found:
    """A camera that answered, and our own IPv4 address on the way to it."""

    device: DeviceRecord
    host: str


@dataclass(frozen=True)
class Wanted:
    """Which camera: at an address, or with a serial number or user-defined name on an interface; "" is any.

    ``interface``: names or own addresses of interfaces, separated by commas.
    """

    address: str = ""
    serial: str = ""
    user_id: str = ""
    interface: str = ""

    def __str__(self) -> str:
        named = {"serial": self.serial, "user id": self.user_id}
        words = [f"{name} {value}" for name, value in named.items() if value]
        return "camera " + (self.address or " and ".join(words) or "(not chosen)")


def find_camera(wanted: Wanted) -> Found:
    """The one camera that is ``wanted``.

    With an address, the discovery command goes to this address alone. Without, it is broadcast on the interfaces named,
    and only there. Raises SourceUnavailable when it does not answer, InputError when the choice is unclear, another
    camera answers at the address, or the camera cannot be reached from its subnet.
    """
    if wanted.address:
        found = at_address(wanted.address)
        _verify(found.device, wanted)
        return found
    if not (wanted.serial or wanted.user_id):
        raise InputError(
            "no camera is chosen",
            where="aravis.address",
            remedy="Give aravis.address, aravis.serial or aravis.user_id.",
        )
    chosen = chosen_interfaces(wanted.interface)
    answers = [(link, device) for link in chosen for device in listen(link)]
    return _the_one(answers, wanted, chosen)


def at_address(address: str) -> Found:
    """The camera at an IPv4 address. Raises InputError for what is no unicast address, else SourceUnavailable."""
    _check_unicast(address)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(ANSWER_TIMEOUT_S)
        try:
            link.connect((address, PORT))
            for _ in range(ATTEMPTS):
                if (device := _ask(link)) is not None:
                    return Found(device, link.getsockname()[0])
            reason = "nothing answered"
        except OSError as error:
            reason = error.strerror or str(error)
    raise SourceUnavailable(
        f"no GigE Vision camera answers at {address} ({reason})",
        where="aravis.address",
        remedy="Check power, cable, and that camera and host share a subnet (ping it).",
    )


def listen(link: Interface, listen_s: float = LISTEN_S) -> tuple[DeviceRecord, ...]:
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


def chosen_interfaces(names: str) -> tuple[Interface, ...]:
    """The interfaces with these names or own addresses (separated by commas). Raises InputError with a list."""
    present = interfaces()
    listed = ", ".join(map(str, present)) or "none"
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    if not wanted:
        raise InputError(
            "a search by serial or user id needs an interface to search on",
            where="aravis.interface",
            remedy=f"Name one or more of: {listed}. Or give aravis.address.",
        )
    chosen = []
    for name in wanted:
        fitting = [link for link in present if name in (link.name, link.host)]
        if not fitting:
            raise InputError(
                f"there is no interface {name!r} with an IPv4 address",
                where="aravis.interface",
                remedy=f"This machine has: {listed}.",
            )
        chosen.append(fitting[0])
    return tuple(dict.fromkeys(chosen))


def _the_one(answers: list[tuple[Interface, DeviceRecord]], wanted: Wanted, asked: tuple[Interface, ...]) -> Found:
    fitting = [(link, device) for link, device in answers if _fits(device, wanted)]
    on = ", ".join(map(str, asked))
    if not fitting:
        heard = ", ".join(_named(device) for _, device in answers) or "nobody"
        raise SourceUnavailable(
            f"does not answer on {on}; {heard} did",
            where=str(wanted),
            remedy="Check power and cable, and the serial number or user id.",
        )
    link, device = fitting[0]
    if any(other.mac != device.mac for _, other in fitting):
        raise InputError(
            f"is not one camera but {len(fitting)} on {on}: {', '.join(_named(d) for _, d in fitting)}",
            where=str(wanted),
            remedy="Choose by aravis.serial or aravis.address.",
        )
    reachable = [other for other, _ in fitting if ipaddress.IPv4Address(device.address) in other.address.network]
    if not reachable:
        raise InputError(
            f"answers on {link}, but its own address {device.address}/{device.subnet_mask} is in another subnet",
            where=str(wanted),
            remedy=f"Give the camera a free address in {link.address.network} (its maker's IP tool, or DHCP), or this "
            "interface one in the camera's subnet.",
        )
    return Found(device, reachable[0].host)


def _verify(device: DeviceRecord, wanted: Wanted) -> None:
    if not _fits(device, wanted):
        raise InputError(
            f"is {_named(device)}, not serial {wanted.serial or '(any)'} and user id {wanted.user_id or '(any)'}",
            where=str(wanted),
            remedy="Correct aravis.address, or aravis.serial and aravis.user_id.",
        )


def _fits(device: DeviceRecord, wanted: Wanted) -> bool:
    return (not wanted.serial or device.serial == wanted.serial) and (
        not wanted.user_id or device.user_id == wanted.user_id
    )


def _named(device: DeviceRecord) -> str:
    user_id = f", user id {device.user_id}" if device.user_id else ""
    return f"{device.manufacturer} {device.model} (serial {device.serial}{user_id}) at {device.address}"


def _check_unicast(address: str) -> None:
    try:
        ip = ipaddress.IPv4Address(address)
    except ValueError:
        raise InputError(
            f"{address!r} is not an IPv4 address",
            where="aravis.address",
            remedy="Give the camera's address, such as 192.168.1.10.",
        ) from None
    if ip.is_multicast or ip.is_unspecified or str(ip).endswith(".255"):
        raise InputError(
            f"{address} is not the address of one device", where="aravis.address", remedy="Give the camera's own."
        )


def _ask(link: socket.socket) -> DeviceRecord | None:
    link.send(DISCOVERY.encode())
    try:
        return _record(link.recv(2048))
    except TimeoutError:
        return None


def _answers(sock: socket.socket, deadline_s: float) -> Iterator[DeviceRecord]:
    while (left_s := deadline_s - time.monotonic()) > 0:
        sock.settimeout(left_s)
        try:
            device = _record(sock.recv(2048))
        except TimeoutError:
            return
        if device is not None:
            yield device


def _record(packet: bytes) -> DeviceRecord | None:
    """None for what is no answer to a discovery."""
    try:
        answer = AcknowledgePacket.decode(packet)
        if answer.acknowledge != Command.DISCOVERY.acknowledge or answer.status != 0:
            return None
        return DeviceRecord.decode(answer.payload)
    except MalformedPacket:
        return None
