"""Takes frames from a source on a thread and hands them on, until it is stopped or the footage ends."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from enum import Enum

from capture_rig.errors import InputError

from ..frame_source import POLL_S, EndOfFootage, Frame, FrameSource

STOP_TIMEOUT_S = 10.0


class GrabState(Enum):
    """What the loop is doing."""

    WAITING = "waiting for a consumer"
    RUNNING = "active"
    ENDED = "end of footage"
    FAILED = "failed"
    STOPPED = "stopped"


class GrabLoop:
    """Starts ``source`` once ``ready`` says so (or ``ready_timeout_s`` is over) and calls ``on_frame`` for each frame.

    ``on_frame`` runs on the loop's own thread; an exception in it goes to ``on_error`` and costs this frame only.
    An error of the source ends the loop in state FAILED, with ``reason`` saying why; a live camera that goes is none,
    for its source (:class:`~camera_client.sources.supervised_source.SupervisedSource`) waits for it.
    """

    def __init__(
        self,
        source: FrameSource,
        on_frame: Callable[[Frame], None],
        on_error: Callable[[Exception], None],
        ready: Callable[[], bool] = lambda: True,
        ready_timeout_s: float = 0.0,
    ) -> None:
        self._source, self._on_frame, self._on_error = source, on_frame, on_error
        self._ready, self._ready_timeout_s = ready, ready_timeout_s
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="grab", daemon=True)
        self.state = GrabState.WAITING
        self.reason, self.frames = "", 0
        self.start = self._thread.start

    def stop(self) -> None:
        self._stopping.set()
        self.wait(STOP_TIMEOUT_S)
        self._source.stop()

    def wait(self, timeout_s: float) -> bool:
        """Wait until the loop has ended; False when it has not within ``timeout_s``."""
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            deadline_s = time.monotonic() + self._ready_timeout_s
            while not self._ready() and time.monotonic() < deadline_s and not self._stopping.wait(POLL_S):
                pass
            if not self._stopping.is_set():
                self._source.start()
                self.state = GrabState.RUNNING
            while not self._stopping.is_set():
                self._step()
            self.state = GrabState.STOPPED
        except EndOfFootage:
            self.state = GrabState.ENDED
        except Exception as error:
            self.reason, self.state = str(error), GrabState.FAILED
            if not isinstance(error, InputError):
                self._on_error(error)

    def _step(self) -> None:
        frame = self._source.read(POLL_S)
        if frame is None:
            return
        self.frames += 1
        try:
            self._on_frame(frame)
        except Exception as error:
            self._on_error(error)
