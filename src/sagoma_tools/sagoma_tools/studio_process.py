"""A studio of simulated cameras as a process of its own, as far away from the graph as hardware is."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from capture_rig.errors import InputError
from virtual_studio.gige.control import ask
from virtual_studio.gige.rig_files import CAMERA_FOLDER, RIG_FILE

from .processes import Child, stop_children

READY_TIMEOUT_S = 120.0  # a long session is decoded into memory first
LOOK_S = 0.05
GRACE_S = 5.0


class StudioProcess:
    """Runs ``sagoma studio ARGUMENTS``; a context manager that leaves no process behind.

    ``rig`` and ``cameras`` are the files with which the graph runs on it.
    Raises InputError with the studio's own words where it does not start.
    """

    def __init__(self, folder: str | Path, *arguments: str) -> None:
        self.folder = Path(folder)
        self._arguments = arguments
        # the name of a Unix socket has at most 107 bytes, less than some folders' names
        self._sockets = tempfile.TemporaryDirectory(prefix="sagoma_studio_")
        self._control = Path(self._sockets.name) / "control"
        self._child: Child | None = None

    @property
    def rig(self) -> Path:
        return self.folder / RIG_FILE

    @property
    def cameras(self) -> Path:
        return self.folder / CAMERA_FOLDER

    @property
    def pid(self) -> int:
        assert self._child is not None
        return self._child.pid

    def start(self, cancel: threading.Event | None = None) -> StudioProcess:
        """Return once every camera is on."""
        self.folder.mkdir(parents=True, exist_ok=True)
        command = [
            sys.executable,
            "-u",
            "-m",
            "virtual_studio.gige",
            "--control",
            str(self._control),
            "--write",
            str(self.folder),
            *self._arguments,
        ]
        ended = threading.Event()
        log = self.folder / "studio.log"
        self._child = Child("studio", command, log, {**os.environ, "OPENBLAS_NUM_THREADS": "1"}, lambda _: ended.set())
        deadline_s = time.monotonic() + READY_TIMEOUT_S
        while self._child.log_tail(1) != "ready":
            if ended.wait(LOOK_S) or time.monotonic() > deadline_s or (cancel is not None and cancel.is_set()):
                self.close()
                raise InputError(
                    f"the studio did not start ({self._child.log_tail(2) or 'it said nothing'})",
                    where=str(log),
                    remedy="Mend what its log says.",
                )
        return self

    def ask(self, do: str, **words: Any) -> dict[str, Any]:
        """Send one request to its control channel; see ``sagoma studio --help``."""
        return ask({"do": do, **words}, self._control)

    def close(self) -> None:
        """End it; may be called twice."""
        if self._child is not None:
            stop_children([self._child], GRACE_S)
        self._sockets.cleanup()

    def __enter__(self) -> StudioProcess:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
