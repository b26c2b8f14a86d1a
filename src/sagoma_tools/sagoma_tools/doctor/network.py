"""This machine's network: interfaces, ROS domains in use; and the checks of its settings."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil

from ..graph.network_settings import PROFILE_VARIABLE
from .findings import Finding, check, error, graded, note, ok, warning

ANY_PORT = 9  # discard; connecting a UDP socket sends nothing
DOMAIN_PORTS, FIRST_PORT, HIGHEST_DOMAIN, PARTICIPANTS = 250, 7400, 101, 100  # RTPS 2.3, 9.6.1.1: well-known ports
UDP_SOCKETS = Path("/proc/net/udp")


@dataclass(frozen=True)
class Interface:
    """A network interface. ``speed_mbit`` is 0 where the driver does not tell."""

    name: str
    address: str
    netmask: str
    mtu: int
    speed_mbit: int
    up: bool = True

    @property
    def loopback(self) -> bool:
        return self.address.startswith("127.")


def interfaces() -> list[Interface]:
    """Return those with an IPv4 address, in the order of their names."""
    states, found = psutil.net_if_stats(), []
    for name, addresses in sorted(psutil.net_if_addrs().items()):
        for ours in [entry for entry in addresses if entry.family == socket.AF_INET and name in states][:1]:
            its = states[name]
            mask = ours.netmask or "255.255.255.255"
            found.append(Interface(name, ours.address, mask, its.mtu, its.speed, its.isup))
    return found


def interface_to(address: str) -> Interface | None:
    """Return the interface that packets to ``address`` leave through; None when there is no path."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        try:
            link.connect((address, ANY_PORT))
        except OSError:
            return None
        ours = link.getsockname()[0]
    same = [each for each in interfaces() if each.address == ours or (each.loopback and ours.startswith("127."))]
    return same[0] if same else None


def domains_here() -> tuple[int, ...]:
    """Return the ROS domains with nodes on this machine, by the well-known discovery ports that are bound."""
    lines = UDP_SOCKETS.read_text().splitlines()[1:] if UDP_SOCKETS.exists() else []
    return domains_of_ports(int(line.split()[1].rpartition(":")[2], 16) for line in lines)


def domains_of_ports(ports: Iterable[int]) -> tuple[int, ...]:
    """Return the ROS domains whose discovery ports, of multicast or of a process, are among these UDP ports."""
    places = [divmod(port - FIRST_PORT, DOMAIN_PORTS) for port in ports]
    discovery = {0, *range(10, 10 + 2 * PARTICIPANTS, 2)}
    return tuple(sorted({domain for domain, place in places if 0 <= domain <= HIGHEST_DOMAIN and place in discovery}))


GIGABIT = 1000
BUFFER_BYTES = 4 << 20
UFW = Path("/etc/ufw/ufw.conf")


@check("machine")
def check_interfaces() -> Iterator[Finding]:
    """Interfaces that are down or slow."""
    found = [each for each in interfaces() if not each.loopback]
    cable = (
        "Enough for silhouettes, not for pictures or GigE cameras: a Cat 5e cable, gigabit ports at both ends and the "
    )
    cable += "switch; ethtool shows what was agreed."
    for each in found:
        speed = f", {each.speed_mbit} Mbit/s" if each.speed_mbit else ""
        yield graded(
            "network",
            f"{each.name}: {each.address}, MTU {each.mtu}{speed}" if each.up else f"{each.name} is down",
            (not each.up, note, "down", f"sudo ip link set {each.name} up, if it is in use."),
            (0 < each.speed_mbit < GIGABIT, warning, "slow", cable),
        )
    if not any(each.up for each in found):
        yield note("network.loopback_only", "there is no network but loopback: the whole graph must run here")


@check("machine")
def check_buffers() -> Iterator[Finding]:
    """Socket buffers for bursts of silhouettes and of a camera's packets."""
    yield check_buffer("rmem_max", BUFFER_BYTES, warning)
    yield check_buffer("wmem_max", BUFFER_BYTES, note)


def check_buffer(name: str, wanted: int, severity: Callable[[str, str, str], Finding]) -> Finding:
    """Whether a socket's buffer may be ``wanted`` bytes large."""
    try:
        value = int(Path(f"/proc/sys/net/core/{name}").read_text())
    except OSError:
        text = f"unknown: this container does not show net.core.{name}"
        return note(f"{name}.unknown", text, "Look at it on the host.")
    remedy = f"sudo sysctl -w net.core.{name}={wanted} (for good: a line in /etc/sysctl.d/60-cameras.conf)"
    text = f"net.core.{name} = {value} bytes, wanted {wanted}: bursts of messages and frames are lost"
    return severity(f"{name}.small", text, remedy) if value < wanted else ok(name, f"net.core.{name} = {value} bytes")


@check("machine")
def check_firewall() -> Finding | None:
    """An active firewall: ufw by its configuration, firewalld by its process."""
    found = ["ufw"] if UFW.is_file() and "ENABLED=yes" in UFW.read_text(errors="replace") else []
    found += ["firewalld"] if "firewalld" in {each.info["name"] for each in psutil.process_iter(["name"])} else []
    remedy = (
        "Let UDP ports 7400 to 7650 + 250 x ROS_DOMAIN_ID in from the other machines, and multicast (239.255.0.1); "
    )
    remedy += "ports 3956 and above 1024 from the cameras."
    return note("firewall.active", f"active: {', '.join(found)}", remedy) if found else None


@check("machine")
def check_profile() -> Finding | None:
    """The middleware's profile: one that is named and is not there is ignored silently."""
    profile = os.environ.get(PROFILE_VARIABLE) or os.environ.get("FASTDDS_DEFAULT_PROFILES_FILE", "")
    text = f"{profile} does not exist, and the middleware ignores that silently"
    remedy = f"export {PROFILE_VARIABLE}=/path/to/config/dds/fastdds.xml, or unset it."
    if profile and not Path(profile).is_file():
        return error("dds_profile.missing", text, remedy)
    return ok("dds_profile", profile) if profile else None
