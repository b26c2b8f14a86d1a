"""A set-up from the empty room to the person, rendered while the cameras look: what is shown can be switched."""

from __future__ import annotations

import time
from collections.abc import Mapping

from capture_rig.errors import InputError
from capture_rig.rig import Rig
from rig_calibration.boards.board import Board
from stick_figure.body import Body

from ..body import Capsules, VolumetricBody
from ..calibration.board_camera import LENS_BLUR_PX, BoardCamera, HeldBoard
from ..calibration.carrying import carry, on_floor
from ..calibration.footage import FLOOR_BOARD, HAND_BOARD
from ..calibration.hands import hands, person_with
from ..calibration.paths import Path
from ..calibration.photographer import exposed
from ..calibration.prints import BoardPrint, print_of
from ..calibration.waving import wave
from ..motion import MOTIONS
from ..render import VirtualCamera
from ..shadow import floor_shadow
from .live_scene import LiveScene, grey
from .pixels import Image
from .stage import SECOND_NS, SWITCH_AFTER_NS, Stage

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
        super().__init__(Stage(len(self._poses), POSES_PER_S), empty, most_hz)
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
        held = HeldBoard(board, exposed(eye.camera, board, path, t, EXPOSURE_S))
        return grey(eye.see([held], people, LENS_BLUR_PX, SAMPLES))

    def _person(self, instant_ns: int) -> Mapping[str, Image]:
        capsules = self._body.place(self._poses[self.stage.frame_at(instant_ns)])
        shade = floor_shadow(capsules)
        return {name: grey(eye.see(capsules, shade)[0]) for name, eye in self._people.items()}
