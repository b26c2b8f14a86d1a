"""Hosts in a network, on one machine: network namespaces joined by a bridge, and cables that delay, lose, cut.

Everything lies in namespaces of one `unshare` (users, network, mounts, processes), which the kernel removes with its
first process, however that ends. Nothing of it is seen outside, nothing inside has a way out: there is no default
route.

    with World(["server", "cam01"]) as world:       # in a process that `inside` has started
        world.hosts["cam01"].start([sys.executable, "sender.py"])
        world.cables["cam01"].set(Condition(delay_ms=5.0, loss=0.01))

A cable is a veth pair whose far end is a port of the bridge. Its rate is the kernel's (tbf); delay, loss and duplicates
are those of `link_emulator.py`, in between as two packet sockets: not every kernel has netem.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

MARK = "SAGOMA_INSIDE_NAMESPACES"
UNSHARE = ["unshare", "--map-root-user", "--net", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
TOOLS = ("unshare", "nsenter", "ip", "tc")
EMULATOR = Path(__file__).with_name("link_emulator.py")
NETWORK, BITS, MTU = "10.66.0", 24, 1500
BRIDGE = "bridge0"
HOST_SCRIPT = "mount -t tmpfs tmpfs /dev/shm && ip link set lo up && echo ready && exec sleep infinity"
UP_S, POLL_S = 10.0, 0.02
LEAST_BURST, BURST_S = 15_000, 1e-3  # bytes that a shaped cable lets through at once
QUEUE_MS = 50  # what a shaped cable holds


@dataclass(frozen=True)
class Condition:
    """The state of a cable, the same in both directions.

    delay_ms : of every packet, and up to ``jitter_ms`` more, without a change of their order.
    loss, duplicate : shares (0 to 1) of the packets, drawn one by one.
    rate_mbit : bandwidth; 0: as fast as the machine.
    """

    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    loss: float = 0.0
    duplicate: float = 0.0
    rate_mbit: float = 0.0

    @property
    def is_packetwise(self) -> bool:
        """Whether single packets are treated, which takes the emulator."""
        return any((self.delay_ms, self.jitter_ms, self.loss, self.duplicate))


def why_not() -> str:
    """Return why there can be no such namespaces here; "" when there can."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"{', '.join(missing)} not installed (apt install iproute2 util-linux)"
    attempt = (
        "mount -t tmpfs tmpfs /dev/shm && ip link add bridge0 type bridge && ip link add here type veth peer name there"
    )
    done = subprocess.run([*UNSHARE, "sh", "-c", attempt], capture_output=True, text=True, check=False)
    return f"no namespaces for this user here ({done.stderr.strip()})" if done.returncode else ""


def inside(arguments: Sequence[str], variables: Mapping[str, str] | None = None) -> subprocess.Popen[str]:
    """Run a Python program in namespaces of its own; its output is a pipe. They end with it, and it with us."""
    environment = {**os.environ, MARK: "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", **(variables or {})}
    return subprocess.Popen(
        [*UNSHARE, sys.executable, *arguments],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
        preexec_fn=_end_with_us,
    )


def is_inside() -> bool:
    """Whether this process was started by :func:`inside`."""
    return MARK in os.environ


def _end_with_us() -> None:
    """Let the kernel end this process when its parent does (prctl(2), PR_SET_PDEATHSIG)."""
    import ctypes

    ctypes.CDLL(None).prctl(1, signal.SIGKILL)


@dataclass
class Host:
    """A machine of the network: its own interfaces, addresses and shared memory."""

    name: str
    address: str
    anchor: subprocess.Popen[str]
    processes: list[subprocess.Popen[Any]] = field(default_factory=list)

    def enter(self, command: Sequence[str]) -> list[str]:
        """Return the command line that runs ``command`` on this host."""
        return ["nsenter", "-t", str(self.anchor.pid), "--net", "--mount", *command]

    def start(self, command: Sequence[str], environment: Mapping[str, str] | None = None, **options: Any) -> Any:
        """Start a process here; it ends with :meth:`kill` at the latest."""
        process = subprocess.Popen(self.enter(command), env={**os.environ, **(environment or {})}, **options)
        self.processes.append(process)
        return process

    def kill(self, spare: Collection[int] = ()) -> None:
        """End every process here at once, as a power cut does, their children too; but for the pids ``spare``."""
        kept = {self.anchor.pid, *spare}
        while found := [pid for pid in self._pids() if pid not in kept]:
            for pid in found:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            for process in self.processes:
                if process.pid not in kept:
                    process.wait()
            time.sleep(POLL_S)
        self.processes = [process for process in self.processes if process.pid in kept]

    def _pids(self) -> list[int]:
        """Every living process in this host's network namespace."""
        mine, found = os.readlink(f"/proc/{self.anchor.pid}/ns/net"), []
        for entry in Path("/proc").iterdir():
            with contextlib.suppress(OSError):  # it has ended, or is about to
                if entry.name.isdigit() and os.readlink(entry / "ns/net") == mine:
                    found.append(int(entry.name))
        return found


class Cable:
    """From one host to the bridge."""

    def __init__(self, world: World, host: Host, number: int) -> None:
        self._world, self._host = world, host
        self.port, self._inner, self._outer = f"port{number}", f"inner{number}", f"outer{number}"
        sh(f"ip link add {self.port} mtu {MTU} type veth peer name eth0 mtu {MTU} netns {host.anchor.pid}")
        self._on_host(f"ip addr add {host.address}/{BITS} dev eth0")
        # a packet socket would hand on checksums that were left to a card
        self._on_host(f"{sys.executable} {EMULATOR} --no-offload eth0")
        sh(f"ip link add {self._inner} mtu {MTU} type veth peer name {self._outer} mtu {MTU}")
        self._join(self._outer)
        for name in (self.port, self._inner, self._outer):
            sh(f"ip link set {name} up")
        self._on_host("ip link set eth0 up")
        self.set(Condition())
        deadline_s = time.monotonic() + UP_S  # the middleware uses what is up when it starts, and never looks again
        while "state UP" not in subprocess.check_output(host.enter(["ip", "link", "show", "eth0"]), text=True):
            assert time.monotonic() < deadline_s, f"eth0 of {host.name} does not come up"
            time.sleep(POLL_S)

    def set(self, condition: Condition) -> None:
        emulated = condition.is_packetwise
        self._world.emulate(self._inner, self.port, condition if emulated else None)
        if emulated:
            sh(f"ip link set {self.port} nomaster")
        else:
            self._join(self.port)
        for run, device in ((sh, self.port), (self._on_host, "eth0")):
            if condition.rate_mbit:
                burst = max(LEAST_BURST, round(condition.rate_mbit * 1e6 / 8 * BURST_S))
                shape = f"tbf rate {condition.rate_mbit:g}mbit burst {burst} latency {QUEUE_MS}ms"
                run(f"tc qdisc replace dev {device} root {shape}")
            else:
                with contextlib.suppress(subprocess.CalledProcessError):  # there was none
                    run(f"tc qdisc del dev {device} root")

    def cut(self) -> None:
        sh(f"ip link set {self.port} down")

    def mend(self) -> None:
        sh(f"ip link set {self.port} up")

    def pass_multicast(self, passes: bool) -> None:
        """Let the bridge hand multicast packets on to this host, or not, in whatever condition the cable is."""
        for port in (self.port, self._outer):
            with contextlib.suppress(subprocess.CalledProcessError):  # it is no port of the bridge now
                sh(f"ip link set {port} type bridge_slave mcast_flood {'on' if passes else 'off'}")

    def _join(self, port: str) -> None:
        sh(f"ip link set {port} master {BRIDGE}")
        self.pass_multicast(self._world.multicast)

    def set_host_mtu(self, mtu: int | None) -> None:
        """Let the host alone send packets of another size than the bridge takes; None: as the cable was made."""
        self._on_host(f"ip link set eth0 mtu {mtu or MTU}")

    def _on_host(self, command: str) -> None:
        sh(*self._host.enter(command.split()))


class World:
    """Hosts on a bridge; a context manager.

    seed : of the packets' fates; multicast : whether the bridge passes it on.
    """

    def __init__(self, names: Sequence[str], seed: int = 0, multicast: bool = True) -> None:
        if not is_inside():
            raise RuntimeError("namespaces are made in a process that namespaces.inside has started")
        self._names, self._seed, self.multicast = names, seed, multicast
        self.hosts: dict[str, Host] = {}
        self.cables: dict[str, Cable] = {}

    def __enter__(self) -> World:
        sh("mount -t tmpfs tmpfs /dev/shm")
        sh("ip link set lo up")
        sh(f"ip link add {BRIDGE} type bridge")
        sh(f"ip link set {BRIDGE} up")
        self._emulator = subprocess.Popen(
            [sys.executable, str(EMULATOR), "--seed", str(self._seed)], stdin=subprocess.PIPE, text=True
        )
        for number, name in enumerate(self._names, start=1):
            host = Host(name, f"{NETWORK}.{number}", _anchor())
            self.hosts[name] = host
            self.cables[name] = Cable(self, host, number)
        return self

    def __exit__(self, *error: object) -> None:
        for host in self.hosts.values():
            host.kill()
            host.anchor.kill()
            host.anchor.wait()
        self._emulator.kill()
        self._emulator.wait()

    def pass_multicast(self, passes: bool) -> None:
        """Let the bridge hand on multicast packets, or not."""
        self.multicast = passes
        for cable in self.cables.values():
            cable.pass_multicast(passes)

    @contextlib.contextmanager
    def under(self, condition: Condition, hosts: Collection[str]) -> Iterator[None]:
        """Put the cables of these hosts into a condition, and back after the block."""
        for host in hosts:
            self.cables[host].set(condition)
        yield
        for host in hosts:
            self.cables[host].set(Condition())

    def emulate(self, inner: str, port: str, condition: Condition | None) -> None:
        """Let the emulator join two interfaces in this condition; None: let it keep off them."""
        told = {"a": inner, "b": port, "condition": None if condition is None else asdict(condition)}
        assert self._emulator.stdin is not None
        print(json.dumps(told), file=self._emulator.stdin, flush=True)


def _anchor() -> subprocess.Popen[str]:
    """Start the process that holds a host's namespaces."""
    command = ["unshare", "--net", "--mount", "sh", "-c", HOST_SCRIPT]
    anchor = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert anchor.stdout is not None and anchor.stdout.readline() == "ready\n"
    return anchor


def sh(*words: str) -> None:
    """Run a command, given as one text or word by word. Raises subprocess.CalledProcessError."""
    command = words[0].split() if len(words) == 1 else list(words)
    subprocess.run(command, check=True, stderr=subprocess.PIPE)
