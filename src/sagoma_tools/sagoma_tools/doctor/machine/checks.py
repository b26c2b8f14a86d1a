"""Checks this machine: software, graphics, kernels, cores, memory, clock, ROS environment, disk, limits, network."""

from __future__ import annotations

from collections.abc import Iterator

from ..facts import (
    ClockFacts,
    DiskFacts,
    GraphicsFacts,
    HostFacts,
    InterfaceFacts,
    KernelFacts,
    LimitFacts,
    MachineFacts,
    NetworkFacts,
    SharedMemoryFacts,
    SoftwareFacts,
)
from ..findings import Finding, error, graded, note, ok, warning

FREE_CORES = 1.0  # a camera client at 100 frames a second takes a third of one
FREE_BYTES = 500 << 20
CLOCK_LIMIT_S = 1e-3  # a tenth of a frame at 100 Hz
RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
TESTED_RMW = "rmw_fastrtps_cpp"
HIGHEST_DOMAIN = 101  # above, the ports collide with those of outgoing connections


def check_host(host: HostFacts) -> Iterator[Finding]:
    """Check what every node needs: Aravis, cores, memory, clock, ROS environment."""
    yield from _check_aravis(host)
    yield from _check_cores(host)
    if host.available_bytes < FREE_BYTES:
        yield warning("memory.low", f"{host.available_bytes >> 20} MiB are free", "Close what is not needed here.")
    else:
        yield ok("memory", f"{host.available_bytes / 2**30:.1f} GiB are free")
    yield from _check_clock(host.clock)
    yield from _check_environment(host)


def _check_aravis(host: HostFacts) -> Iterator[Finding]:
    if host.aravis_error:
        yield error(
            "aravis.missing", host.aravis_error, "sudo apt install python3-gi gir1.2-aravis-0.8, then make setup"
        )
    else:
        yield ok("aravis", "can be imported")


def _check_cores(host: HostFacts) -> Iterator[Finding]:
    free = host.cores - host.load
    text = f"{host.cores} cores, {max(free, 0.0):.1f} of them free (load {host.load:.1f})"
    remedy = "Close other programs, or run fewer camera clients on this machine."
    yield graded("cores", text, (free < FREE_CORES, warning, "busy", remedy))
    if not host.governors:
        yield note("governor.unknown", "unknown: this system shows no CPU frequency governor (a virtual machine?)")
    elif set(host.governors) == {"performance"}:
        yield ok("governor", "performance on all cores")
    else:
        names = ", ".join(sorted(set(host.governors)))
        remedy = "sudo cpupower frequency-set -g performance"
        yield note("governor.powersave", f"{names}: cores that sleep wake up late, which adds latency", remedy)


def _check_clock(clock: ClockFacts) -> Iterator[Finding]:
    remedy = "Install chrony (or linuxptp with PTP cameras): frame sets are formed by stamps of several machines."
    if clock.unknown_because:
        yield note("clock.unknown", f"unknown: {clock.unknown_because}", remedy)
    elif not clock.in_step:
        yield warning("clock.unsynchronised", f"the system's clock is not kept in step ({clock.keeper})", remedy)
    elif clock.offset_s is None:
        yield ok("clock", f"kept in step by {clock.keeper}; how closely is unknown")
    elif abs(clock.offset_s) > CLOCK_LIMIT_S:
        text = f"{1e3 * abs(clock.offset_s):.1f} ms off ({clock.keeper})"
        yield warning("clock.off", text, "Wait until it has settled, or use a server in this network.")
    else:
        yield ok("clock", f"{1e6 * abs(clock.offset_s):.0f} us off ({clock.keeper})")


def _check_environment(host: HostFacts) -> Iterator[Finding]:
    given = host.environment
    domain = given.get("ROS_DOMAIN_ID", "")
    if domain and not (domain.isdigit() and int(domain) <= HIGHEST_DOMAIN):
        yield error("ros.domain_invalid", f"ROS_DOMAIN_ID = '{domain}'", f"Give a number from 0 to {HIGHEST_DOMAIN}.")
    else:
        yield ok("ros", f"ROS_DOMAIN_ID = {domain or '0 (not set)'}; it must be the same on all machines")
    reach = given.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if reach and reach not in RANGES:
        remedy = f"Give one of {', '.join(RANGES)}."
        yield error("ros.discovery_invalid", f"ROS_AUTOMATIC_DISCOVERY_RANGE = '{reach}'", remedy)
    elif reach in ("LOCALHOST", "OFF") or given.get("ROS_LOCALHOST_ONLY") == "1":
        what = "ROS_LOCALHOST_ONLY = 1" if not reach else f"ROS_AUTOMATIC_DISCOVERY_RANGE = {reach}"
        remedy = "export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET, unless the whole graph runs here."
        yield warning("ros.discovery_local", f"{what}: other machines do not hear this one", remedy)
    rmw = given.get("RMW_IMPLEMENTATION", "")
    if rmw and rmw != TESTED_RMW:
        text = f"RMW_IMPLEMENTATION = {rmw}; tested with {TESTED_RMW}"
        yield note("ros.untested_rmw", text, "All machines must use the same.")


SYSTEMS = {("debian", "12"), ("ubuntu", "24.04")}
PYTHONS = ((3, 11), (3, 12))
ROS = "jazzy"
BUFFER_BYTES = 4 << 20
FREE_DISK, NO_DISK = 5 << 30, 200 << 20
SLOW_DISK = 20e6  # five cameras with everything recorded take 4 MB/s; a disk has other work as well
SMALL_SHARED_MEMORY = 128 << 20  # containers start with 64 MiB
ABANDONED = 20
OPEN_FILES = 1024
ETHERNET_MTU, GIGABIT = 1500, 1000


def check_machine(machine: MachineFacts) -> Iterator[Finding]:
    """Run every check of this machine."""
    yield from check_software(machine.software)
    yield from check_kernels(machine.kernels)
    yield from check_graphics(machine.graphics)
    yield from check_host(machine.host)
    yield from check_disk(machine.disk)
    yield from check_shared_memory(machine.shared_memory)
    yield from check_limits(machine.limits)
    yield from check_buffers(machine.host.rmem_max, machine.network.wmem_max)
    yield from check_network(machine.network)


def check_software(software: SoftwareFacts) -> Iterator[Finding]:
    """Check distribution, Python and ROS against the tested versions."""
    system = f"{software.system} {software.system_version}"
    if (software.system, software.system_version) in SYSTEMS:
        yield ok("system", system)
    else:
        yield note("system.untested", f"{system}: not tested (Debian 12 and Ubuntu 24.04 are)")
    python = ".".join(map(str, software.python))
    if software.python in PYTHONS:
        yield ok("python", python)
    else:
        yield warning("python.untested", f"{python}: not tested", "Use Python 3.11 or 3.12.")
    if software.rmw_error:
        remedy = "Source ROS 2 Jazzy before make setup, or let make setup install its wheels."
        yield error("ros.no_middleware", f"no middleware can be loaded ({software.rmw_error})", remedy)
        return
    if software.ros_distro not in ("", ROS):
        yield warning(
            "ros.other_distro", f"ROS_DISTRO = {software.ros_distro}", "Source ROS 2 Jazzy, then make setup again."
        )
    if software.rmw == TESTED_RMW:
        yield ok("ros", f"{software.ros_distro or 'wheels'}, {software.rmw}")


def check_kernels(kernels: KernelFacts) -> Iterator[Finding]:
    """Check that the numerical kernels are compiled, and that the cache may be written."""
    if not kernels.compiled:
        yield warning(
            "kernels.not_compiled", "none is compiled yet: every node's first start takes a minute", "make setup"
        )
    elif kernels.fresh is False:
        text = f"{kernels.compiled} compiled; sources changed since: what depends on them compiles at the next start"
        yield note("kernels.stale", text, "make setup")
    else:
        yield ok("kernels", f"{kernels.compiled} compiled")
    if not kernels.writable:
        text = f"{kernels.folder} may not be written: kernels compile anew at every start"
        yield warning("kernels.read_only", text, "Set NUMBA_CACHE_DIR to a folder that this user may write.")


def check_graphics(graphics: GraphicsFacts) -> Iterator[Finding]:
    """Report what the hull server's backend "auto" takes."""
    if graphics.error:
        remedy = "Nothing, on a machine without a GPU; else see docs/hull.md."
        yield note("opengl.none", f"none, the hull server carves on the CPU ({graphics.error})", remedy)
    elif graphics.hardware:
        yield ok("opengl", f"{graphics.renderer}, OpenGL {graphics.version}: the hull server carves on it")
    else:
        yield note(
            "opengl.software",
            f"{graphics.renderer}, OpenGL {graphics.version}: in software, so the hull server carves "
            "on the CPU, which is faster",
            "Nothing, on a machine without a GPU; else see docs/hull.md.",
        )


def check_disk(disk: DiskFacts) -> Iterator[Finding]:
    """Check free space and speed of the disk for bags."""
    if disk.error:
        yield error("disk.unusable", disk.error, "Name another folder with --bags, and record there.")
        return
    free = f"{disk.free_bytes / 2**30:.1f} GiB are free for bags in {disk.folder}"
    remedy, space, speed = "Delete old bags, or record on another disk.", disk.free_bytes, disk.write_bytes_per_s
    yield graded("disk", free, (space < NO_DISK, error, "full", remedy), (space < FREE_DISK, warning, "low", remedy))
    if speed is not None:
        slow = (speed < SLOW_DISK, warning, "slow", "Record on a faster disk, not over the network.")
        yield graded("disk", f"it takes {speed / 1e6:.0f} MB/s", slow)


def check_shared_memory(memory: SharedMemoryFacts) -> Iterator[Finding]:
    """Check the shared memory through which nodes of one machine exchange messages."""
    if memory.free_bytes < SMALL_SHARED_MEMORY:
        text = f"{memory.free_bytes >> 20} of {memory.size_bytes >> 20} MiB of /dev/shm are free"
        yield warning("shm.small", text, "In a container: --shm-size=512m (or --ipc=host); else mount it larger.")
    else:
        yield ok("shm", f"{memory.free_bytes >> 20} MiB of /dev/shm are free")
    if memory.abandoned > ABANDONED:
        remedy = "While no node runs: rm /dev/shm/fastrtps_* /dev/shm/sem.fastrtps_*"
        yield note("shm.abandoned", f"{memory.abandoned} segments there belong to nodes that were killed", remedy)


def check_limits(limits: LimitFacts) -> Iterator[Finding]:
    """Check this user's limits."""
    if 0 <= limits.open_files < OPEN_FILES:
        yield warning("limits.open_files", f"{limits.open_files} open files at most", f"ulimit -n {OPEN_FILES}")
    priority = f"real-time priority up to {limits.rtprio}" if limits.rtprio else "no real-time priority"
    locked = "any amount" if limits.memlock_bytes < 0 else f"{limits.memlock_bytes >> 10} KiB"
    yield ok("limits", f"{limits.open_files} open files, {priority}, {locked} of locked memory (neither is needed)")


def check_buffers(rmem_max: int | None, wmem_max: int | None) -> Iterator[Finding]:
    """Check that sockets may be large enough for bursts of silhouettes and of a camera's packets."""
    for name, value, severity in (("rmem_max", rmem_max, warning), ("wmem_max", wmem_max, note)):
        if value is None:
            text = f"unknown: this container does not show net.core.{name}"
            yield note(f"{name}.unknown", text, "Look at it on the host.")
        elif value < BUFFER_BYTES:
            yield severity(
                f"{name}.small",
                f"net.core.{name} = {value} bytes: bursts of messages are lost",
                f"sudo sysctl -w net.core.{name}={BUFFER_BYTES} (for good: a line in /etc/sysctl.d/60-cameras.conf)",
            )
        else:
            yield ok(name, f"net.core.{name} = {value} bytes")


def check_network(network: NetworkFacts) -> Iterator[Finding]:
    """Check interfaces, firewalls, the middleware's profile."""
    for interface in network.interfaces:
        yield from _check_interface(interface)
    if not any(interface.up for interface in network.interfaces):
        yield note("network.loopback_only", "there is no network but loopback: the whole graph must run here")
    if network.firewalls:
        yield note(
            "firewall.active",
            f"active: {', '.join(network.firewalls)}",
            "Let UDP ports 7400 to 7650 + 250 x ROS_DOMAIN_ID in from the other machines, and multicast "
            "(239.255.0.1); ports 3956 and above 1024 from the cameras.",
        )
    if not network.profile_exists:
        text = f"{network.profile} does not exist, and the middleware ignores that silently"
        remedy = "export FASTRTPS_DEFAULT_PROFILES_FILE=/path/to/config/dds/fastdds.xml, or unset it."
        yield error("dds_profile.missing", text, remedy)
    elif network.profile:
        yield ok("dds_profile", network.profile)
    if network.domains_here:
        yield ok("domains", f"nodes run here in ROS_DOMAIN_ID {', '.join(map(str, network.domains_here))}")


def _check_interface(interface: InterfaceFacts) -> Iterator[Finding]:
    speed = f", {interface.speed_mbit} Mbit/s" if interface.speed_mbit else ""
    text = f"{interface.name}: {interface.address}, MTU {interface.mtu}{speed}"
    if not interface.up:
        yield note(
            "network.down", f"{interface.name} is down", f"sudo ip link set {interface.name} up, if it is in use."
        )
    elif 0 < interface.speed_mbit < GIGABIT:
        remedy = "Enough for silhouettes, not for pictures or GigE cameras: a Cat 5e cable, gigabit ports."
        yield warning("network.slow", text, remedy)
    elif interface.mtu < ETHERNET_MTU:
        remedy = f"sudo ip link set {interface.name} mtu {ETHERNET_MTU}, unless a tunnel wants it so."
        yield note("network.small_mtu", f"{text}: silhouettes are cut into more packets than needed", remedy)
    else:
        yield ok("network", text)
