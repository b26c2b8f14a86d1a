"""What several subcommands share: the graph's arguments, parameter settings, the run folder."""

from __future__ import annotations

import argparse
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

EPOCH = ".footage.epoch_ns"  # the camera clients' parameter: when footage begins
# of several commands
NODES = number("nodes", 1, 1000, whole=True)


def add_graph_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that describe a graph; :func:`graph_from` reads them."""
    parser.add_argument("session", nargs="?", help="folder of footage: rig.yaml, camNN.mp4, camNN_background.png|mp4")
    parser.add_argument("--rig", help="rig YAML of live cameras (instead of a session)")
    help_cameras = "folder of camera parameter files, or one such file; without --rig the camera clients run alone"
    parser.add_argument("--cameras", help=help_cameras)
    parser.add_argument("--only", metavar="PART", help="run only this part: server, cameras, or one camera's name")
    help_rate = "playing speed of footage; 0: as fast as the graph can"
    parser.add_argument("--rate", type=PLAYING_SPEED, default=1.0, help=help_rate)
    parser.add_argument("--loop", action="store_true", help="play footage again and again")
    parser.add_argument("--body", help="body YAML for the trackers")
    add_start_argument(parser)
    add_settings_argument(parser)


def add_start_argument(parser: argparse.ArgumentParser) -> None:
    """--start: where the first pose comes from; `start_settings` of sagoma_bringup reads it."""
    text = "first pose: the session's reference where it was measured on its footage, else a T-pose or whoever walks "
    text += "in (auto); a T-pose alone; the session's reference or truth"
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
    session, settings = None if args.session is None else load_session(args.session), parse_settings(args.settings)
    graph = build_graph(
        session=args.session,
        rig=args.rig,
        cameras=args.cameras,
        only=args.only,
        rate=args.rate,
        loop=args.loop,
        body=args.body,
    )
    if session is not None and not any(key.endswith(EPOCH) for key in settings):
        require_all_cameras(graph, session.rig.names)
    if any(node.label == "icp_tracker" for node in graph):
        graph = apply_settings(graph, start_settings(session, args.start))
    return apply_settings(graph, settings)


def require_all_cameras(graph: Sequence[NodeSpec], names: Sequence[str]) -> None:
    """Raises InputError for a graph in which some of the cameras ``names`` play footage, and some do not."""
    here = [node.label for node in graph if node.role is Role.CAMERA]
    if 0 < len(here) < len(names):
        what = f"of {len(names)} cameras only {', '.join(here)} plays here, and its frames would not meet the others'"
        remedy = f"Give all machines one moment to begin, --set {ALL_CAMERAS}{EPOCH}=NANOSECONDS: docs/how-to/hosts.md."
        raise InputError(what, where="--only", remedy=remedy)


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
    """Return what to do next with a recording."""
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
    if path.name == given and ((Path(folder) / path).exists() or not path.exists()):
        return TakesFolder(Path(folder)), given
    return TakesFolder(path.resolve().parent), path.resolve().name


def bag_of(given: str, folder: str) -> Path:
    """Return the bag of a take that is given by its name, or by its path: a folder, or a single file."""
    takes, name = chosen_take(given, folder)
    return takes.path / name
