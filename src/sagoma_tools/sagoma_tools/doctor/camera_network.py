"""Checks the network between this machine and a camera: interface, subnet, packets, bandwidth, buffers, control.

The camera is asked over GVCP by unicast; nothing is asked that would need control of it.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
from collections.abc import Iterator, Sequence

from camera_client.gige.discovery import discover_at
from camera_client.settings import AravisSettings
from capture_rig.errors import InputError
from gige_vision import bootstrap
from gige_vision.bootstrap import Capability
from gige_vision.gvcp import PORT, AcknowledgePacket, Command, CommandPacket, MalformedPacket

from .facts import DeviceFacts, HostFacts, InterfaceFacts, Stream
from .findings import Finding, error, graded, note, ok, warning

JUMBO_MTU = 9000
GIGABIT = 1000
PACKET_HEADERS = 36  # IP, UDP and GVSP, of every stream packet
ETHERNET_FRAME = 38  # preamble, header, checksum and gap around every packet
BUSY, FULL = 0.7, 0.95  # shares of the link
ANSWER_TIMEOUT_S, ATTEMPTS = 0.3, 3


def check_interface(facts: InterfaceFacts | None, address: str, settings: AravisSettings) -> Iterator[Finding]:
    """Check that an interface leads to the camera and carries large packets."""
    if facts is None:
        remedy = f"Give an interface an address in the camera's subnet; see: ip route get {address}"
        yield error("interface.none", f"there is no way to {address} from this machine", remedy)
        return
    if not facts.up:
        yield error(
            "interface.down", f"{facts.name} is down", f"Plug the cable in, or: sudo ip link set {facts.name} up"
        )
        return
    yield ok("interface", f"{facts.name}, {facts.address}/{facts.netmask}, MTU {facts.mtu}")
    jumbo = f"sudo ip link set {facts.name} mtu {JUMBO_MTU} (and the same on the switch)"
    if settings.packet_size > facts.mtu:
        text = f"aravis.packet_size = {settings.packet_size}, but the MTU of {facts.name} is {facts.mtu}"
        yield error("mtu.packet_too_large", text, f"{jumbo}, or a smaller packet_size, or 0: the largest that passes")
    elif facts.mtu < JUMBO_MTU and not facts.loopback:
        yield warning(
            "mtu.no_jumbo_frames", f"{facts.name} carries packets of {facts.mtu} bytes: six times the interrupts", jumbo
        )
    if 0 < facts.speed_mbit < GIGABIT and not facts.loopback:
        remedy = "Check cable and switch: GigE Vision needs 1000 Mbit/s or more."
        yield warning("speed.slow", f"{facts.name} runs at {facts.speed_mbit} Mbit/s", remedy)


def check_device(facts: DeviceFacts, settings: AravisSettings, interface: InterfaceFacts | None) -> Iterator[Finding]:
    """Check that the camera answers, is the configured one, and is free."""
    if facts.error:
        yield error("camera.silent", facts.error, "Check power, cable, address and subnet (ping it).")
        return
    yield ok("camera", f"{facts.name}, serial {facts.serial}, answers at {facts.address}")
    for key, wanted, got in (("serial", settings.serial, facts.serial), ("user_id", settings.user_id, facts.user_id)):
        if wanted and wanted != got:
            text = f"the camera at {facts.address} has {key} '{got}', aravis.{key} asks for '{wanted}'"
            yield error(f"{key}.differs", text, f"Correct aravis.address or aravis.{key}.")
    yield from _check_subnet(facts, interface)
    yield from _check_control(facts, interface)
    yield from _check_ptp(facts, settings)
    if facts.can_resend is False:
        text = "the camera cannot send a packet again: each one lost costs a frame"
        yield warning("resend.unsupported", text, "Use its own cable to this machine, and jumbo frames.")


def check_bandwidth(streams: Sequence[Stream], interface: InterfaceFacts | None, packet_size: int) -> Iterator[Finding]:
    """Check that all cameras on this interface fit its link; ``streams`` holds this camera first."""
    unknown = [stream.camera for stream in streams if not stream.frame_rate]
    if unknown:
        text = f"unknown: aravis.frame_rate of {', '.join(unknown)} is left to the camera"
        yield note("bandwidth.rate_unknown", text, "Set it, so that all cameras run at one rate.")
        return
    if interface is None:
        return
    packet = packet_size or min(interface.mtu, JUMBO_MTU)
    needed = sum(stream_bytes_per_s(stream, packet) for stream in streams)
    who = f"{len(streams)} cameras" if len(streams) > 1 else streams[0].camera
    what = f"{needed / 1e6:.0f} MB/s of {who}"
    if interface.loopback or not interface.speed_mbit:
        why = "loopback has no speed" if interface.loopback else f"the speed of {interface.name} is unknown"
        yield note("bandwidth.link_unknown", f"{what}; {why}")
        return
    share = needed / (interface.speed_mbit * 1e6 / 8)
    text = f"{what} take {100 * share:.0f} % of the {interface.speed_mbit} Mbit/s of {interface.name}"
    remedy = "Lower frame rate, region or bit depth, or give some cameras another interface."
    space = f"{remedy} Space packets out with aravis.packet_delay_ns."
    yield graded("bandwidth", text, (share > FULL, error, "exceeded", remedy), (share > BUSY, warning, "tight", space))


def stream_bytes_per_s(stream: Stream, packet_size: int) -> float:
    """Bytes a second on the wire, with the headers of every packet, leader and trailer included (GVSP 2.0)."""
    packets = -(-stream.payload_bytes // max(packet_size - PACKET_HEADERS, 1)) + 2
    return stream.frame_rate * (stream.payload_bytes + packets * (PACKET_HEADERS + ETHERNET_FRAME))


def check_receive_buffer(host: HostFacts, settings: AravisSettings) -> Iterator[Finding]:
    """Check that the stream's socket may be as large as the settings ask."""
    wanted = settings.socket_buffer_bytes
    if host.rmem_max is None:
        yield note(
            "rmem_max.unknown", "unknown: this container does not show net.core.rmem_max", "Look at it on the host."
        )
        return
    if host.rmem_max >= wanted:
        yield ok("rmem_max", f"net.core.rmem_max = {host.rmem_max} bytes, wanted {wanted}")
        return
    yield warning(
        "rmem_max.small",
        f"net.core.rmem_max = {host.rmem_max} bytes, aravis.socket_buffer_bytes asks for {wanted}: frames will be lost",
        f"sudo sysctl -w net.core.rmem_max={wanted} (for good: a line in /etc/sysctl.d/60-cameras.conf)",
    )


def _check_subnet(facts: DeviceFacts, interface: InterfaceFacts | None) -> Iterator[Finding]:
    if interface is None or not facts.own_address:
        return
    ours = ipaddress.IPv4Interface(f"{interface.address}/{interface.netmask}").network
    theirs = ipaddress.IPv4Interface(f"{facts.own_address}/{facts.subnet_mask}").network
    if ipaddress.IPv4Address(facts.own_address) in ours and ipaddress.IPv4Address(interface.address) in theirs:
        return
    text = f"the camera is in {theirs}, {interface.name} in {ours}: images come through a router"
    yield warning("subnet.differs", text, "Put both into one subnet (the maker's IP tool, or DHCP).")


def _check_ptp(facts: DeviceFacts, settings: AravisSettings) -> Iterator[Finding]:
    needed_by = (
        "sync" if settings.sync in ("ptp", "action") else "stamp_source" if settings.stamp_source == "ptp" else ""
    )
    if not needed_by:
        return
    what = f"aravis.{needed_by} = {getattr(settings, needed_by)} needs PTP"
    if facts.can_ptp:
        yield ok("ptp", f"the camera has PTP, which aravis.{needed_by} needs; --open shows whether it is in step")
    elif facts.can_ptp is None:
        yield note(
            "ptp.unknown", f"{what}; whether the camera has it is unknown", "See with --open, while no client runs."
        )
    else:
        # the capability bit is of GigE Vision 2.0; older cameras may have PTP all the same
        remedy = "See with --open; else set aravis.sync to line or software, stamp_source to camera."
        yield warning("ptp.unsupported", f"{what}, and the camera does not announce it", remedy)


def _check_control(facts: DeviceFacts, interface: InterfaceFacts | None) -> Iterator[Finding]:
    if facts.controlled is None:
        yield note("control.unknown", "unknown: the camera does not report its controller")
    elif not facts.controlled:
        yield ok("control", "no program controls the camera: it can be opened")
    elif interface is not None and facts.controller == interface.address:
        remedy = "Nothing, if that is the camera client; else stop it."
        yield note("control.local", f"a program on this machine ({facts.controller}) controls the camera", remedy)
    else:
        remedy = "Stop the program there; a camera has one controller."
        yield warning("control.taken", f"{facts.controller or 'another program'} controls the camera", remedy)


def ask_camera(address: str) -> DeviceFacts:
    """Ask the camera at ``address`` for its identity, capabilities and controller, by unicast only."""
    try:
        record = discover_at(address).device
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
    """Return one register of the connected device; None when it does not answer or has none there."""
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
