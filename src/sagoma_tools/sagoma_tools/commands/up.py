"""``sagoma up``: start the node graph as processes, show how it does, stop it on Ctrl-C."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from pathlib import Path

from rich.console import Console
from rich.live import Live

from sagoma_bringup.graph import NodeSpec

from ..arguments import StopOnSignal, add_graph_arguments, graph_from, new_run_folder
from ..graph.processes import Exit
from ..graph.supervisor import GraphError, Supervisor
from ..recording.recorder import GraphRecorder
from ..recording.writer import require_new

REFRESH_S = 0.5
LOG_WIDTH = 150


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("up", help="run the graph on a session of footage or on a rig of cameras")
    add_graph_arguments(parser)
    parser.add_argument("--record", metavar="BAG", help="record all topics into this bag")
    parser.add_argument("--seconds", type=float, help="stop after so long (default: run until Ctrl-C)")
    parser.add_argument("--run-folder", help="where logs and parameter files go (default: output/up-DATE-TIME)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Start, configure, activate, watch, stop; 0 when every node ended cleanly."""
    graph = graph_from(args)
    if args.record:
        require_new(args.record)
    console = Console() if sys.stdout.isatty() else Console(width=LOG_WIDTH)
    folder = new_run_folder(args.run_folder, "up")
    console.print(f"starting {len(graph)} nodes; logs in {folder}")

    def report_death(spec: NodeSpec, log_tail: str) -> None:
        console.print(f"{spec.full_name} died. The end of {folder / spec.label}.log:", style="red")
        console.print(log_tail, markup=False, highlight=False)

    with StopOnSignal() as stop, Supervisor(graph, folder, on_exit=report_death, cancel=stop) as supervisor:
        recorder = bring_up(supervisor, args.record, stop)
        watch(supervisor, console, stop, args.seconds)
        supervisor.suspend()
        if recorder is not None:
            print_counts(console, args.record, recorder.close())
        supervisor.stop()
    return print_farewells(console, supervisor)


def bring_up(supervisor: Supervisor, bag: str | None, stop: threading.Event) -> GraphRecorder | None:
    """Configure, begin to record, activate; a user who stops it meanwhile is no error."""
    recorder = None
    try:
        supervisor.configure()
        if bag:
            recorder = GraphRecorder(supervisor.graph, bag)
            recorder.wait_for_publishers()
        supervisor.activate()
    except GraphError:
        if not stop.is_set():
            raise
    return recorder


def watch(supervisor: Supervisor, console: Console, stop: threading.Event, seconds: float | None) -> None:
    """Show one line a node, twice a second, until ``stop`` is set or the time is over; into a file, only the last."""
    names = {spec.full_name: spec.label for spec in supervisor.graph}
    if not console.is_terminal:
        stop.wait(seconds)
        console.print(supervisor.diagnostics.table(names, supervisor.states()))
        return
    end_s = None if seconds is None else time.monotonic() + seconds
    with Live(console=console, auto_refresh=False) as live:
        while not stop.wait(REFRESH_S) and (end_s is None or time.monotonic() < end_s):
            live.update(supervisor.diagnostics.table(names, supervisor.states()), refresh=True)


def print_counts(console: Console, bag: str | Path, counts: dict[str, int]) -> None:
    """One line: what was recorded."""
    console.print(f"recorded {sum(counts.values())} messages on {len(counts)} topics in {bag}")


def print_farewells(console: Console, supervisor: Supervisor) -> int:
    """Say who did not answer or did not end cleanly; the exit status."""
    for answer in supervisor.stop_outcome.failures:
        console.print(str(answer), style="yellow")
    troubled = [ended for ended in supervisor.exit_statuses if ended.exit is not Exit.CLEAN]
    for ended in troubled:
        console.print(f"{ended.name} {ended.exit.value} (status {ended.returncode})", style="yellow")
    if not troubled:
        console.print(f"all {len(supervisor.exit_statuses)} nodes stopped")
    return 1 if troubled else 0
