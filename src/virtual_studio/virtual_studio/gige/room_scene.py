"""The built-in person in the virtual room, rendered while the cameras look."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.rig import Rig
from stick_figure.body import Body

from ..body import VolumetricBody
from ..motion import MOTIONS
from ..render import VirtualCamera
from ..sensor import WHITE
from ..shadow import floor_shadow
from .pixels import Image
from .stage import Stage

POSES_PER_S = 60.0
KEPT_SETS = 3
LONGEST_STEP_NS = 200_000_000
"""Cameras that look less often are not foreseen."""


@dataclass(frozen=True, eq=False)
class _PictureSet:
    """What all cameras see at one instant."""

    instant_ns: int
    pictures: dict[str, Image]


class RoomScene:
    """A live rendering for all cameras of a rig. start() begins to render, close() ends it.

    One thread renders the room for the instants at which cameras will expose next. It is rarely as fast as they are:
    a camera that looks meanwhile sees the newest picture once more. ``counters``: sets_rendered, and how many of the
    views were fresh or repeated.
    """

    def __init__(
        self, rig: Rig, motion: str = "tour", seconds: float = 20.0, stature_m: float = 1.75, shadow: bool = True,
        most_hz: float = 20.0,
    ) -> None:  # fmt: skip
        body = Body.from_stature(stature_m)
        self._body, self._shadow, self._shortest_ns = VolumetricBody(body), shadow, round(1e9 / most_hz)
        self._poses = MOTIONS[motion](body, seconds, POSES_PER_S).poses
        self._cameras = {camera.name: VirtualCamera(camera) for camera in rig.cameras}
        self._empty = {name: _grey(camera.empty_room()) for name, camera in self._cameras.items()}
        self.stage = Stage(len(self._poses), POSES_PER_S)
        self.views = {name: RoomView(self, name) for name in self._cameras}
        self.counters = Counter[str]()
        self._sets: deque[_PictureSet] = deque(maxlen=KEPT_SETS)
        self._asked: deque[int] = deque(maxlen=2)  # the last two instants that cameras asked for
        self._condition = threading.Condition()
        self._running = False
        self._thread = threading.Thread(target=self._run, name="room", daemon=True)

    def start(self) -> None:
        """Render the first set, then go on in a thread."""
        self._sets.append(self._render(time.time_ns()))
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

    def newest(self, instant_ns: int) -> _PictureSet:
        """The latest set that is not from after the instant; also tells the renderer that somebody looks."""
        with self._condition:
            if not self._asked or instant_ns > self._asked[-1]:
                self._asked.append(instant_ns)
                self._condition.notify()
            return next((s for s in reversed(self._sets) if s.instant_ns <= instant_ns), self._sets[0])

    def _run(self) -> None:
        duration_ns = 0
        while (instant_ns := self._next_instant(duration_ns)) is not None:
            began = time.monotonic_ns()
            rendered = self._render(instant_ns)
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

    def _render(self, instant_ns: int) -> _PictureSet:
        pose = self._poses[self.stage.frame_at(instant_ns)]
        capsules = self._body.place(pose)
        shade = floor_shadow(capsules) if self._shadow else None
        pictures = {name: _grey(camera.see(capsules, shade)[0]) for name, camera in self._cameras.items()}
        return _PictureSet(instant_ns, pictures)


class RoomView:
    """What one camera sees of the room."""

    def __init__(self, scene: RoomScene, name: str) -> None:
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


def _grey(light: NDArray[np.float32]) -> Image:
    return np.asarray(cv2.convertScaleAbs(light, alpha=WHITE), np.uint8)
