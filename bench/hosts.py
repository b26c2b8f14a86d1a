"""Camera hosts and a server in a network: what arrives of 60 silhouettes a second under each fault of the network.

    python bench/hosts.py                          # every condition: four camera hosts, 60 Hz
    python bench/hosts.py --quick                  # three conditions, short
    python bench/hosts.py --profile none           # ROS's own DDS settings, or another file than config/dds/fastdds.xml
    python bench/hosts.py --peers                  # a network without multicast; the server's address is given
    python bench/hosts.py --only "loss 5 %"        # conditions whose name begins so (any number of times)
    python bench/hosts.py --clients                # real camera clients, the whole server, at 10 Hz (hosts_clients.py)

Needs Linux namespaces and no rights beside: nothing leaves them (namespaces.py). Real: the hull server, DDS, the
silhouettes (the studio's person, as messages of a camera client). For the camera clients, of which five at 60 Hz are
more than a small machine has, stand light senders (hosts_camera.py). The hull server carves coarsely and thins nothing
out: what is measured is the way of the silhouettes into frame sets. ``complete``: frame sets with all cameras, of those
that were exposed; latency: from exposure until the frame set is closed, p50 and p95, of all sets that were formed.
Faults are those of the cameras' cables, one way; a rate is that of every cable. Clocks are set apart by what the sender
stamps; the exposures are at the same instants. The last line is JSON.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from report import Table, execute, finish, parser

import hosts_clients
import psutil
from hosts_camera import write_clip
from hosts_drill import (
    NO_PROFILE,
    SERVER,
    NetworkDrill,
    Trial,
    apart,
    cut,
    environment_of,
    jumbo,
    other_domain,
    sender,
    steady,
    vanish,
)
from hosts_witness import Row, Witness
from namespaces import Condition, World, inside, is_inside, why_not
from scenes import studio_clip

from capture_rig import save_rig

CAMERAS, HZ, CLIP_S = 4, 60.0, 2.0
SECONDS, QUICK_S = 8.0, 4.0
START_S, WAY_S = 90.0, 0.5
VOXEL_M = 0.08
BENCH = Path(__file__).resolve().parent
PROFILE = BENCH.parent / "config" / "dds" / "fastdds.xml"
QUICK = ("plain", "loss 5 %", "a host vanishes")


class Drill(NetworkDrill):
    """Light senders and a hull server, all of them running."""

    cut_s, absent_s, recover_s = 3.0, 6.0, 30.0
    heavy = 0  # whose silhouettes are the largest

    def __init__(self, world: World, folder: Path, arguments: Any) -> None:
        self.world, self.folder, self.hz, self.seconds = world, folder, arguments.hz, arguments.seconds
        self.environment = environment_of(world, folder, arguments)
        if arguments.profile != NO_PROFILE:
            self.environment["RMW_FASTRTPS_USE_QOS_FROM_XML"] = "1"
        self.witness = self._start_server(arguments.resend)
        for camera in self.cameras:
            self.switch_on(camera)
        self.wait("the first whole frame set", lambda: self.witness.whole_since(0.0), START_S)

    def _start_server(self, resend: bool) -> Witness:
        values = {
            "resend": str(resend).lower(),
            "rig_file": self.folder / "rig.yaml",
            "voxel_size_m": VOXEL_M,
            "backend": "cpu",
            "thin_out": "false",
            "queue_depth": 1000,
            "tolerance_s": 0.5 / self.hz,
            "autostart": "true",
        }
        parameters = [word for key, value in values.items() for word in ("-p", f"{key}:={value}")]
        hull = [sys.executable, "-m", "hull_server.hull_node", "--ros-args", *parameters]
        host, log = self.world.hosts[SERVER], (self.folder / "hull_server.log").open("w")
        host.start(hull, self.environment, stdout=log, stderr=log)
        listener = [sys.executable, str(BENCH.parent / "tests/support/hosts_listener.py"), *self.cameras]
        return Witness(host.start(listener, self.environment, stdout=subprocess.PIPE, text=True))

    def switch_off(self, camera: str) -> None:
        """Kill a camera's sender."""
        self.world.hosts[camera].kill()

    def switch_on(self, camera: str, ahead_s: float = 0.0) -> float:
        """Start a camera's sender; returns when it had begun to send."""
        sender(self, camera, self.hz, "--clock", str(ahead_s))
        return time.monotonic()

    def measure(self, name: str, seconds: float | None = None, **times: float | None) -> Row:
        """Let some time pass, and return its figures."""
        begin_ns, seconds = time.time_ns(), seconds or self.seconds
        watched = [self.world.hosts[name].processes[0].pid for name in (SERVER, self.cameras[0])]
        before_s = [used_s(pid) for pid in watched]
        time.sleep(seconds)
        used = [(used_s(pid) - before) / seconds for pid, before in zip(watched, before_s, strict=True)]
        time.sleep(WAY_S)
        figures = {"hull_cpu": used[0], "sender_cpu": used[1], **times}
        return self.witness.figures(name, begin_ns, seconds, self.hz, **figures)

    def figures(self, name: str, begin_ns: int, begin_s: float, seconds: float, **times: float | None) -> Row:
        """As of the real clients' drill."""
        return self.witness.figures(name, begin_ns, seconds, self.hz, **times)


def used_s(pid: int) -> float:
    """Processor time of a process so far, s."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


CONDITIONS: dict[str, Trial] = {
    "plain": steady(Condition()),
    "delay 5 ms": steady(Condition(delay_ms=5.0)),
    "delay 20 ms": steady(Condition(delay_ms=20.0)),
    "jitter 0 to 15 ms": steady(Condition(jitter_ms=15.0)),
    "loss 1 %": steady(Condition(loss=0.01)),
    "loss 5 %": steady(Condition(loss=0.05)),
    "duplicates 5 %": steady(Condition(duplicate=0.05)),
    "1 Gbit/s": steady(Condition(rate_mbit=1000.0), everywhere=True),
    "100 Mbit/s": steady(Condition(rate_mbit=100.0), everywhere=True),
    "10 Mbit/s": steady(Condition(rate_mbit=10.0), everywhere=True),
    "cable cut for 3 s": cut,
    "a host vanishes": vanish,
    "clock 5 ms ahead": apart(0.005),
    "clock 2 s ahead": apart(2.0),
    "two ROS domains": other_domain,
    "one host's MTU 9000": jumbo,
}


def chosen(arguments: Any, conditions: Iterable[str]) -> list[str]:
    """Return the conditions that were asked for."""
    asked = arguments.only or (QUICK if arguments.quick else [""])
    return [name for name in conditions if any(name.startswith(word) for word in asked)]


@contextmanager
def running(arguments: Any) -> Iterator[Drill]:
    """The drill's hosts, all of them sending; nothing is left of them afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="sagoma_hosts_"))
    clip = studio_clip("walk", CLIP_S, arguments.cameras)
    save_rig(clip.rig, folder / "rig.yaml")
    size = write_clip(folder / "clip", clip.rig, [clip.masks(frame) for frame in range(len(clip))])
    names = [SERVER, *clip.rig.names]
    try:
        with World(names, seed=arguments.seed, multicast=not arguments.peers) as world:
            print(f"{len(names)} hosts, silhouettes of {size} bytes (median)", flush=True)
            yield Drill(world, folder, arguments)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main(arguments: Any) -> dict[str, Any]:
    """Run the conditions one after the other."""
    if arguments.clients:
        return hosts_clients.main(arguments, chosen(arguments, hosts_clients.CONDITIONS))
    table = Table(
        "condition:<28 | complete:>9.1% | formed:>8.1% | p50 ms:>8.1f | p95 ms:>8.1f | spread ms:>9.1f "
        "| noticed s:>9.1f | recovered s:>11.1f | hull cpu:>8.2f | sender cpu:>10.2f"
    )
    rows: list[Row] = []
    with running(arguments) as drill:
        for name in chosen(arguments, CONDITIONS):
            for row in CONDITIONS[name](drill, name):
                rows.append(row)
                table.row(*asdict(row).values())
    return {"rows": [asdict(row) for row in rows]}


def outside(words: Sequence[str]) -> int:
    """Run this program in namespaces of its own."""
    if reason := why_not():
        print(reason)
        return 2
    with inside([__file__, *words]) as process:
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
    return process.returncode


def arguments_of(words: Sequence[str]) -> Any:
    """Parse the command line."""
    given = parser(__doc__, quick=f"{', '.join(QUICK)} alone, short")
    given.add_argument("--cameras", type=int, default=CAMERAS, help="camera hosts (default: %(default)s)")
    given.add_argument("--clients", action="store_true", help="real camera clients and the whole server")
    given.add_argument(
        "--hz", type=float, help=f"exposures a second (default: {HZ:g}; with --clients {hosts_clients.CLIENT_HZ:g})"
    )
    given.add_argument("--seconds", type=float, help="of every condition (default: 8; with --quick 4)")
    given.add_argument("--only", action="append", default=[], metavar="NAME", help="conditions that begin so")
    given.add_argument("--profile", default=str(PROFILE), metavar="XML", help=f"of Fast DDS, or '{NO_PROFILE}'")
    given.add_argument("--peers", action="store_true", help="a network without multicast, addresses given")
    given.add_argument("--resend", action="store_true", help="the hull server asks for silhouettes that got lost")
    given.add_argument("--seed", type=int, default=0, help="of the packets' fates")
    arguments = given.parse_args(words)
    arguments.seconds = arguments.seconds or (QUICK_S if arguments.quick else SECONDS)
    arguments.hz = arguments.hz or (hosts_clients.CLIENT_HZ if arguments.clients else HZ)
    return arguments


if __name__ == "__main__":
    parsed = arguments_of(sys.argv[1:])
    if not is_inside():
        raise SystemExit(outside(sys.argv[1:]))
    execute(lambda: finish(main(parsed)))
