"""A room rendered while the cameras look, by one thread for all of them."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..sensor import WHITE
from .pixels import Image
from .stage import Stage

KEPT_SETS = 3
LONGEST_STEP_NS = 200_000_000
"""Cameras that look less often are not foreseen."""


@dataclass(frozen=True, eq=False)
class PictureSet:
    """What all cameras see at one instant."""

    instant_ns: int
    pictures: Mapping[str, Image]


class LiveScene(ABC):
    """A live rendering for all cameras of a rig. start() begins to render, close() ends it.

    One thread renders the room for the instants at which cameras will expose next. It is rarely as fast as they are:
    a camera that looks meanwhile sees the newest picture once more, and so do the others that look at that instant.
    ``views`` by camera name. ``counters``: sets_rendered, and how many of the views were fresh or repeated.
    """

    def __init__(self, stage: Stage, empty: Mapping[str, Image], most_hz: float) -> None:
        self.stage, self._empty, self._shortest_ns = stage, empty, round(1e9 / most_hz)
        self.views = {name: LiveView(self, name) for name in empty}
        self.counters = Counter[str]()
        self._sets: deque[PictureSet] = deque(maxlen=KEPT_SETS)
        self._asked: deque[int] = deque(maxlen=2)  # the last two instants that cameras asked for
        self._chosen: PictureSet | None = None  # what is seen at the last of them
        self._condition = threading.Condition()
        self._running = False
        self._thread = threading.Thread(target=self._run, name="room", daemon=True)

    @abstractmethod
    def render(self, instant_ns: int) -> Mapping[str, Image]:
        """What each camera sees at an instant while somebody is there."""

    def start(self) -> None:
        """Render the first set, then go on in a thread."""
        now_ns = time.time_ns()
        self._sets.append(PictureSet(now_ns, self.render(now_ns)))
        self._running = True
        self._thread.start()

    def close(self) -> None:
        with self._condition:
            self._running = False
            self._condition.notify()
        if self._thread.is_alive():
            self._thread.join()

    def empty(self, name: str) -> Image:
        """The room without anybody, for one camera."""
        return self._empty[name]

    def newest(self, instant_ns: int) -> PictureSet:
        """The latest set that is not from after the instant; also tells the renderer that somebody looks."""
        with self._condition:
            if self._asked and instant_ns == self._asked[-1] and self._chosen is not None:
                return self._chosen
            chosen = next((s for s in reversed(self._sets) if s.instant_ns <= instant_ns), self._sets[0])
            if not self._asked or instant_ns > self._asked[-1]:
                self._asked.append(instant_ns)
                self._chosen = chosen
                self._condition.notify()
            return chosen

    def _run(self) -> None:
        duration_ns = 0
        while (instant_ns := self._next_instant(duration_ns)) is not None:
            began = time.monotonic_ns()
            rendered = PictureSet(instant_ns, self.render(instant_ns))
            duration_ns = time.monotonic_ns() - began
            with self._condition:
                self._sets.append(rendered)
            self.counters["sets_rendered"] += 1

    def _next_instant(self, duration_ns: int) -> int | None:
        """The exposure to render next, None at the end; waits until somebody looks, and for the rate's limit.

        It is the first exposure that has not begun when the rendering, of about ``duration_ns``, will be done.
        """
        with self._condition:
            while self._running and not self._is_stale():
                self._condition.wait()
            if not self._running:
                return None
            last, step = self._asked[-1], self._asked[-1] - self._asked[0]
        if not 0 < step < LONGEST_STEP_NS:
            return last
        return last + step * max(-((last - time.time_ns() - duration_ns) // step), 0)

    def _is_stale(self) -> bool:
        return bool(self._asked) and self._asked[-1] - self._sets[-1].instant_ns >= self._shortest_ns


class LiveView:
    """What one camera sees of the room."""

    def __init__(self, scene: LiveScene, name: str) -> None:
        self._scene, self._name = scene, name
        self._last_ns = 0

    @property
    def shape(self) -> tuple[int, ...]:
        return self._scene.empty(self._name).shape

    def image(self, instant_ns: int) -> Image:
        if not self._scene.stage.occupied_at(instant_ns):
            return self._scene.empty(self._name)
        newest = self._scene.newest(instant_ns)
        self._scene.counters["views_repeated" if newest.instant_ns == self._last_ns else "views_fresh"] += 1
        self._last_ns = newest.instant_ns
        return newest.pictures[self._name]


def grey(light: NDArray[np.float32]) -> Image:
    """The picture of light 0..1, without noise: that comes from the camera's sensor."""
    return np.asarray(cv2.convertScaleAbs(light, alpha=WHITE), np.uint8)
