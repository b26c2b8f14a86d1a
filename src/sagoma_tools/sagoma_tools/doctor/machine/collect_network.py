"""Collects the facts of this machine's network: interfaces, firewalls, and the ROS domains with nodes here."""

from __future__ import annotations

import os
import socket
import subprocess
from pathlib import Path

import psutil

from ..collect import read_number
from ..facts import InterfaceFacts
from .facts import NetworkFacts

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
    """Those with an IPv4 address, without loopback."""
    states, found = psutil.net_if_stats(), []
    for name, addresses in sorted(psutil.net_if_addrs().items()):
        ours = [entry for entry in addresses if entry.family == socket.AF_INET]
        if ours and name in states and not ours[0].address.startswith("127."):
            its = states[name]
            found.append(InterfaceFacts(name, ours[0].address, ours[0].netmask or "", its.mtu, its.speed, its.isup))
    return found


def domains_of_ports(ports: set[int]) -> tuple[int, ...]:
    """The ROS domains whose well-known discovery ports are among these UDP ports."""
    found = set()
    for port in ports:
        domain, place = divmod(port - FIRST_PORT, DOMAIN_PORTS)
        # 0: multicast discovery; 10, 12, 14, ...: discovery of each process by unicast
        discovery = place == 0 or (10 <= place < 10 + 2 * PARTICIPANTS and place % 2 == 0)
        if 0 <= domain <= HIGHEST_DOMAIN and discovery:
            found.add(domain)
    return tuple(sorted(found))


def _firewalls() -> list[str]:
    """Those that can be seen: ufw by its configuration, firewalld by its process, nftables by asking (root only)."""
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
