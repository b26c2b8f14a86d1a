"""This machine's network: interfaces, firewalls, ROS domains with nodes here, and whether other machines answer.

A UDP packet to a closed port is answered by the receiver's kernel (ICMP port unreachable), which a connected socket
reports as "connection refused": proof, without privileges or a program at the other end, that the packet arrived. With
the don't-fragment bit it proves that the whole path carries packets of that size. Where `sagoma doctor --answer` runs,
that answers instead.
"""

from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from ..collect import collect_interface, read_number
from ..facts import InterfaceFacts, NetworkFacts
from ..findings import Finding, error, graded, note, ok, on, warning
from .link_probe import PINGS, LinkFacts, measure_link, reaches

WMEM_MAX = Path("/proc/sys/net/core/wmem_max")
UDP_SOCKETS = Path("/proc/net/udp")
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
DOMAIN_PORTS, FIRST_PORT, HIGHEST_DOMAIN, PARTICIPANTS = 250, 7400, 101, 100  # RTPS 2.3, 9.6.1.1: well-known ports
ANSWER_S = 3.0


def collect_network() -> NetworkFacts:
    """Interfaces that are up, firewalls, the middleware's profile, and the ROS domains with nodes on this machine."""
    profile = next((os.environ[name] for name in PROFILE_VARIABLES if os.environ.get(name)), "")
    return NetworkFacts(
        interfaces=tuple(collect_interfaces()),
        wmem_max=read_number(WMEM_MAX),
        firewalls=tuple(_firewalls()),
        profile=profile,
        profile_exists=not profile or Path(profile).is_file(),
        domains_here=domains_of_ports(_bound_ports()),
    )


def collect_interfaces() -> list[InterfaceFacts]:
    """Return those with an IPv4 address, without loopback."""
    states, found = psutil.net_if_stats(), []
    for name, addresses in sorted(psutil.net_if_addrs().items()):
        ours = [entry for entry in addresses if entry.family == socket.AF_INET]
        if ours and name in states and not ours[0].address.startswith("127."):
            its = states[name]
            found.append(InterfaceFacts(name, ours[0].address, ours[0].netmask or "", its.mtu, its.speed, its.isup))
    return found


def domains_of_ports(ports: set[int]) -> tuple[int, ...]:
    """Return the ROS domains whose well-known discovery ports are among these UDP ports."""
    found = set()
    for port in ports:
        domain, place = divmod(port - FIRST_PORT, DOMAIN_PORTS)
        # 0: multicast discovery; 10, 12, 14, ...: discovery of each process by unicast
        discovery = place == 0 or (10 <= place < 10 + 2 * PARTICIPANTS and place % 2 == 0)
        if 0 <= domain <= HIGHEST_DOMAIN and discovery:
            found.add(domain)
    return tuple(sorted(found))


def _firewalls() -> list[str]:
    """Return the active firewalls: ufw by its configuration, firewalld by its process, nftables by its rules (root)."""
    found = []
    ufw = Path("/etc/ufw/ufw.conf")
    if ufw.is_file() and "ENABLED=yes" in ufw.read_text(errors="replace"):
        found.append("ufw")
    names = {process.info["name"] for process in psutil.process_iter(["name"])}
    if "firewalld" in names:
        found.append("firewalld")
    if not found and "policy drop" in _output(["nft", "list", "chains"]):
        found.append("nftables (a chain that drops)")
    return found


def _bound_ports() -> set[int]:
    lines = UDP_SOCKETS.read_text().splitlines()[1:] if UDP_SOCKETS.exists() else []
    return {int(line.split()[1].rpartition(":")[2], 16) for line in lines}


def _output(command: list[str]) -> str:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=ANSWER_S, check=False).stdout
    except (OSError, subprocess.TimeoutExpired):
        return ""


SMALL_BYTES = 64
CLOCK_ERROR_S, CLOCK_WARNING_S = 1 / 60, 2e-3  # a frame period at 60 Hz is a wrong set; a tenth of it shows in motion
LOSS_LIMIT = 0.002  # one of 500 may be chance: a cable loses none
SLOW_MBIT, FAST_MBIT = 500.0, 2000.0  # between 100 and 1000 Mbit/s; beyond what the probe's bursts can tell
CLOCKS = "chrony or PTP on all machines, with one source: frame sets are formed by stamps. docs/hosts.md"
LOSSES = (
    "A cable or port that is damaged (ip -s link), Wi-Fi, a switch that is overloaded; until it is mended: "
    "--set hull_server.resend=true with our DDS profile. docs/hosts.md"
)
SLOW = (
    "Enough for silhouettes, not for pictures (calibration, previews) or GigE cameras: a cable with all eight wires "
    "(Cat 5e), gigabit ports on both machines and the switch; ethtool shows what was agreed."
)
SIZES = (9000, 1500, 1400, 1280)


@dataclass(frozen=True)
class ReachFacts:
    """The path to another machine: its interface here (None: none), whether a small packet is answered, and the
    largest packet of :data:`SIZES` (at most the interface's MTU) that gets there."""

    address: str
    interface: InterfaceFacts | None
    answers: bool = False
    largest: int = 0


def examine_hosts(addresses: Sequence[str]) -> Iterator[Finding]:
    """Examine the network paths to these machines; where `sagoma doctor --answer` runs there, also clock and losses."""
    for address in addresses:
        reach = collect_reach(address)
        yield from on(f"machine {address}", check_reach(reach))
        if reach.answers:
            yield from on(f"machine {address}", check_link(measure_link(address)))


def collect_reach(address: str) -> ReachFacts:
    """Send a few packets to ``address``, and only there."""
    interface = collect_interface(address)
    if interface is None or not reaches(address, SMALL_BYTES):
        return ReachFacts(address, interface)
    largest_tried = min(interface.mtu, max(SIZES))
    sizes = [largest_tried, *(size for size in SIZES if size < largest_tried)]
    return ReachFacts(address, interface, True, next((size for size in sizes if reaches(address, size)), 0))


def check_reach(facts: ReachFacts) -> Iterator[Finding]:
    """Check that the machine can be reached, answers, and gets packets of the interface's MTU whole."""
    if facts.interface is None:
        remedy = f"Check the address; see: ip route get {facts.address}"
        yield error("way.none", f"there is no way to {facts.address} from this machine", remedy)
    elif not facts.answers:
        text = f"{facts.address} does not answer through {facts.interface.name}: it is off, or a firewall is silent"
        yield warning("answer.none", text, f"ping {facts.address}; open UDP between the machines.")
    elif facts.largest >= min(facts.interface.mtu, max(SIZES)):
        yield ok("mtu", f"packets of {facts.largest} bytes reach {facts.address} through {facts.interface.name}")
    else:
        name, reach = facts.interface.name, f"{facts.largest or f'less than {SIZES[-1]}'} bytes at most"
        yield error(
            "mtu.too_large",
            f"{name} sends packets of {facts.interface.mtu} bytes, but {reach} reach {facts.address}: "
            "larger messages vanish",
            "Give both machines and the switch between them one MTU: "
            f"sudo ip link set {name} mtu {facts.largest or SIZES[-1]}, or raise the others'.",
        )
    if facts.interface is not None and facts.interface.loopback:
        yield note("way.local", f"{facts.address} is this machine")


def check_link(link: LinkFacts | None) -> Iterator[Finding]:
    """Check the other machine's clock, the packets lost there and back, and the bandwidth."""
    if link is None:
        text = "its clock, losses and bandwidth were not measured: nothing answers there"
        yield note("way.unmeasured", text, "Run there, meanwhile: sagoma doctor --answer")
        return
    off, known = abs(link.offset_s), f"+- {1e3 * link.error_s:.1f} ms"
    size = f"{off:.2f} s" if off >= 1 else f"{1e3 * off:.1f} ms"
    text = f"its clock is {size} {'ahead of' if link.offset_s > 0 else 'behind'} this machine's ({known})"
    certain_s = off - link.error_s
    yield graded(
        "clock",
        text,
        (certain_s > CLOCK_ERROR_S, error, "off", CLOCKS),
        (certain_s > CLOCK_WARNING_S, warning, "imprecise", CLOCKS),
    )
    text = f"{100 * link.loss:.1f} % of {PINGS} small packets did not come back"
    yield graded("packets", text, (link.loss > LOSS_LIMIT, warning, "lost", LOSSES))
    if link.rate_mbit is None:
        yield warning("bandwidth.unknown", "too few packets of a burst arrive to measure the bandwidth", LOSSES)
    else:
        text = f"{_rate(link.rate_mbit)} get there"
        yield graded("bandwidth", text, (link.rate_mbit < SLOW_MBIT, warning, "slow", SLOW))


def _rate(mbit: float) -> str:
    return f"{mbit:.0f} Mbit/s" if mbit < FAST_MBIT else f"more than {FAST_MBIT:.0f} Mbit/s"
