"""A studio: the cameras of a rig, all in one process, looking at one stage, exposing in step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from capture_rig.errors import InputError
from capture_rig.rig import Rig
from capture_rig.settings import build_settings
from rig_calibration.boards.board import Board
from rig_calibration.boards.specification import read_board

from .addresses import following
from .camera import SimulatedCamera
from .control import ControlServer, Request
from .loop import EventLoop
from .settings import CameraSettings
from .setup_scene import PERSON
from .shows import StudioSettings, make_show
from .stage import Stage
from .trigger_wire import TriggerWire


class Studio:
    """N simulated cameras in one process and one thread; start() and close(), or a context manager.

    ``cameras`` by name, in the rig's order; ``wire`` is the cable to their trigger inputs, ``stage`` what they see.
    Raises InputError for a session that cannot be read, or an address that is taken.
    """

    def __init__(self, settings: StudioSettings | None = None, control: str | Path | None = None) -> None:
        self.settings = settings or StudioSettings()
        self._show = make_show(self.settings)
        self._control_path = Path(control) if control else None
        self._control: ControlServer | None = None
        self.loop = EventLoop("studio")
        self.wire = TriggerWire(self.loop)
        names = self._show.rig.names
        addresses = following(self.settings.address, len(names))
        self.cameras = {
            name: SimulatedCamera(
                address, self._show.views[name], self._camera_settings(number, name), loop=self.loop, wire=self.wire
            )
            for number, (name, address) in enumerate(zip(names, addresses, strict=True), start=1)
        }

    @property
    def rig(self) -> Rig:
        return self._show.rig

    @property
    def stage(self) -> Stage | None:
        """The stage, which can be emptied and played from the start; None for the test pattern."""
        return self._show.stage

    @property
    def can_be_empty(self) -> bool:
        return self._show.can_be_empty

    @property
    def is_calibrated(self) -> bool:
        """Do the users of these cameras know their calibration? Not while they set them up."""
        return self._show.phases is None

    @property
    def boards(self) -> tuple[Board, Board]:
        """Of a set-up: the board that is waved before the cameras, and the one on the floor."""
        return read_board(self.settings.hand_board), read_board(self.settings.floor_board)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know about what is shown."""
        return self._show.notes

    @property
    def frame_rate(self) -> float:
        """Frame rate of the cameras at power-on, Hz."""
        if self.settings.frame_rate:
            return self.settings.frame_rate
        return self.stage.fps if self.stage is not None and self.settings.session else 60.0

    def start(self) -> Studio:
        """Every camera on, or none."""
        self.loop.start()
        try:
            self._show.start()
            for camera in self.cameras.values():
                camera.start()
            if self._control_path is not None:
                self._control = ControlServer(self._control_path, self.loop, self.handle)
        except InputError:
            self.close()
            raise
        return self

    def close(self) -> None:
        """Every camera off."""
        if self._control is not None:
            self._control.close()
            self._control = None
        for camera in self.cameras.values():
            camera.close()
        self._show.close()
        self.loop.stop()

    def handle(self, request: Request) -> Request:
        """Answer one request of the control channel. Raises InputError for one that makes no sense."""
        verbs = {
            "status": self._status,
            "set": self._set,
            "clear": self._clear,
            "off": self._power,
            "on": self._power,
            "room": self._room,
            "play": self._play,
            "hold": self._hold,
            "pulse": self._pulse,
            "wire": self._wire,
            "show": self._switch,
        }
        verb = request.get("do")
        if verb not in verbs:
            raise InputError(
                f"'{verb}' is nothing a studio does", where="studio", remedy=f"It does {', '.join(verbs)}."
            )
        return verbs[verb](request)

    def __enter__(self) -> Studio:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _camera_settings(self, number: int, name: str) -> CameraSettings:
        given = self.settings.camera
        changes: dict[str, Any] = {
            "serial": f"STUDIO{number:03d}",
            "user_id": name,
            "seed": given.seed + number,
            "frame_rate": self.frame_rate,
            "drift_ppm": given.drift_ppm + 3.0 * number,
        }
        return build_settings(CameraSettings, {**_plain(given), **changes}, f"camera {name}")

    def _chosen(self, request: Request) -> list[SimulatedCamera]:
        """The cameras that a request names; all, where it names none."""
        names = request.get("cameras") or list(self.cameras)
        unknown = [name for name in names if name not in self.cameras]
        if unknown:
            raise InputError(
                f"there is no camera {', '.join(map(str, unknown))}",
                where="studio",
                remedy=f"Known cameras: {', '.join(self.cameras)}.",
            )
        return [self.cameras[name] for name in names]

    def _status(self, request: Request) -> Request:
        stage = self.stage
        state: Request = {"cameras": {name: camera.status() for name, camera in self.cameras.items()}}
        if stage is not None:
            state["stage"] = {
                "occupied": stage.occupied,
                "epoch_ns": stage.epoch_ns,
                "frames": stage.frames,
                "fps": stage.fps,
                "loop": stage.loop,
            }
        if self._show.phases is not None:
            state["shows"] = self._show.phases.phase
        return state | ({"room": dict(self._show.counters)} if self._show.counters is not None else {})

    def _set(self, request: Request) -> Request:
        changes = request.get("faults")
        if not isinstance(changes, dict):
            raise InputError("no faults are named", where="studio", remedy="Such as packet_loss=0.005.")
        for camera in self._chosen(request):
            camera.faults.update(changes, f"camera {camera.address}")
        return {"set": changes}

    def _clear(self, request: Request) -> Request:
        for camera in self._chosen(request):
            camera.faults.clear()
        return {"cleared": True}

    def _power(self, request: Request) -> Request:
        for camera in self._chosen(request):
            if request["do"] == "on":
                camera.power_on()
            else:
                camera.power_off()
        return {"power": request["do"]}

    def _room(self, request: Request) -> Request:
        if request.get("state") not in ("empty", "occupied"):
            raise InputError(
                f"the room cannot be {request.get('state')!r}", where="studio", remedy="It can be empty or occupied."
            )
        occupied = request["state"] == "occupied"
        if not occupied and not self.can_be_empty:
            raise InputError(
                "nobody knows what the empty room looks like",
                where="studio",
                remedy="Use a session with a background for every camera.",
            )
        self._playing_stage().occupy(occupied)
        return {"room": request["state"]}

    def _play(self, request: Request) -> Request:
        stage = self._playing_stage()
        if self._show.phases is not None:
            self._show.phases.show(PERSON)
        epoch_ns = stage.play(request.get("at_ns"), bool(request.get("loop", True)))
        if not stage.occupied:
            stage.occupy(True)
        return {"epoch_ns": epoch_ns, "frames": stage.frames, "fps": stage.fps}

    def _switch(self, request: Request) -> Request:
        if self._show.phases is None:
            raise InputError("it shows no set-up", where="studio", remedy="Start one: sagoma studio --scene setup.")
        return {"shows": self._show.phases.show(str(request.get("phase")))}

    def _hold(self, request: Request) -> Request:
        self._playing_stage().hold()
        return {"held": True}

    def _pulse(self, request: Request) -> Request:
        return {"instant_ns": self.wire.pulse()}

    def _wire(self, request: Request) -> Request:
        rate = request.get("rate", 0)
        if not isinstance(rate, int | float) or not 0 <= rate <= 1000:
            raise InputError(f"rate = {rate!r} Hz", where="studio", remedy="Give 0 (no pulses) to 1000.")
        if rate:
            self.wire.run(rate)
        else:
            self.wire.stop()
        return {"rate": rate}

    def _playing_stage(self) -> Stage:
        if self.stage is None:
            raise InputError("a test pattern has no stage", where="studio", remedy="Show a session or the room.")
        return self.stage


def _plain(settings: CameraSettings) -> dict[str, Any]:
    return dict(vars(replace(settings)))
