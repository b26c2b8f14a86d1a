"""Where the frames of a live run come from: simulated GigE cameras that look at a session, or its videos as files."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from capture_rig.errors import InputError
from capture_rig.session import Session, load_session
from sagoma_bringup.graph import build_graph
from sagoma_bringup.node_spec import NodeSpec
from virtual_studio.gige.addresses import following, is_free

from .backgrounds import learn_backgrounds
from .graph_recorder import GraphRecorder
from .playing import Play, frame_count
from .studio_process import StudioProcess
from .supervisor import Supervisor
from .topics import PREDICTION_TOPIC

SILENCE_S = 20.0
LOOK_S = 0.5
FIRST_ADDRESSES = [f"127.0.{subnet}.1" for subnet in range(1, 32)]


class Stage(ABC):
    """Frames for a graph of their own; a context manager, since there may be processes behind it."""

    def __init__(self, session_folder: str | Path) -> None:
        self.session: Session = load_session(session_folder)

    @abstractmethod
    def graph(self, settings: Mapping[str, Any]) -> list[NodeSpec]:
        """The nodes that take these frames."""

    def prepare(self, supervisor: Supervisor) -> None:  # noqa: B027 (files bring their backgrounds)
        """What the active graph needs before the play begins."""

    @abstractmethod
    def play(self, recorder: GraphRecorder, cancel: threading.Event) -> Play | None:
        """Play the session once through the active graph and wait for the answers.

        None where the stage does not know its own clock: the first stamp is then that of frame 0.
        """

    @property
    @abstractmethod
    def in_real_time(self) -> bool:
        """Whether a frame's stamp is the time at which it was seen, so that its age is a latency."""

    def open(self, cancel: threading.Event) -> None:  # noqa: B027 (files need no preparation)
        """Get ready; :meth:`close` undoes it."""

    def close(self) -> None:  # noqa: B027
        """End what :meth:`open` began."""

    def __enter__(self) -> Stage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class FootageStage(Stage):
    """The camera clients read the session's videos; at rate 0 as fast as the graph keeps up, dropping nothing."""

    def __init__(self, session_folder: str | Path, rate: float = 0.0) -> None:
        super().__init__(session_folder)
        self._rate = rate

    def graph(self, settings: Mapping[str, Any]) -> list[NodeSpec]:
        return build_graph(session=self.session.folder, rate=self._rate, settings=settings)

    def play(self, recorder: GraphRecorder, cancel: threading.Event) -> None:
        expected, seen = frame_count(self.session), -1
        while seen < expected and not cancel.is_set():
            if not recorder.recorder.wait_for_count(PREDICTION_TOPIC, seen + 1, SILENCE_S):
                return
            seen = recorder.recorder.counts.get(PREDICTION_TOPIC, 0)

    @property
    def in_real_time(self) -> bool:
        return self._rate > 0.0


class StudioStage(Stage):
    """Simulated GigE Vision cameras see the session, and the graph runs on them as on hardware.

    The room is empty at first, and every camera client learns its background; then the person enters.
    ``fps``: of the cameras; the session's pictures are seen at their own time, whatever it is.
    """

    def __init__(self, session_folder: str | Path, folder: str | Path, fps: float) -> None:
        super().__init__(session_folder)
        if not fps > 0:
            raise InputError(f"fps = {fps:g}", where="cameras", remedy="Give a frame rate above 0 Hz.")
        self._fps = fps
        arguments = (
            "--session",
            str(self.session.folder),
            "--fps",
            f"{fps:g}",
            "--empty",
            "--address",
            free_first_address(len(self.session.rig.names)),
        )
        self.studio = StudioProcess(folder, *arguments)

    def open(self, cancel: threading.Event) -> None:
        self.studio.start(cancel)

    def close(self) -> None:
        self.studio.close()

    def graph(self, settings: Mapping[str, Any]) -> list[NodeSpec]:
        measured = {"hull_server.tolerance_s": 0.5 / self._fps}
        return build_graph(rig=self.studio.rig, cameras=self.studio.cameras, settings={**measured, **settings})

    def prepare(self, supervisor: Supervisor) -> None:
        learn_backgrounds(supervisor)

    def play(self, recorder: GraphRecorder, cancel: threading.Event) -> Play:
        answer = self.studio.ask("play", loop=False)
        play = Play(answer["epoch_ns"], answer["frames"], answer["fps"], exposed=True)
        last_ns = play.epoch_ns + round((play.frames / play.fps - 1.5 / self._fps) * 1e9)
        deadline_s = time.monotonic() + (last_ns - time.time_ns()) * 1e-9 + SILENCE_S
        while time.monotonic() < deadline_s and not cancel.is_set():
            if recorder.recorder.wait_for_stamp(PREDICTION_TOPIC, last_ns, LOOK_S):
                break
        return play

    @property
    def in_real_time(self) -> bool:
        return True


def free_first_address(count: int, candidates: Sequence[str] = FIRST_ADDRESSES) -> str:
    """The first of ``count`` loopback addresses in a row on which no other studio serves."""
    for first in candidates:
        if all(is_free(address) for address in following(first, count)):
            return first
    raise InputError(
        "other studios hold every address", where=f"{candidates[0]} to {candidates[-1]}", remedy="End one of them."
    )
