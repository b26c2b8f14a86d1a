"""Sources of a live run's frames: a session's videos as files, or simulated GigE cameras that show the session."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from capture_rig.session import Session, load_session
from capture_rig.stamps import UTC, CaptureClock
from sagoma_bringup.graph import NodeSpec, build_graph
from virtual_studio.gige.__main__ import CAMERA_FOLDER, RIG_FILE
from virtual_studio.gige.device import consecutive_addresses, is_free
from virtual_studio.gige.loop import ask

from ..graph import ANSWER_S, LOOK_S, PATIENCE_S, START_TIMEOUT_S
from ..graph.background_training import learn_backgrounds
from ..graph.processes import Child, busy_machine, stop_children
from ..graph.ros_link import call_all
from ..graph.supervisor import Supervisor
from ..graph.topics import LATENCY_TOPIC
from ..recording.recorder import GraphRecorder
from .track import SessionClock, frame_count

FIRST_ADDRESSES = [f"127.0.{subnet}.1" for subnet in range(1, 32)]
SETTLE_S = 6.0  # until a graph has found its rate: a queue that grows by 5 % stands after half of it


class StudioProcess:
    """Runs ``sagoma studio ARGUMENTS`` as a process; a context manager that leaves no process behind.

    ``rig`` and ``cameras`` are the files with which the graph runs on it. Raises InputError when it does not start.
    """

    def __init__(self, folder: str | Path, *arguments: str) -> None:
        self.folder = Path(folder)
        self.rig, self.cameras = self.folder / RIG_FILE, self.folder / CAMERA_FOLDER
        self._arguments = arguments
        # the name of a Unix socket has at most 107 bytes, less than some folders' names
        self._sockets = tempfile.TemporaryDirectory(prefix="sagoma_studio_")
        self._control = Path(self._sockets.name) / "control"
        self._child: Child | None = None

    @property
    def pid(self) -> int:
        assert self._child is not None
        return self._child.pid

    def start(self, cancel: threading.Event | None = None) -> Self:
        """Start it; returns once every camera is on."""
        self.folder.mkdir(parents=True, exist_ok=True)
        places = ["--control", str(self._control), "--write", str(self.folder)]
        command = [sys.executable, "-u", "-m", "virtual_studio.gige", *places, *self._arguments]
        ended, log = threading.Event(), self.folder / "studio.log"
        log.unlink(missing_ok=True)
        self._child = Child("studio", command, log, {**os.environ, "OPENBLAS_NUM_THREADS": "1"}, lambda _: ended.set())
        deadline_s = time.monotonic() + START_TIMEOUT_S  # a long session is decoded into memory first
        while self._child.log_tail(1) != "ready":
            interrupted = cancel is not None and cancel.is_set()
            if ended.wait(LOOK_S) or interrupted or time.monotonic() > deadline_s:
                self.close()
                said = "it was interrupted" if interrupted else self._child.log_tail(2) or "its log is empty"
                remedy = f"Correct what its log names; {busy_machine() or 'the machine is not busy'}."
                raise InputError(f"the studio did not start ({said})", where=str(log), remedy=remedy)
        return self

    def ask(self, do: str, **words: Any) -> dict[str, Any]:
        """Send one request to its control channel; see ``sagoma studio --help``."""
        return ask({"do": do, **words}, self._control)

    def close(self) -> None:
        """End it; may be called twice."""
        if self._child is not None:
            stop_children([self._child], ANSWER_S)
        self._sockets.cleanup()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *error: object) -> None:
        self.close()


class FootageInput:
    """The session's videos, read by the camera clients; at rate 0 as fast as the graph keeps up, dropping nothing.

    ``clock`` is that of cameras which expose. in_real_time : whether a frame's stamp is the time of its exposure, so
    that its age is a latency.
    """

    clock = UTC

    def __init__(self, session_folder: str | Path, rate: float = 0.0) -> None:
        self.session: Session = load_session(session_folder)
        self._rate, self.in_real_time = rate, rate > 0.0

    def graph(self, settings: Mapping[str, Any]) -> list[NodeSpec]:
        """Return the nodes that process these frames."""
        return build_graph(session=self.session.folder, rate=self._rate, settings=settings)

    def prepare(self, supervisor: Supervisor, cancel: threading.Event) -> None:
        """Prepare the active graph for the playback, and give it time to find the rate that it holds: files train no
        background, and are played no faster than the graph answers."""

    def play(self, recorder: GraphRecorder, cancel: threading.Event) -> SessionClock | None:
        """Play the session once through the active graph and wait for the answers.

        None where the input has no clock of its own: the first stamp is then that of frame 0.
        """
        expected, seen = frame_count(self.session), -1
        while seen < expected and not cancel.is_set():
            if not recorder.wait_for_count(LATENCY_TOPIC, seen + 1, PATIENCE_S):
                break
            seen = recorder.counts.get(LATENCY_TOPIC, 0)
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing: only other inputs run processes of their own."""


class StudioInput(FootageInput):
    """Simulated GigE Vision cameras that show the session; the graph runs on them as on hardware.

    The room is empty at first, and every camera client trains its background. At full speed, the session's first
    picture then stays for SETTLE_S, in which the graph finds the rate that it holds; the session plays.

    fps : of the cameras, in their time; the session's pictures change at the session's own rate.
    speed : of the cameras' time; below 1, slow motion, no frame set is left out.
    cancel : ends the start.
    """

    def __init__(
        self,
        session_folder: str | Path,
        folder: str | Path,
        fps: float,
        speed: float = 1.0,
        *,
        cancel: threading.Event | None = None,
    ) -> None:
        super().__init__(session_folder, speed)
        self._fps, self._cancel = fps, cancel
        self.clock = CaptureClock(speed)
        self.in_real_time = speed == 1
        address = free_first_address(len(self.session.rig.names))
        scene = "--session", str(self.session.folder), "--fps", f"{fps:g}", "--speed", str(self.clock.speed), "--empty"
        self.studio = StudioProcess(folder, *scene, "--address", address)

    def __enter__(self) -> Self:
        self.studio.start(self._cancel)
        return self

    def __exit__(self, *error: object) -> None:
        self.studio.close()

    def graph(self, settings: Mapping[str, Any]) -> list[NodeSpec]:
        measured = {"hull_server.tolerance_s": 0.5 / self._fps}
        return build_graph(rig=self.studio.rig, cameras=self.studio.cameras, settings={**measured, **settings})

    def prepare(self, supervisor: Supervisor, cancel: threading.Event) -> None:
        learn_backgrounds(supervisor)
        self.studio.ask("hold")
        self.studio.ask("room", state="occupied")
        if self.in_real_time:
            cancel.wait(SETTLE_S)
        resets = {f"/{tracker}/reset": Trigger.Request() for tracker in ("icp_tracker", "ekf_tracker")}
        call_all(supervisor.node, Trigger, resets, PATIENCE_S)

    def play(self, recorder: GraphRecorder, cancel: threading.Event) -> SessionClock:
        answer = self.studio.ask("play", loop=False)
        clock = SessionClock(answer["epoch_ns"], answer["frames"], answer["fps"], exposed=True)
        last_ns = clock.epoch_ns + round((clock.frames / clock.fps - 1.0 / self._fps) * 1e9)  # the last exposure
        counts, heard_s = recorder.counts, time.monotonic() + self.clock.wait_ns(last_ns) * 1e-9
        while time.monotonic() < heard_s + PATIENCE_S and not cancel.is_set():
            if recorder.wait_for_stamp(LATENCY_TOPIC, last_ns, LOOK_S):
                break
            if counts != (counts := recorder.counts):
                heard_s = max(heard_s, time.monotonic())
        return clock


def free_first_address(count: int) -> str:
    """Return the first of ``count`` loopback addresses in a row on which no other studio serves.

    Studios that start at the same time do not see each other yet: their processes begin the search at different ones.
    """
    begin = os.getpid() % len(FIRST_ADDRESSES)
    for first in (*FIRST_ADDRESSES[begin:], *FIRST_ADDRESSES[:begin]):
        if all(is_free(address) for address in consecutive_addresses(first, count)):
            return first
    what = "other studios hold every address"
    raise InputError(what, where=f"{FIRST_ADDRESSES[0]} to {FIRST_ADDRESSES[-1]}", remedy="End one of them.")
