"""What a studio shows: a session's footage, the built-in room with a person or a set-up in it, or a test pattern."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from capture_rig.rig import Rig
from capture_rig.session import load_session
from capture_rig.settings import setting
from rig_calibration.boards.specification import board_text, read_board

from ..calibration.footage import FLOOR_BOARD, HAND_BOARD
from ..rig import ring
from .live_scene import LiveScene
from .room_scene import RoomScene
from .scenes import CameraScene, PatternScene
from .session_scene import load_session_scene
from .settings import CameraSettings
from .setup_scene import SetupScene
from .stage import Stage

PERSON_SCENE, SETUP_SCENE = "person", "setup"


@dataclass(frozen=True)
class StudioSettings:
    """A studio and what it shows. Without a session the built-in person moves in the built-in room, rendered live."""

    session: str = setting("", "Session folder whose footage the cameras see")
    cameras: int = setting(5, "Cameras of the built-in rig, the last one on the ceiling", low=1, high=32)
    scene: str = setting(
        PERSON_SCENE,
        "What goes on in the built-in room: somebody moves, or a set-up in phases",
        choices=(PERSON_SCENE, SETUP_SCENE),
    )
    pattern: bool = setting(False, "Show a test pattern instead, which carries frame number and time")
    address: str = setting("127.0.1.1", "Loopback address of the first camera; the others follow")
    frame_rate: float = setting(0.0, "Frame rate at power-on; 0: the session's, else 60", unit="Hz", low=0, high=1000)
    motion: str = setting("tour", "What the built-in person does", choices=("tour", "walk", "t_pose_only"))
    render_hz: float = setting(20.0, "At most so many live renderings", unit="Hz", low=0.1, high=1000)
    memory_mb: float = setting(800.0, "Memory for a session's pictures", unit="MB", low=1)
    hand_board: str = setting(board_text(HAND_BOARD), "Of a set-up: the board that is waved before each camera")
    floor_board: str = setting(board_text(FLOOR_BOARD), "Of a set-up: the board on the floor, which is also carried")
    camera: CameraSettings = setting(CameraSettings, "Every camera; serial and user id are given by the studio")


@dataclass(frozen=True, eq=False)
class Show:
    """What the cameras see: their views by name, the stage behind them, what to start and to end with it."""

    rig: Rig
    views: Mapping[str, CameraScene]
    stage: Stage | None = None
    can_be_empty: bool = False
    notes: tuple[str, ...] = ()
    start: Callable[[], None] = lambda: None
    close: Callable[[], None] = lambda: None
    counters: Mapping[str, int] | None = None
    phases: SetupScene | None = None


def make_show(settings: StudioSettings) -> Show:
    """Raises InputError for a session that cannot be read, or a board that is none."""
    if settings.pattern:
        rig = built_in_rig(settings.cameras)
        return Show(rig, {camera.name: PatternScene(camera.width, camera.height) for camera in rig.cameras})
    if settings.session:
        return _session_show(settings)
    return _setup_show(settings) if settings.scene == SETUP_SCENE else _room_show(settings)


def _session_show(settings: StudioSettings) -> Show:
    session = load_session(settings.session)
    scene = load_session_scene(session, settings.memory_mb)
    played, total = scene.stage.frames, scene.total_frames
    cut = f"only the first {played} of {total} frames fit into {settings.memory_mb:g} MB and are shown (--memory)"
    notes = () if played >= total else (cut,)
    return Show(session.rig, scene.views, scene.stage, scene.can_be_empty, notes)


def _room_show(settings: StudioSettings) -> Show:
    rig = built_in_rig(settings.cameras)
    scene = RoomScene(rig, settings.motion, most_hz=settings.render_hz)
    return _live_show(rig, scene, settings.render_hz)


def _setup_show(settings: StudioSettings) -> Show:
    rig = built_in_rig(settings.cameras)
    boards = read_board(settings.hand_board), read_board(settings.floor_board)
    scene = SetupScene(rig, settings.motion, most_hz=settings.render_hz, hand_board=boards[0], floor_board=boards[1])
    return replace(_live_show(rig, scene, settings.render_hz), phases=scene)


def _live_show(rig: Rig, scene: LiveScene, most_hz: float) -> Show:
    note = f"rendered live, at most {most_hz:g} times a second: pictures in between are repeated"
    return Show(rig, scene.views, scene.stage, True, (note,), scene.start, scene.close, scene.counters)


def built_in_rig(cameras: int) -> Rig:
    """So many cameras, the last one on the ceiling; a single one stands."""
    return ring(cameras - 1, ceiling=True) if cameras > 1 else ring(1, ceiling=False)
