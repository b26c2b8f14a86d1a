"""Faults that a soak injects into a running studio and its graph, drawn at random from a seed.

A fault begins, lasts, and is undone; one that ends a process undoes itself, by the supervisor's restart.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sagoma_tools.evaluation.live_inputs import StudioProcess
from sagoma_tools.graph.supervisor import Supervisor

SERVER, EVERYBODY = "server", "all"
HULL = "/hull_server"
SHORTEST_S, LONGEST_S = 5.0, 20.0
LONGEST_STOPPED_S = 8.0  # longer than a camera waits for its controller's heartbeat (3 s)
# how often each kind comes in a round; the light changes by less than its compensation takes (half to double)
CAMERA_FAULTS = {
    "camera killed": 2,
    "camera suspended": 2,
    "unplugged": 2,
    "stalled": 2,
    "power cut": 1,
    "packets lost": 3,
    "lens covered": 1,
    "picture frozen": 1,
}
ROOM_FAULTS = {"light changed": 2, "person leaves": 2}
SERVER_FAULTS = {"server suspended": 1, "server killed": 1}
LOSS = (0.002, 0.05)  # a bad cable; one that hardly works
LIGHT = (0.7, 1.4)


@dataclass(frozen=True)
class Fault:
    """A fault: its kind, what it hits (a camera, "server" or "all"), how long it lasts (s), and its strength."""

    kind: str
    target: str
    seconds: float
    strength: float = 0.0

    @property
    def ends_a_process(self) -> bool:
        return self.kind.endswith("killed")


def random_faults(seed: int, cameras: Sequence[str], spared: Sequence[str]) -> Iterator[Fault]:
    """Draw faults without end, in rounds: every kind once in the first one, then as often as the tables say.

    The server is hit in the first round only, and the cameras ``spared`` are never killed: the memory of both is
    followed without a break from then on.
    """
    draw = random.Random(seed)
    chances = CAMERA_FAULTS | ROOM_FAULTS
    kinds = [*chances, *SERVER_FAULTS]
    while True:
        draw.shuffle(kinds)
        yield from [_fault(kind, draw, cameras, spared) for kind in kinds]
        kinds = [kind for kind, times in chances.items() for _ in range(times)]


def _fault(kind: str, draw: random.Random, cameras: Sequence[str], spared: Sequence[str]) -> Fault:
    seconds = draw.uniform(SHORTEST_S, LONGEST_S)
    if kind.endswith("killed"):
        seconds = 0.0
    elif kind.endswith("suspended"):
        seconds = min(seconds, LONGEST_STOPPED_S)
    if kind in ROOM_FAULTS:
        return Fault(kind, EVERYBODY, seconds, draw.uniform(*LIGHT) if kind == "light changed" else 0.0)
    if kind in SERVER_FAULTS:
        return Fault(kind, SERVER, seconds)
    hit = [name for name in cameras if kind != "camera killed" or name not in spared]
    return Fault(kind, draw.choice(hit), seconds, draw.uniform(*LOSS) if kind == "packets lost" else 0.0)


class FaultInjector:
    """Begins and undoes faults in one studio and the graph that runs on it."""

    def __init__(self, studio: StudioProcess, supervisor: Supervisor) -> None:
        self._studio, self._supervisor = studio, supervisor
        self._stopped_pid: int | None = None

    def begin(self, fault: Fault) -> None:
        """Begin a fault; one that ends a process is over at once."""
        kind, camera = fault.kind, [fault.target]
        if fault.ends_a_process:
            number = signal.SIGKILL if fault.target != SERVER else signal.SIGSEGV
            os.kill(self._pid(fault), number)
        elif kind.endswith("suspended"):
            self._stopped_pid = self._pid(fault)
            os.kill(self._stopped_pid, signal.SIGSTOP)
        elif kind == "power cut":
            self._studio.ask("off", cameras=camera)
        elif kind == "person leaves":
            self._studio.ask("room", state="empty")
        elif kind == "light changed":
            self._studio.ask("set", cameras=[], faults={"light": fault.strength})
        else:
            switches = {
                "unplugged": {"unplugged": True},
                "stalled": {"stall": True},
                "packets lost": {"packet_loss": fault.strength},
                "lens covered": {"light": 0.0},
                "picture frozen": {"frozen": True},
            }
            self._studio.ask("set", cameras=camera, faults=switches[kind])

    def undo(self, fault: Fault) -> None:
        """End a fault."""
        if self._stopped_pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._stopped_pid, signal.SIGCONT)
            self._stopped_pid = None
        if fault.kind == "power cut":
            self._studio.ask("on", cameras=[fault.target])
        elif fault.kind == "person leaves":
            self._studio.ask("room", state="occupied")
        else:
            self._studio.ask("clear")

    def _pid(self, fault: Fault) -> int:
        name = HULL if fault.target == SERVER else f"/{fault.target}/camera_client"
        return self._supervisor.processes.pids()[name]
