"""What the drills of bench/hosts.py share, with light senders or with real camera clients (hosts_clients.py)."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hosts_witness import Witness
from namespaces import Condition, World

SERVER, DOMAIN, OTHER_DOMAIN = "server", "7", "8"
JUMBO, NO_PROFILE = 9000, "none"
SETTLE_S, LOOK_S = 1.5, 0.02


class NetworkDrill(ABC):
    """A world with a server and camera hosts in it; ``witness``: what the server's listener tells."""

    world: World
    witness: Witness
    hz: float
    cut_s: float
    recover_s: float

    @property
    def cameras(self) -> list[str]:
        """The hosts of cameras; the last one suffers where one does."""
        return [name for name in self.world.hosts if name != SERVER]

    @abstractmethod
    def measure(self, name: str, seconds: float | None = None, **times: float | None) -> Any:
        """Let some time pass, and return its figures."""

    @abstractmethod
    def figures(self, name: str, begin_ns: int, begin_s: float, seconds: float, **times: float | None) -> Any:
        """Return the figures of the exposures in ``seconds`` from an instant on, ns and s of the monotonic clock."""

    def wait(self, what: str, happened: Callable[[], Any], patience_s: float = 0.0) -> Any:
        """Return what ``happened`` returns once it does; None when it did not within its patience, and say so."""
        patience_s = patience_s or self.recover_s
        deadline_s = time.monotonic() + patience_s
        while time.monotonic() < deadline_s:
            if (seen := happened()) is not None:
                return seen
            time.sleep(LOOK_S)
        print(f"{what} did not come within {patience_s:g} s", flush=True)
        return None

    def since_whole(self, since_s: float) -> float | None:
        """Wait until sets are whole; return how long that took after ``since_s``."""
        at_s = self.wait("a whole frame set", lambda: self.witness.whole_since(since_s))
        return None if at_s is None else at_s - since_s


Trial = Callable[[Any, str], list[Any]]


def steady(condition: Condition, everywhere: bool = False) -> Trial:
    """Return the trial of a condition of the cameras' cables, or of every cable."""

    def trial(drill: NetworkDrill, name: str) -> list[Any]:
        with drill.world.under(condition, drill.world.hosts if everywhere else drill.cameras):
            time.sleep(SETTLE_S)
            return [drill.measure(name)]

    return trial


def cut(drill: NetworkDrill, name: str) -> list[Any]:
    """Cut the last camera host's cable and mend it, then the server's."""
    rows = []
    for host in (drill.cameras[-1], SERVER):
        cable = drill.world.cables[host]
        begin_ns, begin_s = time.time_ns(), time.monotonic()
        cable.cut()
        time.sleep(drill.cut_s)
        cable.mend()
        recovered_s = drill.since_whole(time.monotonic())
        rows.append(drill.figures(f"{name}, of {host}", begin_ns, begin_s, drill.cut_s, recovered_s=recovered_s))
    return rows


def environment_of(world: World, folder: Path, arguments: Any) -> dict[str, str]:
    """Return the variables that docs/hosts.md sets on every machine."""
    environment = {"ROS_DOMAIN_ID": DOMAIN, "ROS_LOG_DIR": str(folder), "OPENBLAS_NUM_THREADS": "1"}
    if arguments.profile != NO_PROFILE:
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(Path(arguments.profile).resolve())
    if arguments.peers:
        peers = ";".join(host.address for host in world.hosts.values())
        environment |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": peers}
    return environment
