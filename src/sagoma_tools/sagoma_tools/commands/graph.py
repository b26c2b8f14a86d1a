"""``sagoma up | start | suspend | stop | view | studio``: the node graph, its page, and simulated cameras to run it on.

``up`` starts the nodes as processes of its own. ``start``, ``suspend`` and ``stop`` change the lifecycle state of nodes
that run already, on this machine or another.
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path

from rich.console import Console
from rich.live import Live

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.settings import SECONDS, number
from capture_rig.stop_signals import StopOnSignal
from sagoma_bringup.launch_arguments import RESTART_DELAY_S
from virtual_studio.gige import __main__ as studio

from ..arguments import (
    NODES,
    add_graph_arguments,
    add_server_argument,
    add_takes_argument,
    bag_of,
    graph_from,
    new_run_folder,
    next_steps,
)
from ..console import CommandConsole, doing, until_stopped
from ..graph import ROUND_S
from ..graph.lifecycle_client import LifecycleClient, LifecycleState
from ..graph.ros_link import RosLink, add_namespace_argument, find_nodes, namespace_argument, our_nodes
from ..graph.supervisor import GraphError, ProcessEvent, Supervisor
from ..recording.recorder import GraphRecorder
from ..recording.writer import require_new
from ..takes.folder import TakesFolder
from ..takes.measure import finish_take
from ..view.page import Page
from ..view.server import ANY_HOST, PORT, Guard

HOST = "127.0.0.1"
# verb -> (the state it leads to, help)
VERBS = {
    "start": (LifecycleState.ACTIVE, "configure and activate every node of the running graph"),
    "suspend": (LifecycleState.INACTIVE, "deactivate every node of the running graph; start goes on from there"),
    "stop": (LifecycleState.UNCONFIGURED, "deactivate and clean up every node of the running graph; processes stay"),
}


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the six subcommands."""
    parser = subparsers.add_parser("up", help="run the graph on a session of footage or on a rig of cameras")
    add_graph_arguments(parser)
    add_server_argument(parser)
    add_page_arguments(parser, "--view")
    parser.add_argument("--record", metavar="BAG", help="record all topics into this bag")
    parser.add_argument("--seconds", type=SECONDS, help="stop after so long (default: run until Ctrl-C)")
    parser.add_argument("--run-folder", help="where logs and parameter files go (default: output/up-DATE-TIME)")
    help_text = "leave processes that crash dead (default: start them again)"
    parser.add_argument("--no-restart", dest="restart", action="store_false", help=help_text)
    parser.set_defaults(run=up)
    for verb, (goal, help_text) in VERBS.items():
        parser = subparsers.add_parser(verb, help=help_text)
        parser.add_argument("--expect", type=NODES, default=1, help="wait until so many sagoma nodes are found")
        parser.add_argument("--wait", type=SECONDS, default=5.0, help="... but no longer than this, in seconds")
        parser.add_argument("--timeout", type=SECONDS, help="seconds to wait for each answer")
        add_namespace_argument(parser)
        parser.set_defaults(run=change_state, goal=goal)
    _add_view(subparsers)
    parser = subparsers.add_parser("studio", help="serve simulated GigE Vision cameras, or talk to those that run")
    studio.add_arguments(parser)
    parser.set_defaults(run=studio.run)


def up(args: argparse.Namespace) -> int:
    """Start, configure, activate, watch, stop; 0 when every node ended cleanly."""
    graph = graph_from(args)
    if args.record:
        require_new(args.record)
    console, folder = CommandConsole(), new_run_folder(args.run_folder, "up")
    console.print(f"starting {len(graph)} nodes; logs in {folder}")

    def log_event(event: ProcessEvent) -> None:
        console.print(event.text, style="green" if event.back else "red")
        if event.log_tail:
            console.print(event.log_tail)

    restart = RESTART_DELAY_S if args.restart else None

    def report_failure(error: InputError) -> None:
        console.print(f"{error} The capture goes on.", style="red")

    with (
        StopOnSignal() as stop,
        Supervisor(graph, folder, args.server, cancel=stop, on_event=log_event, restart_delay_s=restart) as supervisor,
        page_of(args) if args.view else nullcontext(),
    ):
        recorder = bring_up(supervisor, args.record, stop, report_failure)
        until_stopped()
        if not stop.is_set():
            active = sum(state == LifecycleState.ACTIVE for state in supervisor.states().values())
            console.print(f"{active} of {len(graph)} nodes are active")
        watch(supervisor, console, stop, args.seconds)
        doing("stopping the nodes")
        supervisor.suspend()
        if recorder is not None:
            counts = recorder.close()
            finish_take(Path(args.record))
            console.print(f"recorded {sum(counts.values())} messages on {len(counts)} topics in {args.record}")
            console.print(next_steps(args.record))
        supervisor.stop()
    incomplete = recorder is not None and recorder.failure is not None
    return print_exit_statuses(console, supervisor) or int(incomplete)


def bring_up(
    supervisor: Supervisor, bag: str | None, stop: threading.Event, on_failure: Callable[[InputError], object]
) -> GraphRecorder | None:
    """Configure, begin to record, activate. Raises GraphError, unless the user stopped it meanwhile.

    on_failure : called when the recording ends because of the disk.
    """
    recorder = None
    doing(f"starting {len(supervisor.graph)} nodes")
    try:
        supervisor.configure()
        if bag:
            recorder = GraphRecorder(supervisor.graph, bag, on_failure=on_failure)
            recorder.wait_for_graph()
        supervisor.activate()
    except GraphError:
        if not stop.is_set():
            raise
    return recorder


def watch(supervisor: Supervisor, console: Console, stop: threading.Event, seconds: float | None) -> None:
    """Show one line a node, once a second, until ``stop`` is set or the time is over; into a file, only the last."""
    names = {spec.full_name: spec.label for spec in supervisor.graph}
    if not console.is_terminal:
        stop.wait(seconds)
        console.print(supervisor.diagnostics.table(names, supervisor.states()))
        return
    end_s = None if seconds is None else time.monotonic() + seconds
    with Live(console=console, auto_refresh=False) as live:
        while not stop.wait(ROUND_S) and (end_s is None or time.monotonic() < end_s):
            live.update(supervisor.diagnostics.table(names, supervisor.states()), refresh=True)


def print_exit_statuses(console: Console, supervisor: Supervisor) -> int:
    """Print which nodes did not answer or did not end cleanly; 1 when one did not end cleanly."""
    for failure in supervisor.stop_outcome.failures.values():
        console.print(failure, style="yellow")
    failed = [status for status in supervisor.exit_statuses if status.trouble]
    for status in failed:
        console.print(f"{status.name} {status.trouble} (status {status.returncode})", style="yellow")
    if not failed:
        console.print(f"all {len(supervisor.graph)} nodes stopped")
    return 1 if failed else 0


def change_state(args: argparse.Namespace) -> int:
    """Bring every sagoma node to the verb's state; 1 when one of them refused or did not answer."""
    with RosLink("sagoma_control", namespace=namespace_argument(args)) as link:
        doing("looking for nodes")
        found = find_nodes(lambda: our_nodes(link.node), "nodes of ours", args.expect, args.wait)
        doing(f"bringing {len(found)} nodes to {args.goal}")
        client = LifecycleClient(link.node)
        outcome = client.bring(found, args.goal, args.timeout)
        states = client.states(found)
    for name in found:
        print(f"{name}: {states[name] or 'did not answer'}")
    for failure in outcome.failures.values():
        print(f"failed: {failure}")
    return 1 if outcome.failures else 0


# the page -------------------------------------------------------------------------------------------------------------


def _add_view(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("view", help="a page to see and run the graph by, or to look at a take")
    parser.add_argument("take", nargs="?", help="bag to play on the page (default: the live graph)")
    parser.add_argument("--rig", help="rig YAML, whose cameras are drawn")
    add_page_arguments(parser)
    add_namespace_argument(parser)
    parser.add_argument("--seconds", type=SECONDS, help="close after so long (default: run until Ctrl-C)")
    parser.set_defaults(run=view)


def add_page_arguments(parser: argparse.ArgumentParser, switch: str = "") -> None:
    """The arguments of a page; :func:`page_of` reads them."""
    if switch:
        parser.add_argument(switch, action="store_true", help="serve the live page, too (docs/how-to/takes.md)")
    help_host = "address to listen on; others than this machine then need the token that is printed (default: this one)"
    parser.add_argument("--host", default=HOST, help=help_host)
    port = number("", 0, 65535, whole=True)
    parser.add_argument("--port", type=port, help=f"0: any free one (default: {PORT}, or the next free one)")
    add_takes_argument(parser)


def view(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    with StopOnSignal() as stop, page_of(args):
        until_stopped()
        stop.wait(args.seconds)
    return 0


@contextmanager
def page_of(args: argparse.Namespace) -> Iterator[Page]:
    """Serve the page that the arguments describe: of a take alone, or of the graph."""
    guard = Guard.of(args.host)
    if (take := getattr(args, "take", None)) is not None:
        folder = bag_of(take, args.takes).resolve()
        with closing(Page(guard, args.port, TakesFolder(folder.parent))) as page:
            page.show_take(folder)
            announce(guard, page.port)
            yield page
        return
    session = getattr(args, "session", None)  # that `sagoma up` plays
    rig_file = args.rig or (Path(session) / "rig.yaml" if session else None)
    rig = None if rig_file is None else load_rig(rig_file)
    with (
        RosLink("sagoma_view", namespace=namespace_argument(args)) as link,
        closing(Page(guard, args.port, TakesFolder(Path(args.takes)), link, rig)) as page,
    ):
        announce(guard, page.port)
        yield page


def announce(guard: Guard, port: int) -> None:
    """Print the address to open."""
    host = "MACHINE" if guard.host in ANY_HOST else guard.host
    host = f"[{host}]" if ":" in host else host
    print(f"the page: http://{host}:{port}/" + (f"?token={guard.token}" if guard.token else ""), flush=True)
