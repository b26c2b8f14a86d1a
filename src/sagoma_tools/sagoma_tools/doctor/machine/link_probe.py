"""Measures the link to another machine with a program at its other end: clock, loss, bandwidth; asks its settings.

There, `sagoma doctor --answer` serves; here :func:`measure_link` asks, and sends to nobody else. The clock's offset is
that of the exchange with the shortest round trip (NTP: RFC 5905, 8); its error is at most half of that. Bandwidth is
the rate at which a train of packets sent at once arrives (packet dispersion: Dovrolis et al., IEEE/ACM Trans. Netw.
12(6), 2004), its first quarter left out, for which a switch or a shaper may have room; of several trains the fastest,
as other programs hold up single ones. Packets are stamped by the kernel where they arrive. No answer is larger than its
question.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

PORT = 7398  # below all ROS domains' ports, which begin at 7400
MAGIC = b"SGWY"
PING, PONG, CAR, ASK, REPORT, ASK_SETTINGS, SETTINGS = range(7)
PACKET = struct.Struct("<4sBIqqq")  # magic, kind, number, three times or counts
SO_TIMESTAMPNS, TIMESPEC = 35, struct.Struct("qq")  # asm-generic/socket.h: stamps as two 64-bit numbers
PINGS, PING_PERIOD_S = 500, 1e-3  # half a second: a loss of 1 % is five of them
TRAINS, CARS, CAR_BYTES = 5, 100, 1372  # with its headers as large as a packet of our DDS profile
HEADERS = 28  # IPv4 and UDP
IP_MTU_DISCOVER, IP_PMTUDISC_PROBE = 10, 3  # linux/in.h: don't fragment, and ignore what was learned before
FRAMING_BYTES = 28 + 38  # IPv4 and UDP; Ethernet's header, checksum, preamble and gap
FILLED = 4  # the first quarter of a train is not counted
PATIENCE_S, LAST_S, POLL_S = 0.3, 0.3, 0.2
TRIES = 5


@dataclass(frozen=True)
class LinkFacts:
    """What was measured of the link to a machine.

    offset_s : its clock minus ours, to +- error_s; loss : share of the packets that did not come back.
    rate_mbit : bandwidth from here to there; None when too few packets of the trains arrived.
    """

    offset_s: float
    error_s: float
    loss: float
    rate_mbit: float | None


def measure_link(address: str, port: int = PORT) -> LinkFacts | None:
    """Measure the link to a machine; None when nothing answers there."""
    with _socket() as link:
        link.connect((address, port))
        if not _is_answered(link):
            return None
        exchanges = _ping(link)
        rates = [rate for train in range(TRAINS) if (rate := _send_train(link, train)) is not None]
    trip_ns, offset_ns = min(exchanges.values(), default=(0, 0))
    return LinkFacts(1e-9 * offset_ns, 0.5e-9 * trip_ns, 1 - len(exchanges) / PINGS, max(rates, default=None))


def ask_settings(address: str, port: int = PORT, beside: int = 0) -> tuple[bytes, str] | None:
    """Ask a machine for its settings; returns them and our own address on that link, None without an answer.

    beside : another port on which it is to answer from then on, for :func:`reaches`.
    """
    with _socket() as link:
        link.connect((address, port))
        link.settimeout(PATIENCE_S)
        for _ in range(TRIES):
            _send(link, _pack(ASK_SETTINGS, beside, 0, 0, 0) + bytes(CAR_BYTES - PACKET.size))
            while (came := _receive(link)) is not None:
                if PACKET.unpack_from(came[0])[1] == SETTINGS:
                    return came[0][PACKET.size :], str(link.getsockname()[0])
    return None


def reaches(address: str, size: int, port: int = PORT) -> bool:
    """Return whether an unfragmented packet of ``size`` bytes, headers included, arrives at a port.

    What answers there is `sagoma doctor --answer`, or, where nobody listens, the kernel ("port unreachable": not more
    than one a second of those to everybody, so that a busy graph may use them up).
    """
    with _socket() as link:
        link.settimeout(PATIENCE_S)
        link.setsockopt(socket.IPPROTO_IP, IP_MTU_DISCOVER, IP_PMTUDISC_PROBE)
        link.connect((address, port))
        for _ in range(TRIES):
            try:
                link.send(_pack(PING, 0, time.time_ns(), 0, 0) + bytes(size - HEADERS - PACKET.size))
                link.recv(1)
            except TimeoutError:
                continue
            except ConnectionRefusedError:
                return True
            except OSError as problem:
                if problem.errno in (errno.EMSGSIZE, errno.EHOSTUNREACH, errno.ENETUNREACH):
                    return False
                with contextlib.suppress(OSError):
                    link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            else:
                return True
    return False


def answer(
    stop: threading.Event,
    address: str = "",
    port: int = PORT,
    clock_ns: Callable[[int], int] = lambda now_ns: now_ns,
    begun: Callable[[], object] = lambda: None,
    settings: Callable[[], bytes] = bytes,
) -> None:
    """Answer questions until ``stop`` is set; call ``begun`` once they are heard.

    ``clock_ns`` turns the machine's time into that of this clock; ``settings`` returns what is told of it, cut to the
    size of the question. Raises OSError where the port is taken.
    """
    with _socket() as link, contextlib.ExitStack() as opened:
        link.bind((address, port))
        begun()
        trains: dict[tuple[str, int], list[tuple[int, int]]] = {}
        beside: socket.socket | None = None
        while not stop.is_set():
            heard = [link] if beside is None else [link, beside]
            ready = select.select(heard, [], [], POLL_S)[0]
            if beside in ready:
                _answer_ping(beside)
            came = _receive(link) if link in ready else None
            if came is None:
                continue
            packet, sender, at_ns = came
            _, kind, number, one, two, _ = PACKET.unpack_from(packet)
            if kind == PING:
                link.sendto(_pack(PONG, number, one, clock_ns(at_ns), clock_ns(time.time_ns())), sender)
            elif kind == CAR:
                if two == 0 or (sender[0], number) not in trains:
                    trains = {(sender[0], number): []}  # one train at a time is remembered
                trains[sender[0], number].append((at_ns, len(packet)))
            elif kind == ASK:
                link.sendto(_pack(REPORT, number, *_measured(trains.get((sender[0], number), [])), 0), sender)
            elif kind == ASK_SETTINGS:
                opened.close()
                beside = opened.enter_context(_listening(address, number)) if number else None
                link.sendto((_pack(SETTINGS, number, 0, 0, 0) + settings())[: len(packet)], sender)


def _listening(address: str, port: int) -> socket.socket:
    link = _socket()
    with contextlib.suppress(OSError):  # somebody else has that port
        link.bind((address, port))
    return link


def _answer_ping(link: socket.socket) -> None:
    """Answer a packet on the port beside, for which it matters only that it came."""
    came = _receive(link)
    if came is not None and PACKET.unpack_from(came[0])[1] == PING:
        link.sendto(_pack(PONG, 0, 0, 0, 0), came[1])


def _measured(cars: list[tuple[int, int]]) -> tuple[int, int]:
    """Return the bytes that arrived after the first quarter of a train, and how long they took, ns."""
    counted = cars[len(cars) // FILLED :]
    if len(counted) < CARS // 2:
        return 0, 0
    return sum(size + FRAMING_BYTES for _, size in counted[1:]), counted[-1][0] - counted[0][0]


def _is_answered(link: socket.socket) -> bool:
    link.settimeout(PATIENCE_S)
    for _ in range(TRIES):
        _send(link, _pack(PING, 0, time.time_ns(), 0, 0))
        if _receive(link) is not None:
            return True
    return False


def _ping(link: socket.socket) -> dict[int, tuple[int, int]]:
    """Send numbered questions one by one; return round trip and offset, ns, of each that was answered."""
    exchanges: dict[int, tuple[int, int]] = {}
    begin_s = time.monotonic()
    for number in range(1, PINGS + 1):
        _send(link, _pack(PING, number, time.time_ns(), 0, 0))
        _collect(link, exchanges, begin_s + number * PING_PERIOD_S)
    _collect(link, exchanges, time.monotonic() + LAST_S)
    return exchanges


def _collect(link: socket.socket, exchanges: dict[int, tuple[int, int]], until_s: float) -> None:
    while (left_s := until_s - time.monotonic()) > 0:
        link.settimeout(left_s)
        came = _receive(link)
        if came is None or len(exchanges) == PINGS:
            return
        packet, _, back_ns = came
        _, kind, number, sent_ns, came_ns, left_ns = PACKET.unpack_from(packet)
        if kind == PONG and number:
            trip_ns = (back_ns - sent_ns) - (left_ns - came_ns)
            exchanges[number] = trip_ns, (came_ns - sent_ns + left_ns - back_ns) // 2


def _send_train(link: socket.socket, train: int) -> float | None:
    """Return the rate at which a train arrived, Mbit/s."""
    for car in range(CARS):
        _send(link, _pack(CAR, train, 0, car, 0) + bytes(CAR_BYTES - PACKET.size))
    link.settimeout(PATIENCE_S)
    for _ in range(TRIES):
        _send(link, _pack(ASK, train, 0, 0, 0))
        while (came := _receive(link)) is not None:
            _, kind, number, arrived, took_ns, _ = PACKET.unpack_from(came[0])
            if kind == REPORT and number == train:
                return 8e3 * arrived / took_ns if took_ns > 0 else None
    return None


def _socket() -> socket.socket:
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    return link


def _send(link: socket.socket, packet: bytes) -> None:
    with contextlib.suppress(OSError):  # nobody listens there any more, or the interface is full: lost
        link.send(packet)


def _receive(link: socket.socket) -> tuple[bytes, tuple[str, int], int] | None:
    """Return the next of our packets, its sender, and when it arrived; None when none came in time."""
    try:
        packet, ancillary, _, sender = link.recvmsg(CAR_BYTES, socket.CMSG_SPACE(TIMESPEC.size))
    except OSError:  # no time left; or "port unreachable": nobody listens there
        return None
    if len(packet) < PACKET.size or not packet.startswith(MAGIC):
        return None
    stamps = [data for _, kind, data in ancillary if kind == SO_TIMESTAMPNS]
    seconds, nanoseconds = TIMESPEC.unpack(stamps[0]) if stamps else divmod(time.time_ns(), 1_000_000_000)
    return packet, sender, seconds * 1_000_000_000 + nanoseconds


def _pack(kind: int, number: int, one: int, two: int, three: int) -> bytes:
    return PACKET.pack(MAGIC, kind, number, one, two, three)
