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

from capture_rig.errors import InputError
from capture_rig.rig import Rig
from rig_calibration.boards.board import Board
from stick_figure.body import Body

from ..gige.simulated_camera.imaging import Image
from ..motions.catalogue import MOTIONS
from ..people import Capsules, VolumetricBody
from ..recording.footage import FLOOR_BOARD, HAND_BOARD
from ..rendering.board_camera import LENS_BLUR_PX, BoardCamera, PosedBoard, exposed
from ..rendering.camera import WHITE, VirtualCamera
from ..rendering.capsules import floor_shadow
from ..scene.boards import BoardPrint, print_of
from ..scene.handling import Path, carry, hands, on_floor, person_with, wave
from .scenes import SECOND_NS, SWITCH_AFTER_NS, Playback

KEPT_SETS = 3
LONGEST_STEP_NS = 200_000_000
"""Cameras that look less often are not foreseen."""


@dataclass(frozen=True, eq=False)
class RenderedSet:
    """What all cameras see at one instant."""

    instant_ns: int
    pictures: Mapping[str, Image]


class LiveScene(ABC):
    """A live rendering for all cameras of a rig. start() begins to render, close() ends it.

    One thread renders the room for the instants at which cameras will expose next. It is rarely as fast as they are:
    a camera that looks meanwhile sees the newest picture once more, and so do the others that look at that instant.
    ``views`` by camera name. ``counters``: sets_rendered, and how many of the views were fresh or repeated.
    """

    def __init__(self, stage: Playback, empty: Mapping[str, Image], most_hz: float) -> None:
        self.stage, self._empty, self._shortest_ns = stage, empty, round(1e9 / most_hz)
        self.views = {name: LiveView(self, name) for name in empty}
        self.counters = Counter[str]()
        self._sets: deque[RenderedSet] = deque(maxlen=KEPT_SETS)
        self._asked: deque[int] = deque(maxlen=2)  # the last two instants that cameras asked for
        self._chosen: RenderedSet | None = None  # what is seen at the last of them
        self._condition = threading.Condition()
        self._running = False
        self._thread = threading.Thread(target=self._run, name="room", daemon=True)

    @abstractmethod
    def render(self, instant_ns: int) -> Mapping[str, Image]:
        """What each camera sees at an instant while somebody is there."""

    def start(self) -> None:
        """Render the first set, then go on in a thread."""
        now_ns = time.time_ns()
        self._sets.append(RenderedSet(now_ns, self.render(now_ns)))
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

    def newest(self, instant_ns: int) -> RenderedSet:
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
            rendered = RenderedSet(instant_ns, self.render(instant_ns))
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


# --- The built-in person in the virtual room, rendered while the cameras look.

POSES_PER_S = 60.0


class RoomScene(LiveScene):
    """A person who moves, seen by all cameras of a rig."""

    def __init__(
        self,
        rig: Rig,
        motion: str = "tour",
        seconds: float = 20.0,
        stature_m: float = 1.75,
        shadow: bool = True,
        most_hz: float = 20.0,
    ) -> None:
        body = Body.from_stature(stature_m)
        self._body, self._shadow = VolumetricBody(body), shadow
        self._poses = MOTIONS[motion](body, seconds, POSES_PER_S).poses
        self._cameras = {camera.name: VirtualCamera(camera) for camera in rig.cameras}
        empty = {name: grey(camera.empty_room()) for name, camera in self._cameras.items()}
        super().__init__(Playback(len(self._poses), POSES_PER_S), empty, most_hz)

    def render(self, instant_ns: int) -> dict[str, Image]:
        capsules = self._body.place(self._poses[self.stage.frame_at(instant_ns)])
        shade = floor_shadow(capsules) if self._shadow else None
        return {name: grey(camera.render(capsules, shade)[0]) for name, camera in self._cameras.items()}


# --- A set-up from the empty room to the person, rendered while the cameras look: what is shown can be switched.

EMPTY, INTRINSICS, FLOOR, MOVING, PERSON = PHASES = ("empty", "intrinsics", "floor", "moving", "person")
NEXT = "next"
POSES_PER_S = 60.0
CARRIED_S = 30.0
SAMPLES = 12
EXPOSURE_S = 0.008


class SetupScene(LiveScene):
    """Phases of a set-up: nobody; a board before each camera; a board on the floor; one carried about; the person.

    ``phase`` is the one that is shown, from the empty room on.
    """

    def __init__(
        self,
        rig: Rig,
        motion: str = "tour",
        seconds: float = 20.0,
        most_hz: float = 20.0,
        hand_board: Board = HAND_BOARD,
        floor_board: Board = FLOOR_BOARD,
        seed: int = 1,
    ) -> None:
        body = Body.from_stature(1.75)
        self._body, self._poses = VolumetricBody(body), MOTIONS[motion](body, seconds, POSES_PER_S).poses
        self._people = {camera.name: VirtualCamera(camera) for camera in rig.cameras}
        self._eyes = {camera.name: BoardCamera(camera) for camera in rig.cameras}
        self._hand, self._floor = print_of(hand_board), print_of(floor_board)
        self._waves = {c.name: wave(c, self._hand, seed + number) for number, c in enumerate(rig.cameras)}
        self._carried, self._lying = carry(self._floor, CARRIED_S, seed), on_floor(self._floor)
        empty = {name: grey(camera.empty_room()) for name, camera in self._people.items()}
        super().__init__(Playback(len(self._poses), POSES_PER_S), empty, most_hz)
        self._phase = self._before = PERSON
        self._since_ns = 0
        self.show(EMPTY)

    @property
    def phase(self) -> str:
        return self._phase if self.stage.occupied else EMPTY

    def show(self, phase: str) -> str:
        """Switch to a phase ("next": the one after this), which begins anew; returns its name. Raises InputError."""
        if phase == NEXT:
            phase = PHASES[(PHASES.index(self.phase) + 1) % len(PHASES)]
        if phase not in PHASES:
            raise InputError(
                f"there is no phase '{phase}'",
                where="studio",
                remedy=f"It shows {', '.join(PHASES)}, or the next one: {NEXT}.",
            )
        if phase != EMPTY:
            self._before, self._phase, self._since_ns = self._phase, phase, time.time_ns() + SWITCH_AFTER_NS
        self.stage.occupy(phase != EMPTY)
        return phase

    def render(self, instant_ns: int) -> Mapping[str, Image]:
        phase = self._phase if instant_ns >= self._since_ns else self._before
        t = max(instant_ns - self._since_ns, 0) / SECOND_NS
        if phase == INTRINSICS:
            return {name: self._waved(name, t) for name in self._eyes}
        if phase == MOVING:
            t %= CARRIED_S
            person = person_with(self._body, self._floor, self._carried(t))
            return {name: self._seen(name, self._floor, self._carried, t, person) for name in self._eyes}
        if phase == PERSON:
            return self._person(instant_ns)
        return {name: self._seen(name, self._floor, lambda _: self._lying, 0.0, None) for name in self._eyes}

    def _waved(self, name: str, t: float) -> Image:
        waved = self._waves[name]
        t %= waved.duration_s
        return self._seen(name, self._hand, waved.path, t, hands(self._hand, waved.path(t)))

    def _seen(self, name: str, board: BoardPrint, path: Path, t: float, people: Capsules | None) -> Image:
        eye = self._eyes[name]
        held = PosedBoard(board, exposed(eye.camera, board, path, t, EXPOSURE_S))
        return grey(eye.render([held], people, LENS_BLUR_PX, SAMPLES))

    def _person(self, instant_ns: int) -> Mapping[str, Image]:
        capsules = self._body.place(self._poses[self.stage.frame_at(instant_ns)])
        shade = floor_shadow(capsules)
        return {name: grey(eye.render(capsules, shade)[0]) for name, eye in self._people.items()}
