"""Collects views of a board from a running camera, calibrates, saves, and offers the result to the camera client."""

from __future__ import annotations

import argparse
import threading
import time
from pathlib import Path

from rclpy.node import Node
from rich.console import Console
from rich.live import Live
from sensor_msgs.srv import SetCameraInfo

from capture_rig.errors import InputError
from capture_rig.verdict import REDO
from rig_calibration.boards.board import Board
from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from rig_calibration.intrinsics.model_choice import AUTO
from rig_calibration.intrinsics.result import Intrinsics
from rig_calibration.intrinsics.selection import ViewCollector
from rig_calibration.intrinsics.watching import BoardWatcher
from sagoma_ros.images import camera_info_message

from ..commands.common import StopOnSignal
from ..ros_link import RosLink
from ..service_calls import call_all
from .intrinsics_results import save_results
from .live_camera import LiveCamera, camera_name_of, namespace_of
from .live_panel import panel, plain_line

REFRESH_S = 0.25
PLAIN_EVERY_S = 2.0
SERVICE_TIMEOUT_S = 10.0


def calibrate_live(args: argparse.Namespace, board: Board, console: Console) -> Intrinsics:
    """The whole step; Ctrl-C ends collecting, not the program. Raises InputError: no images, too few views."""
    name = args.name or camera_name_of(args.topic)
    collector = ViewCollector(board, model="plumb_bob" if args.model == AUTO else args.model)
    watcher = BoardWatcher(board, name, collector)
    with RosLink("sagoma_calibrate") as link:
        with StopOnSignal() as stop:
            camera = LiveCamera(link.node, args.topic, watcher)
            try:
                _collect(camera, link.node, stop, args, console)
            finally:
                camera.close()
        console.print(f"{name}: calibrating from {len(collector)} views", highlight=False)
        result = calibrate_intrinsics(collector.best(), board, name=name, model=args.model)
        save_results(Path(args.output), result, board, args.topic)
        console.print(f"results in {args.output}")
        if args.offer:
            console.print(f"{name}: {offer(link.node, namespace_of(args.topic), result)}", highlight=False)
    return result


def offer(node: Node, namespace: str, result: Intrinsics) -> str:
    """Hand the calibration to the camera client of ``namespace``; what became of that.

    One that must be done again is not handed over.
    """
    if result.verdict.grade == REDO:
        return "not handed to the camera client: it must be done again"
    service = f"{namespace}/set_camera_info"
    camera = result.camera
    request = SetCameraInfo.Request(camera_info=camera_info_message(camera, 0, f"{camera.name}_optical"))
    reply = call_all(node, SetCameraInfo, {service: request}, SERVICE_TIMEOUT_S, repeatable=True)[service]
    if reply is None:
        return f"{service} did not answer: is the camera client running?"
    return f"the camera client {'took it' if reply.success else 'refused it'}: {reply.status_message}"


def _collect(camera: LiveCamera, node: Node, stop: threading.Event, args: argparse.Namespace, console: Console) -> None:
    """Until it is enough, the user stops it or the time is over."""
    show = _Panel(console) if console.is_terminal else _PlainLines(console)
    begun_s = time.monotonic()
    with show:
        while not stop.is_set() and not camera.state.enough:
            camera.changed.wait(REFRESH_S)
            camera.changed.clear()
            show.update(camera)
            passed_s = time.monotonic() - begun_s
            if camera.error is not None:
                raise camera.error
            if camera.received == 0 and passed_s > args.wait:
                raise InputError(f"no image came for {args.wait:g} s", where=args.topic, remedy=_who_publishes(node))
            if args.seconds is not None and passed_s > args.seconds:
                return
            if args.views is not None and camera.state.views >= args.views:
                return


def _who_publishes(node: Node) -> str:
    images = sorted(
        name for name, kinds in node.get_topic_names_and_types() if any(kind.endswith("/Image") for kind in kinds)
    )
    listed = f"Image topics there are: {', '.join(images)}" if images else "There is no image topic at all"
    return f"{listed}; start the camera client, and check ROS_DOMAIN_ID."


class _Panel:
    """A panel in the terminal that is drawn anew."""

    def __init__(self, console: Console) -> None:
        self._live = Live(console=console, auto_refresh=False, transient=True)

    def __enter__(self) -> _Panel:
        self._live.__enter__()
        return self

    def __exit__(self, *of_error: object) -> None:
        self._live.__exit__(None, None, None)

    def update(self, camera: LiveCamera) -> None:
        self._live.update(panel(camera.state), refresh=True)


class _PlainLines:
    """A line when a view was taken, not too often."""

    def __init__(self, console: Console) -> None:
        self._console, self._views, self._said_s = console, -1, -PLAIN_EVERY_S

    def __enter__(self) -> _PlainLines:
        return self

    def __exit__(self, *of_error: object) -> None: ...

    def update(self, camera: LiveCamera) -> None:
        state, now_s = camera.state, time.monotonic()
        if state.views != self._views and (now_s - self._said_s >= PLAIN_EVERY_S or state.enough):
            self._views, self._said_s = state.views, now_s
            self._console.print(plain_line(state), highlight=False, soft_wrap=True)
