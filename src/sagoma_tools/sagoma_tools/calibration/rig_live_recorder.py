"""Records what synchronised cameras see of a carried board, live: only the corners are kept."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import TracebackType

import numpy as np
from rclpy.node import Node
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from sensor_msgs.msg import Image

from capture_rig.errors import InputError
from capture_rig.frame_set import FrameSet, FrameSetCollector
from rig_calibration.boards.board import Board
from rig_calibration.boards.detection import find_board
from rig_calibration.boards.sharpness import blur_px
from rig_calibration.boards.sighting import Sighting
from rig_calibration.extrinsics.calibrate import MOVING
from rig_calibration.extrinsics.progress import ENOUGH_SHARED, MotionProgress, motion_progress
from sagoma_ros.qos import SILHOUETTE_SUBSCRIBER
from sagoma_ros.stamps import to_ns
from sagoma_ros.worker import Worker

from .live_image import image_of
from .rig_sightings import MOST_BLUR_PX, Seen

TOLERANCE_NS = 10_000_000
"""Exposures further apart are not of one moment: a board carried at 0.5 m/s moves 5 mm meanwhile."""
DEADLINE_NS = 2_000_000_000
REFRESH_S, PLAIN_EVERY_S, SILENCE_S = 0.25, 3.0, 15.0


class MotionRecorder:
    """Sorts the cameras' images into frame sets by stamp and looks for the board in one set after the other; while it
    looks, sets are dropped, never queued. A context: closing it ends the subscriptions."""

    def __init__(self, node: Node, topics: Mapping[str, str], board: Board) -> None:
        self._node, self._topics, self._board = node, dict(topics), board
        self._collector: FrameSetCollector[Image] = FrameSetCollector(
            topics, tolerance_ns=TOLERANCE_NS, deadline_ns=DEADLINE_NS
        )
        self._pool = ThreadPoolExecutor(max(1, len(topics)))
        self._lock = threading.Lock()
        self._sightings: list[Sighting] = []
        self._pictures: dict[str, np.ndarray] = {}
        self._blurred = dict.fromkeys(topics, 0)
        self.changed = threading.Event()
        self.error: Exception | None = None
        self.examined = self.received = 0
        self._worker: Worker[FrameSet[Image]] = Worker(
            "board finder", self._look, depth=1, on_drop=lambda: None, on_error=self._fail
        )
        self._subscriptions = [
            node.create_subscription(Image, topic, partial(self._on_image, name), SILHOUETTE_SUBSCRIBER)
            for name, topic in topics.items()
        ]

    def progress(self) -> MotionProgress:
        """How far it has come."""
        with self._lock:
            return motion_progress(tuple(self._topics), self._sightings)

    def seen(self) -> dict[str, Seen]:
        """What each camera saw."""
        with self._lock:
            return {
                name: Seen(
                    name,
                    tuple(s for s in self._sightings if s.camera == name),
                    self.examined,
                    self._blurred[name],
                    picture,
                )
                for name, picture in sorted(self._pictures.items())
            }

    def __enter__(self) -> MotionRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._worker.close()
        self._pool.shutdown()

    def _on_image(self, name: str, message: Image) -> None:
        self.received += 1
        for closed in self._collector.add(name, to_ns(message.header.stamp), message, time.monotonic_ns()):
            if len(closed.frames) > 1:
                self._worker.put(closed)

    def _look(self, frames: FrameSet[Image]) -> None:
        """On the worker's thread."""
        moment = self.examined
        jobs = {n: self._pool.submit(self._find, n, moment, message) for n, message in frames.frames.items()}
        found = {name: job.result() for name, job in jobs.items()}
        with self._lock:
            self.examined += 1
            self._sightings += [sighting for sighting in found.values() if sighting is not None]
        self.changed.set()

    def _find(self, name: str, moment: int, message: Image) -> Sighting | None:
        image = image_of(message, self._topics[name])
        self._pictures.setdefault(name, image)
        sighting = find_board(image, self._board, camera=name, moment=moment, target=MOVING)
        if sighting is not None and blur_px(image, sighting) > MOST_BLUR_PX:
            self._blurred[name] += 1
            return None
        return sighting

    def _fail(self, error: Exception) -> None:
        if not isinstance(error, InputError):  # one bad picture: the next may be better
            self.error = error
        self.changed.set()


def watch_recorder(recorder: MotionRecorder, console: Console, stop: threading.Event) -> None:
    """Show the progress until it is enough or the person stops it. Raises InputError when no set of pictures comes."""
    begun_s, said_s = time.monotonic(), 0.0
    with Live(console=console, auto_refresh=False, transient=True) as live:
        while not stop.is_set():
            recorder.changed.wait(REFRESH_S)
            recorder.changed.clear()
            if recorder.error is not None:
                raise recorder.error
            now_s, progress = time.monotonic(), recorder.progress()
            if recorder.examined == 0 and now_s - begun_s > SILENCE_S:
                raise InputError(_silence(recorder), remedy="Synchronise the cameras (docs/camera_pcs.md).")
            if console.is_terminal:
                live.update(progress_panel(progress, recorder.examined), refresh=True)
            elif now_s - said_s > PLAIN_EVERY_S:
                said_s = now_s
                console.print(f"{progress.moments} moments; {progress.advice or 'enough'}", highlight=False)
            if not progress.advice:
                return


def _silence(recorder: MotionRecorder) -> str:
    if recorder.received == 0:
        return "no picture comes from any camera"
    return f"{recorder.received} pictures came, but no two cameras' within {TOLERANCE_NS / 1e6:g} ms of each other"


def progress_panel(progress: MotionProgress, examined: int) -> Panel:
    """Who shares how many moments with whom, and where to carry the board."""
    table = Table(show_edge=False, pad_edge=False)
    table.add_column("shared moments")
    for name in progress.cameras:
        table.add_column(name, justify="right")
    table.add_column("places of 9", justify="right")
    for one in progress.cameras:
        counts = [_cell(progress, one, other) for other in progress.cameras]
        table.add_row(one, *counts, str(progress.cells[one]))
    title = progress.advice or "enough"
    summary = f"{progress.moments} moments seen by two or more cameras, of {examined} looked at"
    return Panel(Group(table, summary), title=title, subtitle="Ctrl-C: calibrate with these")


def _cell(progress: MotionProgress, one: str, other: str) -> str:
    if one == other:
        return ""
    count = progress.shared.get((min(one, other), max(one, other)), 0)
    colour = "green" if count >= ENOUGH_SHARED else "yellow" if count else "red"
    return f"[{colour}]{count}[/]"
