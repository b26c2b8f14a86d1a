"""Checks of the network between two machines of the graph: path, packet size, ROS settings.

A UDP packet to a closed port is answered by the receiver's kernel (ICMP port unreachable), which a connected socket
reports as "connection refused": proof, without privileges or a program at the other end, that the packet arrived. With
the don't-fragment bit it proves that the whole path carries packets of that size. Where `sagoma doctor --answer` runs,
that answers instead, with the ROS settings of the nodes there; no answer is larger than its question.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import select
import socket
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import psutil

from sagoma_ros.middleware import PEERS_VARIABLE, PROFILE, PROFILE_VARIABLE, RANGE_VARIABLE

from .findings import CheckResult, about, error, ok, result_of, warning
from .machine import DOMAIN_PORTS, FIRST_PORT, PARTICIPANTS, Interface, interface_to

PORT = 7398  # below all ROS domains' ports
UNUSED_PORT = 10 + 2 * PARTICIPANTS + 9  # of a domain's: no process listens there
ALONE = ("LOCALHOST", "OFF")  # discovery ranges within this machine
DOCS = "docs/how-to/hosts.md"

# questions and answers of two doctors ---------------------------------------------------------------------------------

SMALL_BYTES, FULL_BYTES = 64, 1400  # of a question, headers included: the latter as large as packets of our DDS profile
UNICAST, MULTICAST, GROUP = b"sagoma?", b"sagoma*", "239.255.0.1"  # the group of DDS discovery
HEADERS = 28  # IPv4 and UDP
IP_MTU_DISCOVER, IP_PMTUDISC_PROBE = 10, 3  # linux/in.h: don't fragment, and ignore the cached path MTU
PATIENCE_S, TRIES = 0.3, 5
NODE_MARK = "--ros-args"  # in the command line of every node that was started as one


@dataclass(frozen=True)
class RosSettings:
    """Discovery settings: domain, discovery range, static peers, name of the profile's file, middleware."""

    domain: int = 0
    reach: str = "SUBNET"
    peers: tuple[str, ...] = ()
    profile: str = ""
    middleware: str = ""

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> RosSettings:
        """Read them from environment variables."""
        get = environment.get
        domain, alone = get("ROS_DOMAIN_ID", ""), get("ROS_LOCALHOST_ONLY") == "1"
        reach = "LOCALHOST" if alone else get(RANGE_VARIABLE) or "SUBNET"
        peers, profile = tuple(filter(None, get(PEERS_VARIABLE, "").split(";"))), Path(get(PROFILE_VARIABLE, "")).name
        if profile == PROFILE.name:  # every node's own, where none is named
            profile = ""
        return cls(int(domain) if domain.isdigit() else 0, reach, peers, profile, get("RMW_IMPLEMENTATION", ""))


def settings_here() -> dict[str, Any]:
    """Return the settings of this machine's nodes, each once."""
    return {"nodes": [asdict(node) for node in dict.fromkeys(map(RosSettings.of, _node_environments()))]}


def _node_environments() -> Iterator[Mapping[str, str]]:
    """Yield the environment of every node on this machine's network (a container's own is another machine)."""
    here = Path("/proc/self/ns/net").stat().st_ino
    for process in psutil.process_iter(["cmdline"]):
        with contextlib.suppress(OSError, psutil.Error):  # of another user, or it has ended
            network = Path(f"/proc/{process.pid}/ns/net")
            if NODE_MARK in (process.info["cmdline"] or []) and network.stat().st_ino == here:
                yield process.environ()


def serve(stop: threading.Event, address: str = "", port: int = PORT, ready: Callable[[], object] = bool) -> None:
    """Answer questions until ``stop`` is set; call ``ready`` once the port is open. OSError where it is in use.

    A question is UNICAST and the number of another port on which to answer from then on, too (0: none), padded; the
    answer is :func:`settings_here`, cut to its size. Or MULTICAST and the port to which a multicast packet is sent.
    """
    with _socket() as link, contextlib.ExitStack() as opened:
        link.bind((address, port))
        ready()
        links = [link]
        while not stop.is_set():
            for heard in select.select(links, [], [], 0.2)[0]:
                packet, sender = heard.recvfrom(65536)
                kind, named = packet[: len(UNICAST)], int.from_bytes(packet[len(UNICAST) :][:2], "big")
                with contextlib.suppress(OSError):  # the sender is gone, or somebody else has that port
                    if kind == MULTICAST:
                        way = interface_to(sender[0])
                        here = socket.inet_aton(way.address if way else "")
                        heard.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, here)
                        heard.sendto(MULTICAST, (GROUP, named))
                    elif kind == UNICAST:
                        heard.sendto(json.dumps(settings_here()).encode()[: len(packet)], sender)
                    if kind == UNICAST and named:
                        opened.close()
                        links = [link, opened.enter_context(_socket())]
                        links[1].bind((address, named))


def _socket() -> socket.socket:
    return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


def _question(size: int, port: int = 0, kind: bytes = UNICAST) -> bytes:
    return (kind + port.to_bytes(2, "big")).ljust(size - HEADERS, b"\0")


def receives_multicast(address: str, here: str, port_of_discovery: int, port: int = PORT) -> bool:
    """Return whether multicast to a domain's discovery, sent by the doctor at ``address``, arrives at ``here``."""
    with _socket() as ear, _socket() as link:
        ear.settimeout(PATIENCE_S)
        ear.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        ear.bind((GROUP, port_of_discovery))
        ear.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + socket.inet_aton(here))
        link.connect((address, port))
        for _ in range(TRIES):
            with contextlib.suppress(OSError):
                link.send(_question(SMALL_BYTES, port_of_discovery, MULTICAST))
                if ear.recvfrom(len(MULTICAST))[1][0] == address:
                    return True
    return False


def answer_of(address: str, port: int, question: bytes) -> bytes | None:
    """Return the answer to a question that may not be fragmented on its way; empty where the port is closed, None where
    it does not arrive."""
    with _socket() as link:
        link.settimeout(PATIENCE_S)
        link.setsockopt(socket.IPPROTO_IP, IP_MTU_DISCOVER, IP_PMTUDISC_PROBE)
        link.connect((address, port))
        for _ in range(TRIES):
            try:
                link.send(question)
                return link.recv(65536)
            except ConnectionRefusedError:
                return b""
            except OSError as problem:  # also of time
                if problem.errno in (errno.EMSGSIZE, errno.EHOSTUNREACH, errno.ENETUNREACH):
                    break
    return None


def reaches(address: str, size: int, port: int = PORT) -> bool:
    """Return whether an unfragmented packet of ``size`` bytes, headers included, arrives at a port."""
    return answer_of(address, port, _question(size)) is not None


# checks of another machine --------------------------------------------------------------------------------------------

SIZES = (9000, 1500, 1400, 1280)


@dataclass(frozen=True)
class Peer:
    """ROS settings of a machine's nodes and of this shell, and both addresses.

    multicast, port_open : whether its multicast arrives here, and packets to a ROS port there (None: not tried).
    """

    nodes: tuple[RosSettings, ...]
    ours: RosSettings
    here: str
    there: str
    multicast: bool | None = None
    port_open: bool | None = None

    @property
    def node(self) -> RosSettings | None:
        """The settings of a node there of our domain."""
        return next((node for node in self.nodes if node.domain == self.ours.domain), None)


def examine_hosts(addresses: Sequence[str]) -> Iterator[CheckResult]:
    """Examine the network paths to these machines; sends packets to them alone."""
    for address in addresses:
        link = interface_to(address)
        answers = link is not None and reaches(address, SMALL_BYTES)
        yield from about(f"machine {address}", check_path(address, link, answers))
        if answers and (peer := query_peer(address)):
            yield from examine_peer(f"machine {address}", peer)


def examine_peer(subject: str, peer: Peer) -> Iterator[CheckResult]:
    """Examine whether nodes there and here find each other."""
    yield from about(subject, check_domain(peer), check_discovery(peer), check_settings(peer))


def query_peer(address: str, port: int = PORT) -> Peer | None:
    """Return a machine's ROS settings beside ours, and whether its packets arrive; None without an answer."""
    ours = RosSettings.of(os.environ)
    first = FIRST_PORT + DOMAIN_PORTS * ours.domain
    here = interface_to(address)
    try:
        told = json.loads(answer_of(address, port, _question(FULL_BYTES, first + UNUSED_PORT)) or b"")
        nodes = tuple(RosSettings(**{**node, "peers": tuple(node["peers"])}) for node in told["nodes"])
    except (ValueError, KeyError, TypeError):  # nobody answers, or no doctor
        return None
    peer = Peer(nodes, ours, "" if here is None else here.address, address)
    if peer.node is None:
        return peer
    arrives = None if ours.reach in ALONE else receives_multicast(address, peer.here, first, port)
    return replace(peer, multicast=arrives, port_open=reaches(address, SMALL_BYTES, first + UNUSED_PORT))


def check_path(address: str, link: Interface | None, answers: bool) -> Iterator[CheckResult]:
    """Whether a machine can be reached through an interface here (None: none), ``answers`` a small packet, and gets
    packets of the interface's MTU whole."""
    if link is None:
        remedy = f"Check the address; see: ip route get {address}"
        yield error("way.none", f"there is no way to {address} from this machine", remedy)
        return
    if not answers:
        text = f"{address} does not answer through {link.name}: it is off, or a firewall is silent"
        yield warning("answer.none", text, f"ping {address}; open UDP between the machines.")
        return
    wanted = min(link.mtu, max(SIZES))
    largest = next((size for size in (wanted, *SIZES) if size <= wanted and reaches(address, size)), 0)
    text = f"of {link.name}'s packets of {link.mtu} bytes, {largest or f'less than {SIZES[-1]}'} bytes reach {address}"
    remedy = "Larger messages vanish. Give both machines and the switch between them one MTU: sudo ip link set "
    remedy += f"{link.name} mtu {largest or SIZES[-1]}, or raise the others'."
    yield result_of("mtu", text, (largest < wanted, error, "too_large", remedy))


def check_domain(peer: Peer) -> CheckResult | None:
    """Whether nodes run there, and in our domain."""
    domains = sorted({node.domain for node in peer.nodes})
    if not domains:
        return warning("nodes.none_there", "no ROS node runs there", "Start it: sagoma up --cameras FILE there.")
    if peer.ours.domain in domains:
        return None
    listed, ours = ", ".join(map(str, domains)), peer.ours.domain
    remedy = f"export ROS_DOMAIN_ID={ours} there and start them again, or {listed} here."
    return error("domain.differs", f"its nodes run in ROS_DOMAIN_ID {listed}, this doctor in {ours}", remedy)


def check_discovery(peer: Peer) -> CheckResult | None:
    """Whether static peers or multicast carry the machines' discovery."""
    theirs, ours = peer.node, peer.ours
    if theirs is None:
        return None
    if peer.here in theirs.peers or peer.there in ours.peers:
        return ok("discovery", "one of both machines names the other as a peer")
    name = f"sagoma ... --peers {peer.here} there or --peers {peer.there} here, at every start"
    alone = [
        f"{place} {RANGE_VARIABLE} is {each.reach}{f' and {each.peers} are heard' if each.peers else ''}"
        for each, place in ((theirs, "there"), (ours, "here"))
        if each.reach in ALONE
    ]
    if alone:
        text = f"{', '.join(alone)}: neither machine names the other as a peer"
        remedy = f"{name}, or {RANGE_VARIABLE}=SUBNET on both where multicast passes. {DOCS}"
        return error("discovery.local", text, remedy)
    text = f"nodes run there in ROS_DOMAIN_ID {ours.domain}, but their multicast does not arrive here"
    why = "A switch with IGMP snooping, Wi-Fi, another subnet, or a firewall keeps it back: give addresses, "
    blocked = peer.multicast is False
    return error("multicast.blocked", text, f"{why}{name}. {DOCS}") if blocked else ok("discovery", "by multicast")


def check_settings(peer: Peer) -> Iterator[CheckResult]:
    """Firewall, Fast DDS profile and middleware there."""
    node, ours = peer.node, peer.ours
    if node is None:
        return
    if peer.port_open is False:
        low = FIRST_PORT + DOMAIN_PORTS * ours.domain
        text = f"packets to its ROS ports vanish (UDP {low} to {low + DOMAIN_PORTS - 1}), to others not: a firewall"
        yield error("firewall.drops", text, f"Open them there: sudo ufw allow proto udp from {peer.here}.")
    if node.profile != ours.profile:
        text = f"Fast DDS profiles differ: there and here {node.profile or 'none'} and {ours.profile or 'none'}"
        yield warning("profile.differs", text, f"{PROFILE_VARIABLE}=config/dds/fastdds.xml on all machines. {DOCS}")
    if node.middleware != ours.middleware and {node.middleware, ours.middleware} != {"", "rmw_fastrtps_cpp"}:
        text = f"another middleware runs there: RMW_IMPLEMENTATION={node.middleware or 'not set'}"
        yield error("middleware.differs", text, "The same RMW_IMPLEMENTATION on all machines.")
