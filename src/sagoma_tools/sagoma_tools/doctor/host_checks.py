"""This machine: cores, memory, clock, the ROS environment."""

from __future__ import annotations

from collections.abc import Iterator

from .facts import ClockFacts, HostFacts
from .findings import Finding, error, note, ok, warning

FREE_CORES = 1.0  # a camera client at 100 frames a second takes a third of one
FREE_BYTES = 500 << 20
CLOCK_LIMIT_S = 1e-3  # a tenth of a frame at 100 Hz
RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
TESTED_RMW = "rmw_fastrtps_cpp"
HIGHEST_DOMAIN = 101  # above, the ports collide with those of outgoing connections


def check_host(host: HostFacts) -> Iterator[Finding]:
    """Everything about the machine that does not concern one camera."""
    yield from _check_aravis(host)
    yield from _check_cores(host)
    if host.available_bytes < FREE_BYTES:
        yield warning("memory", f"{host.available_bytes >> 20} MiB are free", "Close what is not needed here.")
    else:
        yield ok("memory", f"{host.available_bytes / 2**30:.1f} GiB are free")
    yield from _check_clock(host.clock)
    yield from _check_environment(host)


def _check_aravis(host: HostFacts) -> Iterator[Finding]:
    if host.aravis_error:
        yield error("aravis", host.aravis_error, "sudo apt install python3-gi gir1.2-aravis-0.8, then make setup")
    else:
        yield ok("aravis", "can be imported")


def _check_cores(host: HostFacts) -> Iterator[Finding]:
    free = host.cores - host.load
    text = f"{host.cores} cores, {max(free, 0.0):.1f} of them free (load {host.load:.1f})"
    if free < FREE_CORES:
        yield warning("cores", text, "Close other programs, or run fewer camera clients on this machine.")
    else:
        yield ok("cores", text)
    if not host.governors:
        yield note("governor", "unknown: this system shows no CPU frequency governor (a virtual machine?)")
    elif set(host.governors) == {"performance"}:
        yield ok("governor", "performance on all cores")
    else:
        names = ", ".join(sorted(set(host.governors)))
        yield note(
            "governor",
            f"{names}: cores that sleep wake up late, which adds latency",
            "sudo cpupower frequency-set -g performance",
        )


def _check_clock(clock: ClockFacts) -> Iterator[Finding]:
    remedy = "Install chrony (or linuxptp with PTP cameras): frame sets are formed by stamps of several machines."
    if clock.unknown_because:
        yield note("clock", f"unknown: {clock.unknown_because}", remedy)
    elif not clock.in_step:
        yield warning("clock", f"the system's clock is not kept in step ({clock.keeper})", remedy)
    elif clock.offset_s is None:
        yield ok("clock", f"kept in step by {clock.keeper}; how closely is unknown")
    elif abs(clock.offset_s) > CLOCK_LIMIT_S:
        yield warning(
            "clock",
            f"{1e3 * abs(clock.offset_s):.1f} ms off ({clock.keeper})",
            "Wait until it has settled, or use a server in this network.",
        )
    else:
        yield ok("clock", f"{1e6 * abs(clock.offset_s):.0f} us off ({clock.keeper})")


def _check_environment(host: HostFacts) -> Iterator[Finding]:
    given = host.environment
    domain = given.get("ROS_DOMAIN_ID", "")
    if domain and not (domain.isdigit() and int(domain) <= HIGHEST_DOMAIN):
        yield error("ros", f"ROS_DOMAIN_ID = '{domain}'", f"Give a number from 0 to {HIGHEST_DOMAIN}.")
    else:
        yield ok("ros", f"ROS_DOMAIN_ID = {domain or '0 (not set)'}; it must be the same on all machines")
    reach = given.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if reach and reach not in RANGES:
        yield error("ros", f"ROS_AUTOMATIC_DISCOVERY_RANGE = '{reach}'", f"Give one of {', '.join(RANGES)}.")
    elif reach in ("LOCALHOST", "OFF") or given.get("ROS_LOCALHOST_ONLY") == "1":
        what = "ROS_LOCALHOST_ONLY = 1" if not reach else f"ROS_AUTOMATIC_DISCOVERY_RANGE = {reach}"
        yield warning(
            "ros",
            f"{what}: other machines do not hear this one",
            "export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET, unless the whole graph runs here.",
        )
    rmw = given.get("RMW_IMPLEMENTATION", "")
    if rmw and rmw != TESTED_RMW:
        yield note("ros", f"RMW_IMPLEMENTATION = {rmw}; tested with {TESTED_RMW}", "All machines must use the same.")
