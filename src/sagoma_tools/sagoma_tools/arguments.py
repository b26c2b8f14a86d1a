"""What several subcommands share: the graph's arguments, parameter settings, the run folder."""

from __future__ import annotations

import argparse
import datetime
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from capture_rig.errors import InputError
from capture_rig.session import load_session
from capture_rig.settings import PLAYING_SPEED, number
from capture_rig.yaml_file import parse_value
from sagoma_bringup.graph import ALL_CAMERAS, ONE_PROCESS, SERVER_LAYOUTS, NodeSpec, Role, apply_settings, build_graph
from sagoma_bringup.launch_arguments import AUTO_START, STARTS, start_settings

from .takes.folder import TAKES, TakesFolder

# of several commands
NODES = number("nodes", 1, 1000, whole=True)


def add_graph_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that describe a graph; :func:`graph_from` reads them."""
    parser.add_argument("session", nargs="?", help="folder of footage: rig.yaml, camNN.mp4, camNN_background.png|mp4")
    parser.add_argument("--rig", help="rig YAML of live cameras (instead of a session)")
    help_cameras = "folder of camera parameter files, or one such file; without --rig the camera clients run alone"
    parser.add_argument("--cameras", help=help_cameras)
    parser.add_argument("--only", metavar="PART", help="run only this part: server, cameras, or one camera's name")
    parser.add_argument(
        "--rate", type=PLAYING_SPEED, default=1.0, help="playing speed of footage; 0: as fast as the graph can"
    )
    parser.add_argument("--loop", action="store_true", help="play footage again and again")
    help_start_at = "when footage begins, the same on every machine that plays a part of it: 14:30:05, or with a date"
    parser.add_argument("--start-at", metavar="TIME", help=f"{help_start_at}; this machine's time zone, or Z for UTC")
    parser.add_argument("--body", help="body YAML for the trackers")
    add_start_argument(parser)
    add_settings_argument(parser)


def add_start_argument(parser: argparse.ArgumentParser) -> None:
    """--start: where the first pose comes from; `start_settings` of sagoma_bringup reads it."""
    text = (
        "first pose: the session's reference where it was measured on its footage, else a T-pose or whoever walks in "
    )
    text += "(auto); a T-pose alone; the session's reference or truth"
    parser.add_argument("--start", choices=STARTS, default=AUTO_START, help=text)


def add_settings_argument(parser: argparse.ArgumentParser) -> None:
    """--set NODE.PARAM=VALUE, any number of times; :func:`parse_settings` reads it."""
    text = "set a parameter, e.g. hull_server.voxel_size_m=0.015 or cameras.publish_preview=true"
    parser.add_argument("--set", action="append", default=[], metavar="NODE.PARAM=VALUE", dest="settings", help=text)


def add_server_argument(parser: argparse.ArgumentParser) -> None:
    """--server LAYOUT: whether the server's nodes share a process."""
    text = "the server's hull, ICP and EKF nodes in one process (default), or in one each"
    parser.add_argument("--server", choices=SERVER_LAYOUTS, default=ONE_PROCESS, help=text)


def graph_from(args: argparse.Namespace) -> list[NodeSpec]:
    """Return the graph that the arguments describe."""
    session = None if args.session is None else load_session(args.session)
    start_at_ns = None if args.start_at is None else start_instant_ns(args.start_at, time.time_ns())
    if session is None and start_at_ns is not None:
        remedy = "Leave it out: live cameras need none."
        raise InputError("only footage has a beginning", where="--start-at", remedy=remedy)
    graph = build_graph(
        session=args.session,
        rig=args.rig,
        cameras=args.cameras,
        only=args.only,
        rate=args.rate,
        loop=args.loop,
        body=args.body,
    )
    if session is not None:
        graph = in_step(graph, len(session.rig.names), start_at_ns, args.rate)
    if any(node.label == "icp_tracker" for node in graph):
        graph = apply_settings(graph, start_settings(session, args.start))
    return apply_settings(graph, parse_settings(args.settings))


def parse_settings(texts: list[str]) -> dict[str, Any]:
    """NODE.PARAM=VALUE texts as a mapping; values are read as YAML (15, 0.5, true, [1, 2], text)."""
    settings = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"'{text}' has no value", where="--set", remedy="Write NODE.PARAM=VALUE.")
        settings[key] = parse_value(value, f"--set {key}", "Write NODE.PARAM=VALUE; a text with : [ ] { } in quotes.")
    return settings


def next_steps(take: str | Path) -> str:
    """Say what one does with a recording."""
    return f"look at it: sagoma view {take}    in other programs: sagoma export {take}"


def new_run_folder(given: str | None, kind: str) -> Path:
    """Return the folder for logs and parameter files: as given, or output/KIND-DATE-TIME."""
    return Path(given) if given else Path("output") / f"{kind}-{time.strftime('%Y%m%d-%H%M%S')}"


def add_takes_argument(parser: argparse.ArgumentParser) -> None:
    """--takes FOLDER, in which takes are found by name; :func:`chosen_take` reads it."""
    parser.add_argument("--takes", default=TAKES, metavar="FOLDER", help=f"folder of the takes (default: {TAKES})")


def chosen_take(given: str, folder: str) -> tuple[TakesFolder, str]:
    """Return the folder and name of a take that is given by its name in the folder of takes, or by its path."""
    path = Path(given)
    if not (path.name == given and (Path(folder) / path).exists()) and path.exists():
        return TakesFolder(path.resolve().parent), path.resolve().name
    return TakesFolder(Path(folder)), given


def bag_of(given: str, folder: str) -> Path:
    """Return the bag of a take that is given by its name, or by its path: a folder, or a single file."""
    path = Path(given)
    named = Path(folder) / path
    return named if path.name == given and not path.exists() and named.exists() else path


# the instant at which footage begins ----------------------------------------------------------------------------------


FARTHEST_S = 3600.0  # the camera client refuses stamps further ahead; footage that began long ago is over
EXAMPLE = "Write it as 14:30:05, 2026-03-01T14:30:05, or with a Z for UTC."


def start_instant_ns(text: str, now_ns: int) -> int:
    """Return a time of day (today's, of this machine's time zone) or a date and time as ns since 1970.

    Raises InputError for what is neither, and for more than an hour from now, which is a slip.
    """
    now = datetime.datetime.fromtimestamp(now_ns * 1e-9).astimezone()
    if ":" not in text:  # 14.30 would be read as 14 hours and three tenths
        raise InputError(f"'{text}' is no time", where="--start-at", remedy=EXAMPLE)
    try:
        time_of_day = datetime.time.fromisoformat(text)
        instant = datetime.datetime.combine(now.astimezone(time_of_day.tzinfo).date(), time_of_day)
    except ValueError:
        try:
            instant = datetime.datetime.fromisoformat(text)
        except ValueError:
            raise InputError(f"'{text}' is no time", where="--start-at", remedy=EXAMPLE) from None
    ahead_s = (instant.astimezone() - now).total_seconds()
    if abs(ahead_s) > FARTHEST_S:
        side = "ahead" if ahead_s > 0 else "ago"
        what = f"{text} is {datetime.timedelta(seconds=round(abs(ahead_s)))} {side}: it is {now:%H:%M:%S %Z} here"
        raise InputError(what, where="--start-at", remedy="Give a moment within the hour, the same on every machine.")
    return round(instant.astimezone().timestamp() * 1e9)


def in_step(graph: Sequence[NodeSpec], cameras: int, start_at_ns: int | None, rate: float) -> list[NodeSpec]:
    """Return the part of a session's graph that runs here, its footage beginning with the other machines'.

    cameras : of the whole session. Raises InputError for a part of several cameras without a common beginning.
    """
    here = [node.label for node in graph if node.role is Role.CAMERA]
    if start_at_ns is None:
        if 0 < len(here) < cameras:
            what = f"of {cameras} cameras only {', '.join(here)} plays here, and its frames would not meet the others'"
            remedy = "Give every machine the same moment to begin, a minute from now: --start-at 14:30:05."
            raise InputError(what, where="--only", remedy=remedy)
        return list(graph)
    settings: dict[str, Any] = {"epoch_ns": start_at_ns}
    if rate > 0:
        settings |= {"keep_up": True, "wait_for_cameras": False}
    else:
        settings["wait_for_cameras"] = True  # nobody begins before all are there
    prefix = f"{ALL_CAMERAS}.footage."
    return apply_settings(graph, {f"{prefix}{key}": value for key, value in settings.items()} if here else {})
