"""``sagoma view``: the live page of the graph, or of a recorded take, in any browser."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from capture_rig.number import SECONDS, number
from capture_rig.rig import Rig, load_rig
from capture_rig.stop_signals import StopOnSignal

from ..arguments import add_takes_argument, bag_of
from ..console import until_stopped
from ..graph.diagnostics_table import DiagnosticsTable
from ..graph.ros_link import RosLink, add_namespace_argument, namespace_argument
from ..takes.folder import TakesFolder
from ..view.control import Control
from ..view.guard import ANY_HOST, Guard
from ..view.jobs import Jobs
from ..view.live import LiveGraph
from ..view.page import Page
from ..view.server import PORT

HOST = "127.0.0.1"


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("view", help="a page to see and run the graph by, or to look at a take")
    parser.add_argument("take", nargs="?", help="bag to play on the page (default: the live graph)")
    parser.add_argument("--rig", help="rig YAML, whose cameras are drawn")
    add_page_arguments(parser)
    add_namespace_argument(parser)
    parser.add_argument("--seconds", type=SECONDS, help="close after so long (default: run until Ctrl-C)")
    parser.set_defaults(run=run)


def add_page_arguments(parser: argparse.ArgumentParser, switch: str = "") -> None:
    """The arguments of a page; :func:`page_of` reads them."""
    if switch:
        parser.add_argument(switch, action="store_true", help="serve the live page, too (docs/takes.md)")
    help_host = "address to listen on; others than this machine then need the token that is printed (default: this one)"
    parser.add_argument("--host", default=HOST, help=help_host)
    port = number("", 0, 65535, whole=True)
    parser.add_argument("--port", type=port, help=f"0: any free one (default: {PORT}, or the next free one)")
    parser.add_argument("--token", help="token of the page, with --host (default: a new one each time)")
    add_takes_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    with StopOnSignal() as stop, page_of(args):
        until_stopped()
        stop.wait(args.seconds)
    return 0


@contextmanager
def page_of(args: argparse.Namespace) -> Iterator[Page]:
    """Serve the page that the arguments describe: of a take alone, or of the graph."""
    take = getattr(args, "take", None)
    rig = _rig(args)
    guard = Guard.of(args.host, args.token)
    if take is not None:
        folder = bag_of(take, args.takes).resolve()
        page = Page(guard, args.port, TakesFolder(folder.parent))
        try:
            page.show_take(folder)
            announce(guard, page.port)
            yield page
        finally:
            page.close()
        return
    with RosLink("sagoma_view", namespace=namespace_argument(args)) as link:
        diagnostics = DiagnosticsTable(link.node)
        takes = TakesFolder(Path(args.takes))
        jobs = Jobs()
        control = Control(link, diagnostics, takes, jobs)
        page = Page(guard, args.port, takes, LiveGraph(link, diagnostics), control, jobs, rig)
        try:
            announce(guard, page.port)
            yield page
        finally:
            page.close()
            control.close()


def _rig(args: argparse.Namespace) -> Rig | None:
    """The rig that was named, or that of the session that `sagoma up` plays."""
    session = getattr(args, "session", None)
    if args.rig:
        return load_rig(args.rig)
    return load_rig(Path(session) / "rig.yaml") if session else None


def announce(guard: Guard, port: int) -> None:
    """Print the address to open."""
    host = "MACHINE" if guard.host in ANY_HOST else guard.host
    host = f"[{host}]" if ":" in host else host
    print(f"the page: http://{host}:{port}/" + (f"?token={guard.token}" if guard.token else ""), flush=True)
