"""A studio: the simulated cameras of a rig in one process, which see one scene and expose in step.

The scene is a session's footage, the built-in room with a person or a set-up in it, rendered live, or a test pattern.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.session import load_session
from capture_rig.settings import setting
from capture_rig.stamps import CaptureClock
from rig_calibration.boards.board import board_text, read_board

from ..recording.footage import FLOOR_BOARD, HAND_BOARD
from ..rig import ring
from .acquisition import TriggerWire
from .device import NO_FAULTS, CameraSettings, consecutive_addresses
from .loop import EventLoop, Request, serve_requests
from .rendered_scenes import PERSON, RoomScene, SetupScene
from .scenes import PatternScene, Playback, StudioScene, load_session_scene
from .simulated_camera import SimulatedCamera

PERSON_SCENE, SETUP_SCENE = "person", "setup"


@dataclass(frozen=True)
class StudioSettings:
    """Settings of a studio. Without a session the built-in person moves in the built-in room, rendered live."""

    session: str = setting("", "Session folder whose footage the cameras see")
    cameras: int = setting(5, "Cameras of the built-in rig, the last one on the ceiling", low=1, high=32)
    scene: str = setting(
        PERSON_SCENE,
        "What goes on in the built-in room: a person moves, or a set-up in phases",
        choices=(PERSON_SCENE, SETUP_SCENE),
    )
    pattern: bool = setting(False, "Show a test pattern instead, which carries frame number and time")
    address: str = setting("127.0.1.1", "Loopback address of the first camera; the others follow")
    frame_rate: float = setting(0.0, "Frame rate at power-on; 0: the session's, else 60", unit="Hz", low=0, high=1000)
    speed: float = setting(
        1.0, "Of the cameras' clock and of all that moves; below 1: slow motion", unit="s a second", low=1 / 32, high=1
    )
    motion: str = setting("tour", "What the built-in person does", choices=("tour", "walk", "t_pose_only"))
    memory_mb: float = setting(800.0, "Memory for a session's pictures", unit="MB", low=1)
    hand_board: str = setting(board_text(HAND_BOARD), "Of a set-up: the board that is waved before each camera")
    floor_board: str = setting(board_text(FLOOR_BOARD), "Of a set-up: the board on the floor, which is also carried")
    camera: CameraSettings = field(default_factory=CameraSettings)


def make_studio_scene(settings: StudioSettings) -> StudioScene:
    """Makes the scene that the settings name. Raises InputError for a session or board that cannot be read."""
    clock = CaptureClock(settings.speed)
    if settings.session and not settings.pattern:
        return load_session_scene(load_session(settings.session), settings.memory_mb, clock)
    rig = ring(settings.cameras - 1) if settings.cameras > 1 else ring(1, ceiling=False)
    if settings.pattern:
        return StudioScene(rig, {camera.name: PatternScene(camera.width, camera.height) for camera in rig.cameras})
    if settings.scene != SETUP_SCENE:
        return RoomScene(rig, settings.motion, clock=clock)
    hand, floor = read_board(settings.hand_board), read_board(settings.floor_board)
    return SetupScene(rig, settings.motion, clock=clock, hand_board=hand, floor_board=floor)


class Studio:
    """Runs N simulated cameras in one process and one thread; start() and close(), or a context manager.

    ``cameras`` by name, in the rig's order; ``wire`` is the cable to their trigger inputs, ``scene`` their scene,
    ``setup`` the same if it is a set-up, whose cameras are still to be calibrated.
    Raises InputError for a session that cannot be read, or an address that is in use.
    """

    def __init__(self, settings: StudioSettings | None = None, control: str | Path | None = None) -> None:
        self.settings = settings or StudioSettings()
        self.scene = make_studio_scene(self.settings)
        self.rig, self.playback = self.scene.rig, self.scene.playback
        self.setup = self.scene if isinstance(self.scene, SetupScene) else None
        self._control_path = Path(control) if control else None
        self._listening = False
        self.loop = EventLoop("studio", CaptureClock(self.settings.speed))
        self.wire = TriggerWire(self.loop)
        addresses = consecutive_addresses(self.settings.address, len(self.rig.names))
        given = self.settings.camera
        self.cameras: dict[str, SimulatedCamera] = {}
        for number, (name, address) in enumerate(zip(self.rig.names, addresses, strict=True), start=1):
            camera = replace(
                given,
                serial=f"STUDIO{number:03d}",
                user_id=name,
                seed=given.seed + number,
                frame_rate=self.frame_rate,
                drift_ppm=given.drift_ppm + 3.0 * number,
            )
            view = self.scene.views[name]
            self.cameras[name] = SimulatedCamera(address, view, camera, loop=self.loop, wire=self.wire)

    @property
    def frame_rate(self) -> float:
        """Frame rate of the cameras at power-on, Hz."""
        if self.settings.frame_rate:
            return self.settings.frame_rate
        return self.playback.fps if self.playback is not None and self.settings.session else 60.0

    def start(self) -> Studio:
        self.loop.start()
        try:
            self.scene.start()
            for camera in self.cameras.values():
                camera.start()
            if self._control_path is not None:
                serve_requests(self._control_path, self.loop, self.handle)
                self._listening = True
        except InputError:
            self.close()
            raise
        return self

    def close(self) -> None:
        if self._listening and self._control_path is not None:
            self._control_path.unlink(missing_ok=True)
        for camera in self.cameras.values():
            camera.close()
        self.scene.close()
        self.loop.stop()

    def handle(self, request: Request) -> Request:
        """Answers one request of the control channel. Raises InputError for an impossible one."""
        verbs = {
            "status": self._status,
            "set": self._set,
            "clear": self._set,
            "off": self._power,
            "on": self._power,
            "room": self._room,
            "play": self._play,
            "hold": self._hold,
            "wire": self._wire,
            "show": self._show,
        }
        verb = request.get("do")
        if verb not in verbs:
            raise _refusal(f"'{verb}' is nothing a studio does", f"It does {', '.join(verbs)}.")
        return verbs[verb](request)

    def __enter__(self) -> Studio:
        return self.start()

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _chosen(self, request: Request) -> list[SimulatedCamera]:
        """Return the cameras that a request names; all, where it names none."""
        names = request.get("cameras") or list(self.cameras)
        unknown = [name for name in names if name not in self.cameras]
        if unknown:
            remedy = f"Known cameras: {', '.join(self.cameras)}."
            raise _refusal(f"there is no camera {', '.join(map(str, unknown))}", remedy)
        return [self.cameras[name] for name in names]

    def _status(self, request: Request) -> Request:
        state: Request = {"cameras": {name: camera.status() for name, camera in self.cameras.items()}}
        if self.playback is not None:
            keys = ("occupied", "epoch_ns", "frames", "fps", "loop")
            state["playback"] = {key: getattr(self.playback, key) for key in keys}
        if self.setup is not None:
            state["shows"] = self.setup.phase
        return state

    def _set(self, request: Request) -> Request:
        changes = NO_FAULTS if request["do"] == "clear" else request.get("faults")
        if not isinstance(changes, dict):
            raise _refusal("no faults are named", "Such as packet_loss=0.005.")
        for camera in self._chosen(request):
            camera.faults.update(changes, f"camera {camera.address}")
        return {request["do"]: changes}

    def _power(self, request: Request) -> Request:
        for camera in self._chosen(request):
            (camera.power_on if request["do"] == "on" else camera.power_off)()
        return {"power": request["do"]}

    def _room(self, request: Request) -> Request:
        state = request.get("state")
        if state not in ("empty", "occupied"):
            raise _refusal(f"the room cannot be {state!r}", "It can be empty or occupied.")
        if state == "empty" and not self.scene.can_be_empty:
            remedy = "Use a session with a background for every camera."
            raise _refusal("the session has no pictures of the empty room", remedy)
        self._required_playback().occupied = state == "occupied"
        return {"room": state}

    def _play(self, request: Request) -> Request:
        playback = self._required_playback()
        if self.setup is not None:
            self.setup.show(PERSON)
        epoch_ns = playback.play(request.get("at_ns"), bool(request.get("loop", True)))
        playback.occupied = True
        return {"epoch_ns": epoch_ns, "frames": playback.frames, "fps": playback.fps}

    def _hold(self, request: Request) -> Request:
        self._required_playback().hold()
        return {"held": True}

    def _show(self, request: Request) -> Request:
        if self.setup is None:
            raise _refusal("it shows no set-up", "Start one: sagoma studio --scene setup.")
        return {"shows": self.setup.show(str(request.get("phase")))}

    def _wire(self, request: Request) -> Request:
        rate = request.get("rate", 0)
        if not isinstance(rate, int | float) or not 0 <= rate <= 1000:
            raise _refusal(f"rate = {rate!r} Hz", "Give 0 (no pulses) to 1000.")
        self.wire.run(rate)
        return {"rate": rate}

    def _required_playback(self) -> Playback:
        if self.playback is None:
            raise _refusal("a test pattern has no playback", "Show a session or the room.")
        return self.playback


def _refusal(what: str, remedy: str) -> InputError:
    return InputError(what, where="studio", remedy=remedy)
