"""Compares the ROS settings of this machine and another: whether their nodes can find each other, and if not, why.

`sagoma doctor --answer` tells those of the nodes that run there, read from their environment; where none can be read,
those of its own shell. Nodes find each other by multicast (discovery range SUBNET), or where one machine names the
other as a peer (ROS_STATIC_PEERS).
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil

from ...graph.network_settings import PEERS_VARIABLE, PROFILE_VARIABLE, RANGE_VARIABLE
from ..findings import Finding, error, ok, on, warning
from .announcements import AnnouncementListener
from .link_probe import ask_settings, reaches
from .network import DOMAIN_PORTS, FIRST_PORT, PARTICIPANTS, SMALL_BYTES, collect_network

NODE_MARK = "--ros-args"  # in the command line of every node that was started as one
SUBNET, ALONE = "SUBNET", ("LOCALHOST", "OFF")
ANNOUNCED_S = 4.0  # without our profile a process announces itself every three seconds
UNUSED_PORT = 10 + 2 * PARTICIPANTS + 9  # of a domain's: no process listens there
DOCS = "docs/hosts.md"


@dataclass(frozen=True)
class RosSettings:
    """What decides whom nodes hear: domain, discovery range, static peers, name of the profile's file, middleware."""

    domain: int = 0
    reach: str = SUBNET
    peers: tuple[str, ...] = ()
    profile: str = ""
    middleware: str = ""

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> RosSettings:
        """Read them from environment variables."""
        domain = environment.get("ROS_DOMAIN_ID", "")
        reach = environment.get(RANGE_VARIABLE) or SUBNET
        if environment.get("ROS_LOCALHOST_ONLY") == "1":
            reach = ALONE[0]
        peers = tuple(filter(None, environment.get(PEERS_VARIABLE, "").split(";")))
        profile = Path(environment.get(PROFILE_VARIABLE, "")).name
        middleware = environment.get("RMW_IMPLEMENTATION", "")
        return cls(int(domain) if domain.isdigit() else 0, reach, peers, profile, middleware)


@dataclass(frozen=True)
class PeerFacts:
    """A machine's settings. nodes : those of its nodes, each once; domains : where processes listen, seen by ports;
    shell : those of the shell that told."""

    nodes: tuple[RosSettings, ...]
    domains: tuple[int, ...]
    shell: RosSettings

    def to_json(self) -> bytes:
        """Return it as it is sent."""
        return json.dumps(asdict(self), separators=(",", ":")).encode()

    @classmethod
    def from_json(cls, text: bytes) -> PeerFacts | None:
        """Return the inverse of :meth:`to_json`; None for anything else, such as an answer that was cut."""
        try:
            told = json.loads(text)
            *nodes, shell = (_settings(each) for each in [*told["nodes"], told["shell"]])
            return cls(tuple(nodes), tuple(map(int, told["domains"])), shell)
        except (ValueError, KeyError, TypeError):
            return None


@dataclass(frozen=True)
class PeerLink:
    """How both machines can reach each other: their addresses, whether announcements of nodes there are heard here,
    and whether packets to a ROS port there arrive (None: not tried)."""

    ours: str
    theirs: str
    announces: bool | None = None
    port_open: bool | None = None


def collect_here() -> PeerFacts:
    """Return this machine's settings."""
    nodes = dict.fromkeys(map(RosSettings.of, _node_environments()))
    return PeerFacts(tuple(nodes), collect_network().domains_here, RosSettings.of(os.environ))


def told_here() -> bytes:
    """Return what `sagoma doctor --answer` tells."""
    return collect_here().to_json()


def examine_peer(address: str) -> Iterator[Finding]:
    """Ask a machine for its settings and compare; nothing where nobody answers there (another check says so)."""
    ours = RosSettings.of(os.environ)
    port = FIRST_PORT + DOMAIN_PORTS * ours.domain + UNUSED_PORT
    told = ask_settings(address, beside=port)
    theirs = None if told is None else PeerFacts.from_json(told[0])
    if told is None or theirs is None:
        return
    link = PeerLink(told[1], address)
    if any(node.domain == ours.domain for node in theirs.nodes):
        announces = hears(address, ours.domain) if ours.reach not in ALONE else None
        link = PeerLink(told[1], address, announces, reaches(address, SMALL_BYTES, port))
    yield from on(f"machine {address}", check_peer(theirs, ours, link))


def hears(address: str, domain: int, patience_s: float = ANNOUNCED_S) -> bool:
    """Return whether nodes of that machine announce themselves here by multicast within ``patience_s``."""
    deadline_s = time.monotonic() + patience_s
    with AnnouncementListener(loopback_only=False) as listener:
        while time.monotonic() < deadline_s:
            if any(heard.address == address and heard.domain == domain for heard in listener.heard):
                return True
            time.sleep(0.1)
    return False


def check_peer(theirs: PeerFacts, ours: RosSettings, link: PeerLink) -> Iterator[Finding]:
    """Check that nodes there and here are of one domain and find each other."""
    if not theirs.nodes and not theirs.domains:
        text = "no ROS node runs there"
        yield warning("nodes.none_there", text, "Start it: sagoma up --cameras FILE, or --only server.")
        return
    domains = sorted({node.domain for node in theirs.nodes} or set(theirs.domains))
    if ours.domain not in domains:
        listed = ", ".join(map(str, domains))
        yield error(
            "domain.differs",
            f"its nodes run in ROS_DOMAIN_ID {listed}, this doctor in {ours.domain}",
            f"export ROS_DOMAIN_ID={ours.domain} there and start them again, or {listed} here.",
        )
        return
    if not theirs.nodes:
        return  # of another user, perhaps: their settings cannot be read
    mine = [node for node in theirs.nodes if node.domain == ours.domain]
    yield from _check_discovery(mine[0], ours, link)
    if link.port_open is False:
        low = FIRST_PORT + DOMAIN_PORTS * ours.domain
        text = f"packets to its ROS ports vanish (UDP {low} to {low + DOMAIN_PORTS - 1}), to others not: a firewall"
        yield error("firewall.drops", text, f"Open them there: sudo ufw allow proto udp from {link.ours}.")
    if mine[0].profile != ours.profile:
        named = " and ".join(name or "none" for name in (mine[0].profile, ours.profile))
        text = f"Fast DDS profiles differ: there and here {named}"
        yield warning("profile.differs", text, f"{PROFILE_VARIABLE}=config/dds/fastdds.xml on all machines. {DOCS}")
    if mine[0].middleware != ours.middleware and {mine[0].middleware, ours.middleware} != {"", "rmw_fastrtps_cpp"}:
        text = f"another middleware runs there: RMW_IMPLEMENTATION={mine[0].middleware or 'not set'}"
        yield error("middleware.differs", text, "The same RMW_IMPLEMENTATION on all machines.")
    yield ok("settings", "; ".join(map(_text, theirs.nodes)))


def _check_discovery(theirs: RosSettings, ours: RosSettings, link: PeerLink) -> Iterator[Finding]:
    """Check that one machine asks the other, or that multicast carries their announcements."""
    named = link.ours in theirs.peers or link.theirs in ours.peers
    if named:
        yield ok("discovery", "one of both machines names the other as a peer")
        return
    remedy = f"sagoma ... --peers {link.ours} there or --peers {link.theirs} here, at every start, or {RANGE_VARIABLE}="
    remedy += f"{SUBNET} on both where multicast passes. {DOCS}"
    for settings, place in ((theirs, "there"), (ours, "here")):
        if settings.reach not in ALONE:
            continue
        if settings.peers:
            text = f"{place}, only peers are heard ({', '.join(settings.peers)}): neither machine names the other"
            yield error("peers.missing", text, remedy)
        else:
            text = f"{RANGE_VARIABLE} is {settings.reach} {place}, and neither machine names the other as a peer"
            yield error("discovery.local", text, remedy)
        return
    if link.announces is False:
        text = f"nodes run there in ROS_DOMAIN_ID {ours.domain}, but their multicast does not arrive here"
        why = "A switch with IGMP snooping, Wi-Fi, another subnet, or a firewall keeps it back: "
        yield error("multicast.blocked", text, f"{why}give addresses, {remedy.partition(', or ')[0]}. {DOCS}")
    else:
        yield ok("discovery", "by multicast")


def _text(settings: RosSettings) -> str:
    peers = f", peers {', '.join(settings.peers)}" if settings.peers else ""
    profile = f", profile {settings.profile}" if settings.profile else ""
    return f"nodes in ROS_DOMAIN_ID {settings.domain}, discovery {settings.reach}{peers}{profile}"


def _settings(told: Mapping[str, object]) -> RosSettings:
    known = {key: told[key] for key in RosSettings.__dataclass_fields__}
    settings = RosSettings(**{**known, "peers": tuple(known["peers"])})  # type: ignore[arg-type]
    if not isinstance(settings.domain, int) or not all(isinstance(peer, str) for peer in settings.peers):
        raise ValueError("no settings")
    return settings


def _node_environments() -> Iterator[Mapping[str, str]]:
    """Yield the environment of every node on this machine's network (a container's own is another machine)."""
    here = _network_of("self")
    for process in psutil.process_iter(["cmdline"]):
        if NODE_MARK in (process.info["cmdline"] or []) and _network_of(str(process.pid)) == here:
            try:
                yield process.environ()
            except psutil.Error:  # of another user, or it has ended
                continue


def _network_of(process: str) -> str:
    try:
        return os.readlink(f"/proc/{process}/ns/net")
    except OSError:
        return ""
