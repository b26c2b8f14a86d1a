"""Renders the virtual room live, for all cameras of a rig: a person in it, or a set-up in phases.

One thread renders for all cameras: the scene's content, at the cameras' instants.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import cv2
import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import Rig
from capture_rig.stamps import UTC, CaptureClock
from rig_calibration.boards.board import Board
from stick_figure.body import TYPICAL_STATURE_M, Body

from ..boards import BoardPrint, PosePath, carry, hands, on_floor, person_with, print_of, wave
from ..motions.catalogue import MOTIONS
from ..people import Capsules, VolumetricBody
from ..recording.footage import FLOOR_BOARD, HAND_BOARD
from ..recording.session import SESSION_FPS
from ..rendering.board_camera import BoardCamera
from ..rendering.camera import WHITE, Image, Light, VirtualCamera
from ..rendering.capsules import floor_shadow
from .scenes import SECOND_NS, Playback, StudioScene

RENDER_HZ = 20  # live renderings at most
EMPTY, INTRINSICS, FLOOR, MOVING, PERSON = PHASES = ("empty", "intrinsics", "floor", "moving", "person")
NEXT = "next"
CARRIED_S = 30.0
SAMPLES = 12


class RenderedSet(NamedTuple):
    """Pictures of all cameras, by name, at one instant (UTC, ns)."""

    instant_ns: int
    pictures: Mapping[str, Image]


class RoomScene(StudioScene):
    """A person who moves in the room, rendered live for all cameras of a rig while they expose.

    A thread of its own renders the room for an instant at which a camera exposed. It is rarely as fast as they are:
    exposures meanwhile get the newest picture once more, those of one instant the same.
    """

    playback: Playback

    def __init__(
        self,
        rig: Rig,
        motion: str = "tour",
        seconds: float = 20.0,
        most_hz: float = RENDER_HZ,
        clock: CaptureClock = UTC,
    ) -> None:
        body = Body.from_stature(TYPICAL_STATURE_M)
        self._person = VolumetricBody(body)
        self._poses = MOTIONS[motion](body, seconds, SESSION_FPS).poses
        self._cameras = {camera.name: VirtualCamera(camera) for camera in rig.cameras}
        self._empty = {name: _picture(camera.empty_room()) for name, camera in self._cameras.items()}
        views = {name: LiveView(self, name) for name in rig.names}
        note = f"rendered live, at most {RENDER_HZ:g} times a second: pictures in between are repeated"
        super().__init__(rig, views, Playback(len(self._poses), SESSION_FPS, clock), True, (note,))
        self._shortest_ns = round(1e9 / most_hz)
        self._asked_ns = 0  # the last instant that cameras requested
        self._newest = self._chosen = RenderedSet(0, {})  # of which the latter is seen at that instant
        self._renderer = ThreadPoolExecutor(1, "room")
        self._rendering = Future[RenderedSet]()

    def render(self, instant_ns: int) -> Mapping[str, Image]:
        """Renders each camera's view at an instant while the room is occupied."""
        capsules = self._person.place(self._poses[self.playback.frame_at(instant_ns)])
        shadow = floor_shadow(capsules)
        return {name: _picture(camera.render(capsules, shadow)[0]) for name, camera in self._cameras.items()}

    def start(self) -> None:
        """Renders the first set."""
        self._rendering = self._renderer.submit(self._render_set, self.playback.clock.now_ns())
        self._rendering.result()

    def close(self) -> None:
        self._renderer.shutdown()

    def empty(self, name: str) -> Image:
        """Returns one camera's picture of the empty room."""
        return self._empty[name]

    def seen_at(self, instant_ns: int) -> RenderedSet:
        """Returns the set that is seen at an instant, and has one rendered for it where the newest is old."""
        if instant_ns > self._asked_ns:
            if self._rendering.done():
                self._newest = self._rendering.result()
                if instant_ns - self._newest.instant_ns >= self._shortest_ns:
                    self._rendering = self._renderer.submit(self._render_set, instant_ns)
            self._asked_ns, self._chosen = instant_ns, self._newest
        return self._chosen

    def _render_set(self, instant_ns: int) -> RenderedSet:
        return RenderedSet(instant_ns, self.render(instant_ns))


class LiveView:
    """One camera's view of the room."""

    def __init__(self, scene: RoomScene, name: str) -> None:
        self._scene, self._name, self.shape = scene, name, scene.empty(name).shape

    def image(self, instant_ns: int) -> Image:
        if not self._scene.playback.occupied:
            return self._scene.empty(self._name)
        return self._scene.seen_at(instant_ns).pictures[self._name]


class SetupScene(RoomScene):
    """Phases of a set-up: empty room; a board before each camera; a board on the floor; one carried about; the person.

    ``phase`` is the one that is shown, from the empty room on.
    """

    def __init__(
        self,
        rig: Rig,
        motion: str = "tour",
        seconds: float = 20.0,
        clock: CaptureClock = UTC,
        hand_board: Board = HAND_BOARD,
        floor_board: Board = FLOOR_BOARD,
        seed: int = 1,
    ) -> None:
        super().__init__(rig, motion, seconds, clock=clock)
        self._board_cameras = {camera.name: BoardCamera(camera) for camera in rig.cameras}
        self._hand, self._floor = print_of(hand_board), print_of(floor_board)
        self._waves = {c.name: wave(c, self._hand, seed + number) for number, c in enumerate(rig.cameras)}
        self._carried, self._lying = carry(self._floor, CARRIED_S, seed), on_floor(self._floor)
        self._phase, self._since_ns = PERSON, 0
        self.show(EMPTY)

    @property
    def phase(self) -> str:
        return self._phase if self.playback.occupied else EMPTY

    def show(self, phase: str) -> str:
        """Switches to the start of a phase ("next": the one after this); returns its name. Raises InputError."""
        if phase == NEXT:
            phase = PHASES[(PHASES.index(self.phase) + 1) % len(PHASES)]
        if phase not in PHASES:
            remedy = f"It shows {', '.join(PHASES)}, or the next one: {NEXT}."
            raise InputError(f"there is no phase '{phase}'", where="studio", remedy=remedy)
        if phase != EMPTY:
            self._phase, self._since_ns = phase, self.playback.clock.now_ns()
        self.playback.occupied = phase != EMPTY
        return phase

    def render(self, instant_ns: int) -> Mapping[str, Image]:
        phase = self._phase
        t = max(instant_ns - self._since_ns, 0) / SECOND_NS
        if phase == INTRINSICS:
            pictures = {}
            for name, waved in self._waves.items():
                at = t % waved.duration_s
                held = hands(self._hand, waved.path(at))
                pictures[name] = self._render_board(name, self._hand, waved.path, at, held)
            return pictures
        if phase == MOVING:
            t %= CARRIED_S
            person = person_with(self._person, self._floor, self._carried(t))
            return {name: self._render_board(name, self._floor, self._carried, t, person) for name in self._waves}
        if phase == PERSON:
            return super().render(instant_ns)
        return {name: self._render_board(name, self._floor, lambda _: self._lying, 0.0, None) for name in self._waves}

    def _render_board(self, name: str, board: BoardPrint, path: PosePath, t: float, people: Capsules | None) -> Image:
        return _picture(self._board_cameras[name].film(board, path, t, people, SAMPLES))


def _picture(light: Light) -> Image:
    """Return the picture of light 0..1, without noise: that comes from the camera's sensor."""
    return np.asarray(cv2.convertScaleAbs(light, alpha=WHITE), np.uint8)
