"""What several subcommands share: stopping on signals, the graph's arguments, the run folder."""

from __future__ import annotations

import argparse
import signal
import threading
import time
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

import yaml

from capture_rig.errors import InputError
from sagoma_bringup.graph import NodeSpec, build_graph

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopOnSignal:
    """An event that Ctrl-C, SIGTERM or a closed terminal sets, instead of tearing the program down in mid-work."""

    def __init__(self) -> None:
        self.event = threading.Event()
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> threading.Event:
        self._previous = {number: signal.signal(number, self._take) for number in STOP_SIGNALS}
        return self.event

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: FrameType | None) -> None:
        self.event.set()


def add_graph_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that describe a graph; :func:`graph_from` reads them."""
    parser.add_argument("session", nargs="?", help="folder of footage: rig.yaml, camNN.mp4, camNN_background.png|mp4")
    parser.add_argument("--rig", help="rig YAML of live cameras (instead of a session)")
    parser.add_argument(
        "--cameras",
        help="folder with one parameter file a camera, or one such file; without --rig "
        "the camera clients run alone, as before a calibration",
    )
    parser.add_argument("--only", metavar="PART", help="run only this part: server, cameras, or one camera's name")
    parser.add_argument("--rate", type=float, default=1.0, help="playing speed of footage; 0: as fast as the graph can")
    parser.add_argument("--loop", action="store_true", help="play footage again and again")
    parser.add_argument("--body", help="body YAML for the trackers")
    add_settings_argument(parser)


def add_settings_argument(parser: argparse.ArgumentParser) -> None:
    """--set NODE.PARAM=VALUE, any number of times; :func:`parse_settings` reads it."""
    help_text = "set a parameter, e.g. hull_server.voxel_size_m=0.015 or cameras.publish_preview=true"
    parser.add_argument(
        "--set", action="append", default=[], metavar="NODE.PARAM=VALUE", dest="settings", help=help_text
    )


def graph_from(args: argparse.Namespace) -> list[NodeSpec]:
    """The graph that the arguments describe."""
    return build_graph(
        session=args.session,
        rig=args.rig,
        cameras=args.cameras,
        only=args.only,
        rate=args.rate,
        loop=args.loop,
        body=args.body,
        settings=parse_settings(args.settings),
    )


def parse_settings(texts: list[str]) -> dict[str, Any]:
    """NODE.PARAM=VALUE texts as a mapping; values are read as YAML (15, 0.5, true, [1, 2], text)."""
    settings = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"'{text}' has no value", where="--set", remedy="Write NODE.PARAM=VALUE.")
        settings[key] = yaml.safe_load(value)
    return settings


def new_run_folder(given: str | None, kind: str) -> Path:
    """The folder for logs and parameter files: as given, or output/KIND-DATE-TIME."""
    return Path(given) if given else Path("output") / f"{kind}-{time.strftime('%Y%m%d-%H%M%S')}"
