"""Joins pairs of network interfaces, and delays, loses and duplicates what passes.

    python tests/support/link_emulator.py [--seed N]  # in a network namespace
    python tests/support/link_emulator.py --no-offload eth0  # the kernel writes its checksums

Every line on standard input is an order, as JSON: {"a": INTERFACE, "b": INTERFACE, "condition": null or {"delay_ms",
"jitter_ms", "loss", "duplicate"}}; null parts the two. Each direction of a pair is a queue: packets leave in order, at
``delay_ms`` and up to ``jitter_ms`` more after they came. What is drawn at random comes from the seed, a packet after
the other. It ends with its input.
"""

from __future__ import annotations

import argparse
import array
import fcntl
import heapq
import json
import os
import random
import select
import socket
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

ETH_P_ALL, PACKET_BYTES = 0x0003, 65536
SOL_PACKET, PACKET_IGNORE_OUTGOING = 263, 23  # linux/if_packet.h
SIOCETHTOOL, TX_CHECKSUM, TSO, GSO = 0x8946, 0x17, 0x1F, 0x24  # linux/sockios.h, linux/ethtool.h: the three "set"
BUFFER_BYTES = 4 << 20
IDLE_S = 3600.0


@dataclass
class Direction:
    """One way of a pair: what comes out of ``source`` goes into ``sink``."""

    source: socket.socket
    sink: socket.socket
    delay_s: float
    jitter_s: float
    loss: float
    duplicate: float
    last_due_s: float = 0.0

    def due(self, now_s: float, draw: random.Random) -> Iterator[float]:
        """Yield when a packet that comes now leaves: never, once or twice."""
        if draw.random() < self.loss:
            return
        for _ in range(1 + (draw.random() < self.duplicate)):
            self.last_due_s = max(now_s + self.delay_s + draw.random() * self.jitter_s, self.last_due_s)
            yield self.last_due_s


class Emulator:
    """All pairs; ``clock`` in seconds."""

    def __init__(self, seed: int) -> None:
        self._draw = random.Random(seed)
        self._pairs: dict[str, list[Direction]] = {}
        self._directions: dict[int, Direction] = {}
        self._waiting: list[tuple[float, int, Direction, bytes]] = []
        self._count = 0

    def order(self, line: str) -> None:
        """Join or part two interfaces. What waits between them is lost."""
        told = json.loads(line)
        for direction in self._pairs.pop(told["a"], []):
            del self._directions[direction.source.fileno()]
            direction.source.close()
        if told["condition"] is None:
            return
        condition = told["condition"]
        ends = [packet_socket(told["a"]), packet_socket(told["b"])]
        figures = (
            1e-3 * condition["delay_ms"],
            1e-3 * condition["jitter_ms"],
            condition["loss"],
            condition["duplicate"],
        )
        self._pairs[told["a"]] = [Direction(*two, *figures) for two in (ends, ends[::-1])]
        self._directions.update({each.source.fileno(): each for each in self._pairs[told["a"]]})

    def run(self) -> None:
        """Serve until standard input ends."""
        orders = sys.stdin.fileno()
        rest = b""
        while True:
            wait_s = max(self._waiting[0][0] - time.monotonic(), 0.0) if self._waiting else IDLE_S
            for ready in select.select([orders, *self._directions], [], [], wait_s)[0]:
                if ready == orders:
                    came = os.read(orders, PACKET_BYTES)
                    if not came:
                        return
                    *lines, rest = (rest + came).split(b"\n")
                    for line in lines:
                        self.order(line.decode())
                    break  # the sockets are others now
                self._receive(self._directions[ready])
            self._send_due()

    def _receive(self, direction: Direction) -> None:
        while True:
            try:
                packet = direction.source.recv(PACKET_BYTES)
            except OSError:  # none is left, or the interface is down
                return
            for due_s in direction.due(time.monotonic(), self._draw):
                self._count += 1
                heapq.heappush(self._waiting, (due_s, self._count, direction, packet))

    def _send_due(self) -> None:
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, _, direction, packet = heapq.heappop(self._waiting)
            try:
                direction.sink.send(packet)
            except OSError:  # parted, down, or the queue of the other side is full: lost, as on a wire
                continue


def packet_socket(interface: str) -> socket.socket:
    """Open a socket for all that comes out of an interface, and puts in what is sent."""
    link = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL))
    link.setsockopt(SOL_PACKET, PACKET_IGNORE_OUTGOING, 1)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    link.bind((interface, ETH_P_ALL))
    link.setblocking(False)
    return link


def end_offload(interface: str) -> None:
    """Let the kernel finish packets itself: checksums and segments."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for setting in (TX_CHECKSUM, TSO, GSO):
            value = array.array("B", struct.pack("II", setting, 0))
            request = struct.pack("16sP", interface.encode(), value.buffer_info()[0]) + bytes(16)
            fcntl.ioctl(link, SIOCETHTOOL, request)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-offload", metavar="INTERFACE")
    arguments = parser.parse_args()
    if arguments.no_offload:
        end_offload(arguments.no_offload)
    else:
        Emulator(arguments.seed).run()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
