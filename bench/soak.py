"""Hours of the demo's studio with faults at random: what each process holds, what becomes of every exposure.

    python bench/soak.py --hours 2 --output OUT       # four simulated GigE cameras, their clients, the server
    python bench/soak.py --quick                      # a minute and a half, a fault every eight seconds
    python bench/soak.py --report OUT                 # tables and OUT/soak.png from what was written, at any time

The graph is that of `sagoma demo`: simulated cameras in one process, real clients through Aravis, the server, started
and restarted by the supervisor of `sagoma up`. A person moves to and fro before them, slowly, so that a low rate
suffices to follow. Each fault is drawn with --seed (bench/soak_faults.py), lasts some seconds, and is over when a whole
frame set and a joint state of later exposures have come. Half of the cameras are never killed, and the server only in
the first round of faults: their memory is followed without a break from then on.

OUT holds, written row by row so that a kill loses nothing: exposures.csv (a row an exposure), processes.csv (memory,
threads, file handles, processor time), counters.csv (the nodes' own), faults.csv, events.csv (ends and returns of
processes), soak.json (settings). The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from report import execute, finish, parser

import numpy as np
from soak_faults import Fault, FaultInjector, random_faults
from soak_probe import COUNTERS, SETTLED_S, ExposureProbe, Rows, resources
from soak_report import report_on

from capture_rig.errors import InputError
from capture_rig.stop_signals import StopOnSignal
from sagoma_bringup.launch_arguments import RESTART_DELAY_S
from sagoma_tools.evaluation.live_inputs import StudioInput
from sagoma_tools.evaluation.live_run import start_settings
from sagoma_tools.graph.supervisor import ProcessEvent, Supervisor
from stick_figure.body import Body
from virtual_studio.motions.catalogue import Motion, tour
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

CAMERAS, HZ, SEED = 4, 5.0, 17
HOURS, QUICK_S = 2.0, 90.0
SAMPLE_S, QUICK_SAMPLE_S = 10.0, 2.0
CALM_S, QUICK_CALM_S = (20.0, 80.0), (6.0, 10.0)  # between a recovery and the next fault
FIRST_FAULT_S = 60.0  # of a long soak, after the start
GIVEN_UP_S = 120.0  # a fault that has not been recovered from
TICK_S = 0.2
STATURE_M, ACTED_S, ACTED_HZ = 1.75, 6.0, 20.0
SLOWER = 2.0  # the person moves at half speed: at HZ it seems to move as before cameras of twice the rate

Note = Callable[[ProcessEvent], None]


@dataclass(frozen=True)
class Plan:
    """How long a soak takes and how often things happen in it, s."""

    seconds: float
    sample_s: float
    calm_s: tuple[float, float]
    first_fault_s: float

    @classmethod
    def of(cls, hours: float, quick: bool) -> Plan:
        if quick:
            return cls(QUICK_S, QUICK_SAMPLE_S, QUICK_CALM_S, QUICK_CALM_S[0])
        return cls(3600.0 * hours, SAMPLE_S, CALM_S, min(FIRST_FAULT_S, 360.0 * hours))


@dataclass(frozen=True, eq=False)
class Stage:
    """What a soak runs on: the graph, what beside it is measured (label -> pid), and the faults that it suffers."""

    supervisor: Supervisor
    others: Mapping[str, int]
    injector: FaultInjector
    faults: Iterator[Fault]


class Soak:
    """One soak under way: samples, injects faults, writes rows; see the module for the files."""

    def __init__(self, stage: Stage, out: Path, hz: float) -> None:
        self._stage, self._supervisor, self._hz = stage, stage.supervisor, hz
        supervisor = stage.supervisor
        self._probe = ExposureProbe(supervisor.node, hz)
        self._exposures = Rows(out / "exposures.csv", "number unix_s cameras missing age_ms tracked")
        self._processes = Rows(
            out / "processes.csv", "unix_s process pid rss_mib uss_mib anon_mib shm_mib threads handles cpu_s"
        )
        self._counters = Rows(out / "counters.csv", "unix_s node pid " + " ".join(COUNTERS))
        self._faults = Rows(out / "faults.csv", "kind target strength begun_s ended_s recovered_s")
        self._next_number: int | None = None

    def run(self, plan: Plan, seed: int, stop: threading.Event) -> None:
        """Sample and inject until the plan's end or ``stop``; the last fault is undone."""
        began_s = time.time()
        end_s, sample_s, fault_s = began_s + plan.seconds, began_s, began_s + plan.first_fault_s
        calm = random_calm(seed, plan.calm_s)
        while time.time() < end_s and not stop.is_set():
            if time.time() >= sample_s:
                self.sample()
                sample_s += plan.sample_s
            if time.time() >= fault_s:
                self.suffer(next(self._stage.faults), plan.sample_s, stop)
                fault_s, sample_s = time.time() + next(calm), max(sample_s, time.time())
            stop.wait(TICK_S)
        stop.wait(SETTLED_S)
        self.sample()

    def suffer(self, fault: Fault, sample_every_s: float, stop: threading.Event) -> None:
        """Begin a fault, undo it after its time, wait until all is whole again, and write its row."""
        begun_s = time.time()
        self._stage.injector.begin(fault)
        stop.wait(fault.seconds)
        self._stage.injector.undo(fault)
        ended_s = sample_s = time.time()
        recovered_s = float("nan")
        while time.time() < ended_s + GIVEN_UP_S and not stop.is_set():
            if self._probe.whole_since(round(ended_s * 1e9)):
                recovered_s = time.time()
                break
            if time.time() >= sample_s:
                self.sample()
                sample_s += sample_every_s
            stop.wait(TICK_S)
        times = (f"{instant_s:.2f}" for instant_s in (begun_s, ended_s, recovered_s))
        self._faults.add(fault.kind, fault.target, fault.strength, *times)

    def sample(self) -> None:
        """Write what is known now: old exposures, resources, counters."""
        now_s = time.time()
        self._write_exposures(round((now_s - SETTLED_S) * 1e9))
        pids = self._supervisor.processes.pids()
        labels = {process.label: pids[process.nodes[0].full_name] for process in self._supervisor.processes.specs}
        labels |= {**self._stage.others, "soak": os.getpid()}
        for label, held in resources(labels).items():
            self._processes.add(f"{now_s:.1f}", label, *held)
        for name, pid in pids.items():
            report = self._supervisor.diagnostics.report(name)
            values = {} if report is None else report.values
            self._counters.add(f"{now_s:.1f}", name, pid, *(values.get(key, "") for key in COUNTERS))

    def _write_exposures(self, before_ns: int) -> None:
        """Write every exposure up to an instant, those too of which nothing has come."""
        last = self._probe.number_at(before_ns)
        seen = self._probe.take(before_ns)
        first = last if self._next_number is None else self._next_number
        for number in range(first, last):
            exposure = seen.get(number)
            row = (0, 0, "", 0) if exposure is None else exposure.row()
            self._exposures.add(number, f"{number / self._hz:.3f}", *row)
        self._next_number = last


def random_calm(seed: int, between_s: tuple[float, float]) -> Iterator[float]:
    """Draw the pauses between faults, s."""
    draw = random.Random(seed)
    while True:
        yield draw.uniform(*between_s)


def to_and_fro(body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
    """Acts the built-in tour and then the same backwards, so that it can be shown in a loop without a leap."""
    there = tour(body, ACTED_S, ACTED_HZ, build)
    return Motion((*there.poses, *there.poses[::-1]), np.concatenate([there.angles, there.angles[::-1]]), fps)


@contextmanager
def studio_stage(args: argparse.Namespace, stop: threading.Event, note: Note) -> Iterator[Stage]:
    """The studio and its graph: backgrounds learned, a person moving, everything restarted when it dies."""
    out, session = args.output, args.output / "session"
    rig, body = ring(args.cameras - 1, True), Body.from_stature(STATURE_M)
    write_session(session, rig, body, to_and_fro, ACTED_HZ / SLOWER, 2 * ACTED_S * SLOWER)
    with StudioInput(session, out / "studio", args.hz, cancel=stop) as studio:
        graph = studio.graph(start_settings(studio.session, "auto"))
        with Supervisor(graph, out / "logs", cancel=stop, on_event=note, restart_delay_s=RESTART_DELAY_S) as supervisor:
            supervisor.configure(tolerate_cameras=False)
            supervisor.activate(tolerate_cameras=False)
            studio.prepare(supervisor, stop)
            studio.studio.ask("play", loop=True)
            names = list(studio.session.rig.names)
            faults = random_faults(args.seed, names, names[: len(names) // 2])
            yield Stage(supervisor, {"studio": studio.studio.pid}, FaultInjector(studio.studio, supervisor), faults)


def main() -> None:
    """Soak, then report; the report of an earlier soak with --report."""
    given = parser(__doc__, quick=f"{QUICK_S:g} s")
    given.add_argument("--hours", type=float, default=HOURS)
    given.add_argument("--output", type=Path, default=Path("output/soak"), help="a new folder (default: output/soak)")
    given.add_argument("--cameras", type=int, default=CAMERAS)
    given.add_argument("--hz", type=float, default=HZ, help=f"of the cameras (default: {HZ:g})")
    given.add_argument("--seed", type=int, default=SEED, help="of the faults")
    given.add_argument("--report", type=Path, metavar="OUT", help="only report on what is in this folder")
    args = given.parse_args()
    if args.report is None:
        soak(args)
    finish(report_on(args.report or args.output))


def soak(args: argparse.Namespace) -> None:
    """Run the graph, and write what is seen into the output folder."""
    out, plan = args.output, Plan.of(args.hours, args.quick)
    if (out / "exposures.csv").exists():
        raise InputError("holds a soak already", where=str(out), remedy="Name another folder.")
    out.mkdir(parents=True, exist_ok=True)
    settings = {"seconds": plan.seconds, "cameras": args.cameras, "hz": args.hz, "seed": args.seed}
    (out / "soak.json").write_text(json.dumps(settings))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    events = Rows(out / "events.csv", "unix_s event")

    def note(event: ProcessEvent) -> None:
        events.add(f"{time.time():.2f}", event.text)

    with StopOnSignal() as stop, studio_stage(args, stop, note) as stage:
        Soak(stage, out, args.hz).run(plan, args.seed, stop)


if __name__ == "__main__":
    execute(main)
