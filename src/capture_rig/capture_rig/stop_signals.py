"""Ends a program's work in order when it is asked to stop: Ctrl-C, SIGTERM, a closed terminal."""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Any

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopOnSignal:
    """Turns signals that ask a process to stop into an event, while the context lasts.

    A handler runs in the main thread, between any two of its instructions, also in the midst of the event's own
    ``wait``, which holds the lock that ``set`` needs: set there, the event could hang the process for good. So another
    thread sets it.
    """

    def __init__(self) -> None:
        self.event = threading.Event()
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> threading.Event:
        self._previous = {number: signal.signal(number, self._on_signal) for number in STOP_SIGNALS}
        return self.event

    def __exit__(self, *error: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        threading.Thread(target=self.event.set, name="stop", daemon=True).start()
