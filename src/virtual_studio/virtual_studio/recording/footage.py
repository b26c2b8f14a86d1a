"""Writes what somebody films who sets up a room: footage for intrinsics, a board on the floor, a carried board.

intrinsics/camNN.mp4, floor/camNN.png, moving/camNN.mp4, [wand/camNN.mp4,] board.yaml (waved before each camera),
floor_board.yaml (the one on the floor, and carried); and, for scoring only, truth_rig.yaml and truth_floor.yaml.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

from capture_rig.camera import CameraModel
from capture_rig.rig import Rig, save_rig
from rig_calibration.boards.board import Board, CharucoBoard, Checkerboard
from stick_figure.body import Body

from ..people import VolumetricBody
from ..rendering.board_camera import FilmingCamera, Image, Optics
from ..rendering.board_caster import Array
from ..rendering.camera import Sensor
from ..scene.boards import BoardPrint, Wand, print_of
from ..scene.handling import carry, hands, on_floor, person_with, pose, swing, wave
from .files import FOOTAGE, MADE_BY, VideoFile, whole_folder
from .session import write_session

# --- Files beside what is filmed: the boards, which everybody knows; the rig and the floor's place, for scoring only.

BOARD_FILE, FLOOR_BOARD_FILE = "board.yaml", "floor_board.yaml"
TRUTH_RIG_FILE, TRUTH_FLOOR_FILE = "truth_rig.yaml", "truth_floor.yaml"


def save_truth(rig: Rig, hand_board: Board, floor_board: Board, folder: Path) -> None:
    """board.yaml, floor_board.yaml, truth_rig.yaml and truth_floor.yaml."""
    save_board(hand_board, folder / BOARD_FILE)
    save_board(floor_board, folder / FLOOR_BOARD_FILE)
    save_rig(rig, folder / TRUTH_RIG_FILE)
    printed = print_of(floor_board)
    T_world_floor = on_floor(printed) @ pose(np.eye(3), printed.middle_board)
    text = yaml.safe_dump({"T_world_floor": T_world_floor.tolist()}, default_flow_style=None)
    (folder / TRUTH_FLOOR_FILE).write_text(text, encoding="utf-8")


def save_board(board: Board, path: Path) -> None:
    """A board's description, as ``--board`` reads it."""
    kind = "charuco" if isinstance(board, CharucoBoard) else "checkerboard"
    entries = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(board).items()}
    path.write_text(yaml.safe_dump({"type": kind, **entries}, sort_keys=False), encoding="utf-8")


def read_truth_floor(folder: str | Path) -> Array:
    """T_world_floor (4, 4), m: where the middle of the floor board's corners lay, x along its rows, z up."""
    document = yaml.safe_load((Path(folder) / TRUTH_FLOOR_FILE).read_text(encoding="utf-8"))
    return np.array(document["T_world_floor"], float)


DESCRIPTION = "setup.yaml"
INTRINSICS, FLOOR, MOVING, WAND = "intrinsics", "floor", "moving", "wand"
FIRST_FRAME = {INTRINSICS: 0, FLOOR: 100_000, MOVING: 200_000, WAND: 300_000}
"""Numbers of the first frames as the sensor counts, so that no noise repeats."""
HAND_BOARD = Checkerboard(9, 6, (0.04, 0.04))
"""An A3 print: waved before each camera."""
FLOOR_BOARD = Checkerboard(7, 4, (0.12, 0.12))
"""An A0 print: large enough for cameras 3 m away that see it at 70 degrees from its normal."""


@dataclass(frozen=True)
class FootagePlan:
    """What is filmed, and how.

    hand_board : waved before each camera; floor_board : lies on the floor, and is carried. fps : of the videos.
    brief : half the places in front of each camera. stills : there one picture at each place (camNN/*.png) instead of
    a video. moving_s : how long the board is carried. wand : swung, too.
    seed, noise, flicker : see `Sensor`; blur_px, exposure_s : see `Optics`. stature_m : of who carries.
    """

    hand_board: Board = HAND_BOARD
    floor_board: Board = FLOOR_BOARD
    fps: float = 10.0
    brief: bool = False
    stills: bool = False
    moving_s: float = 24.0
    wand: Wand | None = None
    seed: int = 1
    noise: float = 3.0
    flicker: float = 0.005
    blur_px: float = 0.6
    exposure_s: float = 0.008
    stature_m: float = 1.75

    @property
    def optics(self) -> Optics:
        return Optics(Sensor(self.noise, self.flicker, self.seed), self.blur_px, self.exposure_s)


Progress = Callable[[str], None]


def write_calibration_footage(
    folder: str | Path, rig: Rig, plan: FootagePlan | None = None, progress: Progress = lambda what: None
) -> Path:
    """Films the boards with every camera of a rig, into ``folder``, which is returned.

    The same plan gives the same pictures. ``progress`` is told what was filmed. An older folder of this function is
    replaced. Raises InputError for a folder that holds anything else.
    """
    folder = Path(folder)
    with whole_folder(folder, DESCRIPTION) as partial:
        film_boards(partial, rig, plan or FootagePlan(), progress)
    return folder


def film_boards(folder: Path, rig: Rig, plan: FootagePlan, progress: Progress) -> None:
    """The same into a folder that is there, and empty."""
    hand, floor = print_of(plan.hand_board), print_of(plan.floor_board)
    save_truth(rig, plan.hand_board, plan.floor_board, folder)
    _write_description(folder / DESCRIPTION, plan)
    with ThreadPoolExecutor(min(len(rig.cameras), os.cpu_count() or 1)) as pool:
        crew = list(pool.map(lambda job: FilmingCamera(job[1], job[0], plan.optics), enumerate(rig.cameras)))
        for filming in pool.map(lambda camera: _film_waved(folder, camera, hand, plan), crew):
            progress(filming)
        _film_floor(folder, crew, floor)
        progress(FLOOR)
        _film_carried(folder, crew, floor, plan, pool)
        progress(MOVING)
        if plan.wand is not None:
            _film_wand(folder, crew, plan.wand, plan, pool)
            progress(WAND)


def _film_waved(folder: Path, camera: FilmingCamera, board: BoardPrint, plan: FootagePlan) -> str:
    name = camera.camera.name
    waved = wave(camera.camera, board, plan.seed + sum(name.encode()), plan.brief)
    if plan.stills:
        times = list(waved.rests_s)
    else:
        times = [(frame + 0.5) / plan.fps for frame in range(round(waved.duration_s * plan.fps))]
    pictures = (
        camera.take(FIRST_FRAME[INTRINSICS] + frame, board, waved.path, t, hands(board, waved.path(t)))
        for frame, t in enumerate(times)
    )
    if plan.stills:
        _save_stills(folder / INTRINSICS / name, pictures)
    else:
        with _videos(folder / INTRINSICS, [camera], plan.fps) as videos:
            for picture in pictures:
                videos[0].write(picture)
    return f"{INTRINSICS}/{name}"


def _save_stills(folder: Path, pictures: Iterator[Image]) -> None:
    folder.mkdir(parents=True)
    for number, picture in enumerate(pictures, start=1):
        cv2.imwrite(str(folder / f"{number:03d}.png"), picture)


def _film_floor(folder: Path, crew: Sequence[FilmingCamera], board: BoardPrint) -> None:
    lying = on_floor(board)
    (folder / FLOOR).mkdir()
    for camera in crew:
        picture = camera.take(FIRST_FRAME[FLOOR], board, lambda t: lying, 0.0)
        cv2.imwrite(str(folder / FLOOR / f"{camera.camera.name}.png"), picture)


def _film_carried(
    folder: Path, crew: Sequence[FilmingCamera], board: BoardPrint, plan: FootagePlan, pool: ThreadPoolExecutor
) -> None:
    path, person = carry(board, plan.moving_s, plan.seed), VolumetricBody(Body.from_stature(plan.stature_m))
    with _videos(folder / MOVING, crew, plan.fps) as videos:
        for frame in range(round(plan.moving_s * plan.fps)):
            t, number = (frame + 0.5) / plan.fps, FIRST_FRAME[MOVING] + frame
            holder = person_with(person, board, path(t))
            pictures = pool.map(lambda c, n=number, t=t, h=holder: c.take(n, board, path, t, h), crew)
            _write(videos, pictures)


def _film_wand(
    folder: Path, crew: Sequence[FilmingCamera], wand: Wand, plan: FootagePlan, pool: ThreadPoolExecutor
) -> None:
    path = swing(plan.moving_s, plan.seed)
    with _videos(folder / WAND, crew, plan.fps) as videos:
        for frame in range(round(plan.moving_s * plan.fps)):
            t, number = (frame + 0.5) / plan.fps, FIRST_FRAME[WAND] + frame
            _write(videos, pool.map(lambda c, n=number, t=t: c.take_wand(n, wand, path, t), crew))


def _write(videos: Sequence[VideoFile], pictures: Iterator[Image]) -> None:
    for video, picture in zip(videos, pictures, strict=True):
        video.write(picture)


@contextmanager
def _videos(folder: Path, crew: Sequence[FilmingCamera], fps: float) -> Iterator[list[VideoFile]]:
    folder.mkdir(exist_ok=True)
    with ExitStack() as stack:
        yield [
            stack.enter_context(VideoFile(folder / c.camera.name, FOOTAGE, fps, c.camera.width, c.camera.height))
            for c in crew
        ]


def _write_description(path: Path, plan: FootagePlan) -> None:
    recipe = {key: value for key, value in asdict(plan).items() if key not in ("hand_board", "floor_board")}
    document = {
        "made_by": MADE_BY,
        "source": "rendered by python -m virtual_studio setup",
        "fps": plan.fps,
        "recipe": {key: _plain(value) for key, value in recipe.items()},
    }
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    return list(value) if isinstance(value, tuple) else value


# --- A whole set-up in one folder, as somebody has it before anything is calibrated: boards, empty room, a person.
#
# What `footage` films, and session/ with camNN.mp4, camNN_background.mp4 and session.yaml: to be tracked, it lacks
# nothing but rig.yaml. For scoring only: truth.csv beside the other truths.

SESSION, TRUTH = "session", "truth.csv"


def write_setup(
    folder: str | Path,
    rig: Rig,
    plan: FootagePlan | None = None,
    *,
    motion: str = "tour",
    seconds: float = 6.0,
    fps: float = 60.0,
    progress: Progress = lambda what: None,
) -> Path:
    """Films the boards, the empty room and a person who does ``motion`` for so long at so many frames a second.

    Returns ``folder``. Raises InputError as `write_session` and `write_calibration_footage` do.
    """
    folder, plan = Path(folder), plan or FootagePlan()
    with whole_folder(folder, DESCRIPTION) as partial:
        film_boards(partial, rig, plan, progress)
        session, body = partial / SESSION, Body.from_stature(plan.stature_m)
        write_session(session, rig, body, motion, fps, seconds, plan.seed, plan.noise, flicker=plan.flicker)
        _hide_truth(session, partial / TRUTH)
        progress(SESSION)
    return folder


def _hide_truth(session: Path, truth: Path) -> None:
    """What nobody knows who starts: where the person was, the outline, the calibration, the sizes."""
    (session / "truth.csv").rename(truth)
    for path in [session / "rig.yaml", session / "body.yaml", *session.glob("*_mask.*")]:
        path.unlink()


# --- A calibration that was found, against the truth of what was filmed.


@dataclass(frozen=True)
class CameraErrors:
    """Of one camera: focal length (the worse one), principal point (the worse coordinate), optical centre, and the
    angle of the rotation between found and true orientation."""

    name: str
    focal_percent: float
    principal_px: float
    centre_mm: float
    rotation_deg: float


def camera_errors(found: Rig, truth: Rig, T_world_floor: Array) -> list[CameraErrors]:
    """Every camera's errors. Nothing is aligned: the world that was found lies in the middle of the floor board, and
    ``T_world_floor`` (4, 4) says where that was."""
    return [_errors_of(camera, truth.camera(camera.name), T_world_floor) for camera in found.cameras]


def _errors_of(found: CameraModel, true: CameraModel, T_world_floor: Array) -> CameraErrors:
    focal = np.abs(found.K.diagonal()[:2] / true.K.diagonal()[:2] - 1.0).max()
    principal = np.abs(found.K[:2, 2] - true.K[:2, 2]).max()
    R = true.R_camera_world @ T_world_floor[:3, :3] @ found.R_camera_world.T
    turned = np.arctan2(np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]), np.trace(R) - 1.0)
    centre_world = T_world_floor[:3, :3] @ found.centre_world + T_world_floor[:3, 3]
    away_mm = 1e3 * float(np.linalg.norm(centre_world - true.centre_world))
    return CameraErrors(found.name, 100.0 * float(focal), float(principal), away_mm, float(np.rad2deg(turned)))
