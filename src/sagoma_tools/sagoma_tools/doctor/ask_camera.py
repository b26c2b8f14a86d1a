"""Questions to one GigE Vision camera that need no control over it: who are you, who controls you, what can you do?"""

from __future__ import annotations

import ipaddress
import socket
import struct

from camera_client.gige.discovery import at_address
from capture_rig.errors import InputError
from gige_vision import bootstrap
from gige_vision.bootstrap import Capability
from gige_vision.gvcp import PORT, AcknowledgePacket, Command, CommandPacket, MalformedPacket

from .facts import DeviceFacts

ANSWER_TIMEOUT_S, ATTEMPTS = 0.3, 3


def ask_camera(address: str) -> DeviceFacts:
    """What the camera at ``address`` answers, by unicast only."""
    try:
        record = at_address(address).device
    except InputError as error:
        return DeviceFacts(address, error.what)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(ANSWER_TIMEOUT_S)
        link.connect((address, PORT))
        privilege = read_register(link, bootstrap.CONTROL_PRIVILEGE)
        capability = read_register(link, bootstrap.GVCP_CAPABILITY)
        controller = _controller(link, privilege, capability)
    return DeviceFacts(
        address=address,
        name=f"{record.manufacturer} {record.model}",
        serial=record.serial,
        user_id=record.user_id,
        own_address=record.address,
        subnet_mask=record.subnet_mask,
        controlled=None if privilege is None else privilege != 0,
        controller=controller,
        can_ptp=_can(capability, Capability.PTP),
        can_resend=_can(capability, Capability.PACKET_RESEND),
    )


def read_register(link: socket.socket, register: int) -> int | None:
    """One register of the connected device; None when it does not answer or has none there."""
    for request in range(1, ATTEMPTS + 1):
        link.send(CommandPacket(Command.READ_REGISTER, struct.pack(">I", register), request).encode())
        try:
            answer = AcknowledgePacket.decode(link.recv(2048))
        except (TimeoutError, MalformedPacket):
            continue
        except OSError:
            return None
        if answer.acknowledge == Command.READ_REGISTER.acknowledge and answer.request_id == request:
            whole = answer.status == 0 and len(answer.payload) == 4
            return struct.unpack(">I", answer.payload)[0] if whole else None
    return None


def _controller(link: socket.socket, privilege: int | None, capability: int | None) -> str | None:
    if privilege == 0:
        return ""
    if not _can(capability, Capability.PRIMARY_APPLICATION):
        return None
    address = read_register(link, bootstrap.PRIMARY_ADDRESS)
    return str(ipaddress.IPv4Address(address)) if address else None


def _can(capability: int | None, bit: Capability) -> bool | None:
    return None if capability is None else bool(capability & bit)
