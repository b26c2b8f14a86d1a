"""Checks of this machine: software, kernels, cores, memory, clock, ROS environment, disk, network."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil
from rclpy.utilities import get_rmw_implementation_identifier

import hull_server
from camera_client.gige import discovery
from camera_client.sources.aravis_source import import_aravis
from sagoma_ros.middleware import PROFILE_VARIABLE

from .findings import CheckResult, about, error, note, ok, result_of, warning

SUBJECT, BAGS = "this machine", Path("output")  # where commands record
PYTHONS = ((3, 11), (3, 12))
ROS, TESTED_RMW = "jazzy", "rmw_fastrtps_cpp"
FREE_CORES = 1.0  # a camera client at 100 frames a second takes a third of one
FREE_BYTES = 500 << 20
CLOCK_LIMIT_S = 1e-3  # a tenth of a frame at 100 Hz
FREE_DISK, NO_DISK = 5 << 30, 200 << 20
SHARED_MEMORY, SMALL_SHARED_MEMORY = "/dev/shm", 128 << 20  # containers start with 64 MiB


def examine_machine() -> Iterator[CheckResult]:
    """Examine this machine."""
    yield from about(SUBJECT, check_software(), check_kernels(), check_aravis(), check_resources(), check_clock())
    yield from about(SUBJECT, check_ros_environment(), check_profile(), check_disk(BAGS))
    yield from about(SUBJECT, check_interfaces(), check_buffer(BUFFER_BYTES))


def check_software() -> Iterator[CheckResult]:
    """Python and ROS against the tested versions."""
    text, usual = ".".join(map(str, sys.version_info[:2])), sys.version_info[:2] in PYTHONS
    yield result_of("python", text, (not usual, warning, "untested", "Not tested: use Python 3.11 or 3.12."))
    try:
        middleware = get_rmw_implementation_identifier()
    except Exception as problem:  # whatever the loader of the middleware's library throws
        remedy = "Source ROS 2 Jazzy before make setup, or let make setup install its wheels."
        yield error("ros.no_middleware", f"no middleware can be loaded ({problem})", remedy)
        return
    distribution = os.environ.get("ROS_DISTRO") or ROS
    other = (distribution != ROS, warning, "other_distro", "Source ROS 2 Jazzy, then make setup again.")
    untested = (middleware != TESTED_RMW, note, "untested_rmw", "All machines must use the same.")
    yield result_of("ros", f"ROS_DISTRO = {distribution}, {middleware}", other, untested)


def check_kernels() -> CheckResult:
    """numba's cache, beside the sources or in NUMBA_CACHE_DIR."""
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(hull_server.__file__).parents[2])
    compiled = list(folder.rglob("*.nbi"))
    home = compiled[0].parent if compiled else folder
    elsewhere = f"{folder} may not be written: set NUMBA_CACHE_DIR to a folder that this user may write."
    return result_of(
        "kernels",
        f"{len(compiled)} are compiled in {folder}",
        (not os.access(home, os.W_OK), warning, "read_only", elsewhere),
        (not compiled, warning, "not_compiled", "make setup; else every node's first start takes a minute"),
    )


def check_aravis() -> Iterator[CheckResult]:
    """Whether Aravis can be imported."""
    import_aravis()
    yield ok("aravis", "can be imported")


def check_resources() -> Iterator[CheckResult]:
    """Processor cores and memory that are free, also that through which nodes of one machine exchange messages."""
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    text = f"{cores} cores, {max(cores - load, 0.0):.1f} of them free (load {load:.1f})"
    remedy = "Close other programs, or run fewer camera clients on this machine."
    yield result_of("cores", text, (cores - load < FREE_CORES, warning, "busy", remedy))
    free = psutil.virtual_memory().available
    low = (free < FREE_BYTES, warning, "low", "Close what is not needed here.")
    yield result_of("memory", f"{free >> 20} MiB are free", low)
    shared = psutil.disk_usage(SHARED_MEMORY)
    text = f"{shared.free >> 20} of {shared.total >> 20} MiB of {SHARED_MEMORY} are free"
    remedy = "In a container: --shm-size=512m (or --ipc=host); else mount it larger."
    yield result_of("shm", text, (shared.free < SMALL_SHARED_MEMORY, warning, "small", remedy))


def check_clock() -> CheckResult:
    """Whether a service keeps the system's clock, and how closely, by chrony's account or systemd's."""
    remedy = "Install chrony (or linuxptp with PTP cameras): frame sets are formed by stamps of several machines."
    fields = _answer("chronyc", "-c", "tracking").split(",")  # reference, address, stratum, time, offset in s
    by, in_step = ("chrony", fields[2] not in ("0", "16")) if len(fields) > 4 else ("systemd", None)
    if in_step is None:
        answer = _answer("timedatectl", "show", "--property=NTPSynchronized", "--value")
        if answer not in ("yes", "no"):
            return note("clock.unknown", f"unknown: neither chrony nor systemd tells ({answer})", remedy)
        in_step = answer == "yes"
    if not in_step:
        return warning("clock.unsynchronised", f"the system's clock is not kept in step (by {by})", remedy)
    offset_s = abs(float(fields[4])) if by == "chrony" else 0.0
    text = f"{1e3 * offset_s:.3g} ms off (by {by})" if by == "chrony" else f"kept in step, by {by}"
    settle = "Wait until it has settled, or use a server in this network."
    return result_of("clock", text, (offset_s > CLOCK_LIMIT_S, warning, "off", settle))


def check_ros_environment() -> Iterator[CheckResult]:
    """Environment variables of discovery."""
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    valid = domain.isdigit() and int(domain) <= HIGHEST_DOMAIN
    text = f"ROS_DOMAIN_ID = {domain}; it must be the same on all machines"
    remedy = f"Give a number from 0 to {HIGHEST_DOMAIN}: above, ports collide with those of outgoing connections."
    yield result_of("ros", text, (not valid, error, "domain_invalid", remedy))
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if reach in ("LOCALHOST", "OFF") or os.environ.get("ROS_LOCALHOST_ONLY") == "1":
        what = f"ROS_AUTOMATIC_DISCOVERY_RANGE = {reach}" if reach else "ROS_LOCALHOST_ONLY = 1"
        remedy = "export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET, unless the whole graph runs here."
        yield warning("ros.discovery_local", f"{what}: other machines do not hear this one", remedy)


def check_disk(bags: Path) -> CheckResult:
    """Free space of the disk for bags, below their folder or its nearest parent that exists."""
    place = next(each for each in (bags.absolute(), *bags.absolute().parents) if each.exists())
    if not (place.is_dir() and os.access(place, os.W_OK)):
        why = "may not be written" if place.is_dir() else "is not a folder"
        return error("disk.unusable", f"{place} {why}", "Record into another folder.")
    free = psutil.disk_usage(str(place)).free
    text, remedy = f"{free / 2**30:.1f} GiB are free for bags in {bags}", "Delete old bags, or record on another disk."
    return result_of("disk", text, (free < NO_DISK, error, "full", remedy), (free < FREE_DISK, warning, "low", remedy))


def _answer(*command: str) -> str:
    """Return a program's output, or why it cannot run or hangs."""
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=3.0, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired) as problem:
        return str(problem)


# network --------------------------------------------------------------------------------------------------------------

ANY_PORT = 9  # discard; connecting a UDP socket sends nothing
DOMAIN_PORTS, FIRST_PORT, HIGHEST_DOMAIN, PARTICIPANTS = 250, 7400, 101, 100  # RTPS 2.3, 9.6.1.1: well-known ports
UDP_SOCKETS, RECEIVE_BUFFER = Path("/proc/net/udp"), Path("/proc/sys/net/core/rmem_max")
GIGABIT, BUFFER_BYTES = 1000, 4 << 20


@dataclass(frozen=True)
class Interface:
    """A network interface. ``speed_mbit`` is 0 where the driver does not report it."""

    name: str
    address: str
    mtu: int
    speed_mbit: int
    up: bool = True

    @property
    def loopback(self) -> bool:
        return self.address.startswith("127.")


def interfaces() -> list[Interface]:
    """Return those with an IPv4 address, in the order of their names."""
    states, found = psutil.net_if_stats(), sorted((each.name, each.host) for each in discovery.interfaces())
    of_each = [(name, host, states[name]) for name, host in found if name in states]
    return [Interface(name, host, its.mtu, its.speed, its.isup) for name, host, its in of_each]


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


def check_interfaces() -> Iterator[CheckResult]:
    """Interfaces and their speeds."""
    cable = "Enough for silhouettes, not for pictures or GigE cameras: a Cat 5e cable, gigabit ports at both ends and "
    cable += "the switch; ethtool shows what was agreed."
    for each in interfaces():
        if each.up and not each.loopback:
            speed = f", {each.speed_mbit} Mbit/s" if each.speed_mbit else ""
            text, slow = f"{each.name}: {each.address}, MTU {each.mtu}{speed}", 0 < each.speed_mbit < GIGABIT
            yield result_of("network", text, (slow, warning, "slow", cable))


def check_buffer(wanted: int) -> CheckResult:
    """Whether a socket's receive buffer may be ``wanted`` bytes large, for bursts of silhouettes and of packets."""
    try:
        value = int(RECEIVE_BUFFER.read_text())
    except OSError:
        text = "unknown: this container does not show net.core.rmem_max"
        return note("rmem_max.unknown", text, "Look at it on the host.")
    remedy = f"Bursts of messages and frames are lost: sudo sysctl -w net.core.rmem_max={wanted} (for good: a line in "
    remedy += "/etc/sysctl.d/60-cameras.conf)"
    text = f"net.core.rmem_max = {value} bytes, wanted {wanted}"
    return result_of("rmem_max", text, (value < wanted, warning, "small", remedy))


def check_profile() -> CheckResult | None:
    """The middleware's profile: one that is named and is not there is ignored silently."""
    profile = os.environ.get(PROFILE_VARIABLE) or os.environ.get("FASTDDS_DEFAULT_PROFILES_FILE", "")
    remedy = f"It is not there: export {PROFILE_VARIABLE}=/path/to/config/dds/fastdds.xml, or unset it."
    missing = (not Path(profile).is_file(), error, "missing", remedy)
    return result_of("dds_profile", profile, missing) if profile else None
