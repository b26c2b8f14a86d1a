"""What the drills of bench/hosts.py share, with light senders or with real camera clients (hosts_clients.py)."""

from __future__ import annotations

import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hosts_witness import Witness
from namespaces import Condition, World

SERVER, DOMAIN, OTHER_DOMAIN = "server", "7", "8"
JUMBO, NO_PROFILE = 9000, "none"
SETTLE_S, LOOK_S = 1.5, 0.02
NEIGHBOUR_HZ = 60.0


class NetworkDrill(ABC):
    """A world with a server and camera hosts in it; ``witness``: what the server's listener tells; ``heavy``: which of
    the cameras suffers from packets that are too large."""

    world: World
    witness: Witness
    folder: Path
    environment: dict[str, str]
    hz: float
    cut_s: float
    absent_s: float
    recover_s: float
    heavy: int

    @property
    def cameras(self) -> list[str]:
        """The hosts of cameras; the last one suffers where one does."""
        return [name for name in self.world.hosts if name != SERVER]

    @abstractmethod
    def switch_off(self, camera: str) -> None:
        """Take a camera host's power."""

    @abstractmethod
    def switch_on(self, camera: str, ahead_s: float = 0.0) -> float:
        """Give it again, its clock ahead by so much; returns when, s of the monotonic clock."""

    def restart(self, camera: str, ahead_s: float = 0.0) -> float:
        """Switch a camera host off and on; returns when it was on, s of the monotonic clock."""
        self.switch_off(camera)
        return self.switch_on(camera, ahead_s)

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


def vanish(drill: NetworkDrill, name: str) -> list[Any]:
    """Take the power of the last camera's host, and give it again."""
    camera = drill.cameras[-1]
    drill.world.cables[camera].cut()
    drill.switch_off(camera)
    gone_s = time.monotonic()
    lost_s = drill.wait("the graph's notice", lambda: drill.witness.lost_since(camera, gone_s))
    row = drill.measure(name, drill.absent_s, noticed_s=None if lost_s is None else lost_s - gone_s)
    drill.world.cables[camera].mend()
    return [replace(row, recovered_s=drill.since_whole(drill.switch_on(camera)))]


def apart(seconds: float) -> Trial:
    """Return the trial of a host whose clock is ahead by so much; its camera exposes with the others."""

    def trial(drill: NetworkDrill, name: str) -> list[Any]:
        camera = drill.cameras[-1]
        drill.restart(camera, seconds)
        time.sleep(SETTLE_S)
        row = drill.measure(name)
        return [replace(row, recovered_s=drill.since_whole(drill.restart(camera)))]

    return trial


def sender(drill: NetworkDrill, camera: str, hz: float, *options: str, domain: str = DOMAIN) -> Any:
    """Start a light sender on a camera's host; returns the process once it sends."""
    program = str(Path(__file__).with_name("hosts_camera.py"))
    command = [sys.executable, program, str(drill.folder / "clip"), camera, f"{hz:g}", *options]
    environment = drill.environment | {"ROS_DOMAIN_ID": domain}
    process = drill.world.hosts[camera].start(command, environment, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline(), f"the sender of {camera} did not start"
    return process


def other_domain(drill: NetworkDrill, name: str) -> list[Any]:
    """Let a neighbour's cameras of the same names send from every camera host, in another ROS domain."""
    senders = [sender(drill, camera, NEIGHBOUR_HZ, domain=OTHER_DOMAIN) for camera in drill.cameras]
    time.sleep(SETTLE_S)
    row = drill.measure(name)
    for process in senders:
        process.kill()
        process.wait()
    return [row]


def jumbo(drill: NetworkDrill, name: str) -> list[Any]:
    """Let a host send packets that the bridge does not take, from its start on."""
    camera = drill.cameras[drill.heavy]
    drill.world.cables[camera].set_host_mtu(JUMBO)
    recovered_s = drill.since_whole(drill.restart(camera))
    row = drill.measure(name, recovered_s=recovered_s)
    drill.world.cables[camera].set_host_mtu(None)
    drill.restart(camera)
    return [row]


def environment_of(world: World, folder: Path, arguments: Any) -> dict[str, str]:
    """Return the variables that docs/how-to/hosts.md sets on every machine."""
    environment = {"ROS_DOMAIN_ID": DOMAIN, "ROS_LOG_DIR": str(folder), "OPENBLAS_NUM_THREADS": "1"}
    if arguments.profile != NO_PROFILE:
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(Path(arguments.profile).resolve())
    if arguments.peers:
        peers = ";".join(host.address for host in world.hosts.values())
        environment |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": peers}
    return environment
