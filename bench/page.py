"""What the live page costs: processor time of the page and of the graph, watched and unwatched, in turns of one run.

A graph plays a session over and over; the page runs in a process of its own, and a headless Chromium opens and leaves
it. Each turn measures, one after the other: nobody looks; somebody looks; somebody looks at the cameras' pictures, too.
The browser's own processor time is not counted. Frames a second are those that the browser draws, by its
requestAnimationFrame.

    python bench/page.py SESSION [--turns 3] [--seconds 10] [--rate 0.5]
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import psutil

from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import LOSSLESS, PREDICTION_TOPIC, message_class, type_of

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from browser import Browser, browser

PHASES = ("nobody looks", "watched", "with pictures")
SETTLE_S = 2.0  # from a change until it is measured: subscriptions are made and left once a second
COMMAND = [sys.executable, "-m", "sagoma_tools.cli"]


def main() -> None:
    """Measure, and print a table: percent of a core, ms of the graph a frame set, frames a second."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("session")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each phase")
    parser.add_argument("--rate", default="0.5", help="speed of the footage")
    args = parser.parse_args()
    with TemporaryDirectory() as folder, Started("up", args.session, "--loop", "--rate", args.rate, folder) as graph:
        view = [*COMMAND, "view", "--port", "0", "--takes", f"{folder}/takes", "--rig", f"{args.session}/rig.yaml"]
        page = subprocess.Popen(view, stdout=subprocess.PIPE, text=True)
        try:
            measure(args, graph.process, page)
        finally:
            page.terminate()
            page.wait()


class Started:
    """A graph of its own processes, ended with the block."""

    def __init__(self, *arguments: str) -> None:
        *command, folder = arguments
        self._command = [*COMMAND, *command, "--run-folder", f"{folder}/run"]

    def __enter__(self) -> Started:
        self.process = psutil.Popen(self._command, stdout=subprocess.DEVNULL)
        return self

    def __exit__(self, *error: object) -> None:
        self.process.terminate()
        self.process.wait()


def measure(args: argparse.Namespace, graph: psutil.Process, page: subprocess.Popen[str]) -> None:
    """Go through all turns."""
    assert page.stdout is not None
    address = next(match[1] for line in page.stdout if (match := re.search(r"the page: (http\S+)", line)))
    viewer = psutil.Process(page.pid)
    used: dict[str, list[dict[str, float]]] = defaultdict(list)
    with Sets() as sets:
        with browser(800, 600) as tab:  # until somebody is tracked
            tab.open(address)
            tab.wait_for_text("tracking: ")
        for _ in range(args.turns):
            time.sleep(SETTLE_S)
            used[PHASES[0]].append(measured(viewer, graph, sets, args.seconds, None))
            with browser(800, 600) as tab:  # a tab that goes elsewhere keeps its connection for a while
                for phase in PHASES[1:]:
                    enter(tab, address, phase)
                    used[phase].append(measured(viewer, graph, sets, args.seconds, tab))
    print(f"{'':16s}{'page, % of a core':>20s}{'graph, ms a set':>18s}{'sets/s':>9s}{'browser fps':>13s}")
    for phase, rows in used.items():
        page_percent, graph_ms, rate, fps = (
            median(row[key] for row in rows) for key in ("page", "graph", "rate", "fps")
        )
        print(f"{phase:16s}{page_percent:20.2f}{graph_ms:18.2f}{rate:9.1f}{fps:13.1f}")


def enter(tab: Browser, address: str, phase: str) -> None:
    """Open the page, or switch the cameras' pictures on."""
    if phase == PHASES[1]:
        tab.open(address)
        tab.wait_for_text("hull_server")
    else:
        tab.press("Cameras")
        tab.run("document.querySelectorAll('input[type=checkbox]')[1].click()")
        tab.wait_for("document.querySelectorAll('img').length > 0")
    time.sleep(SETTLE_S)


def measured(
    viewer: psutil.Process, graph: psutil.Process, sets: Sets, seconds: float, tab: Browser | None
) -> dict[str, float]:
    """Return the page's share of a core (%), the graph's processor time a set (ms), sets and frames a second."""
    before = cpu_s(viewer), tree_cpu_s(graph), sets.count, time.monotonic()
    fps = tab.frames_a_second(seconds) if tab is not None else float("nan")
    if tab is None:
        time.sleep(seconds)
    after = cpu_s(viewer), tree_cpu_s(graph), sets.count, time.monotonic()
    page_s, graph_s, count, wall_s = (b - a for a, b in zip(before, after, strict=True))
    return {"page": 100 * page_s / wall_s, "graph": 1e3 * graph_s / max(count, 1), "rate": count / wall_s, "fps": fps}


class Sets:
    """Counts the frame sets that the graph answers."""

    def __init__(self) -> None:
        self.count = 0
        self._link = RosLink("page_bench")
        kind = message_class(type_of(PREDICTION_TOPIC) or "")
        self._link.node.create_subscription(kind, PREDICTION_TOPIC, self._take, LOSSLESS, raw=True)

    def _take(self, data: bytes) -> None:
        self.count += 1

    def __enter__(self) -> Sets:
        return self

    def __exit__(self, *error: object) -> None:
        self._link.close()


def cpu_s(process: psutil.Process) -> float:
    """Return the processor time of a process so far."""
    times = process.cpu_times()
    return float(times.user + times.system)


def tree_cpu_s(process: psutil.Process) -> float:
    """Return the processor time of a process and of all that it started."""
    return sum(map(cpu_s, [process, *process.children(recursive=True)]))


if __name__ == "__main__":
    main()
