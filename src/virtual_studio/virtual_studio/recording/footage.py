"""Writes what setting up a room takes: footage for intrinsics, a board on the floor, a carried board, a person.

intrinsics/camNN.mp4, floor/camNN.png, moving/camNN.mp4, board.yaml (waved before each camera),
floor_board.yaml (the one on the floor, and carried), and session/ with camNN.mp4, camNN_background.mp4 and
session.yaml: to be tracked, it lacks nothing but rig.yaml. For scoring only: truth_rig.yaml, truth_floor.yaml and
truth.csv.
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

from capture_rig.camera import CameraModel
from capture_rig.files import replaced_folder
from capture_rig.rig import Rig, save_rig
from capture_rig.rigid import rotation_vector, transform
from capture_rig.video import VideoFile
from capture_rig.yaml_file import read_mapping, save_mapping
from rig_calibration.boards.board import Board, CharucoBoard, Checkerboard
from stick_figure.body import Body

from ..boards import Array, BoardPrint, carry, hands, on_floor, person_with, print_of, wave
from ..people import REFERENCE_STATURE_M, VolumetricBody
from ..rendering.board_camera import FilmingCamera
from ..rendering.camera import Sensor
from .session import FOOTAGE, MADE_BY, RenderSettings, is_own, write_session

DESCRIPTION = "setup.yaml"
INTRINSICS, FLOOR, MOVING = "intrinsics", "floor", "moving"
SESSION, TRUTH = "session", "truth.csv"
BOARD_FILE, FLOOR_BOARD_FILE = "board.yaml", "floor_board.yaml"
TRUTH_RIG_FILE, TRUTH_FLOOR_FILE = "truth_rig.yaml", "truth_floor.yaml"
FIRST_FRAME = {INTRINSICS: 0, FLOOR: 100_000, MOVING: 200_000}
"""Numbers of the first frames as the sensor counts, so that no noise repeats."""
HAND_BOARD = Checkerboard(9, 6, (0.04, 0.04))
"""An A3 print: waved before each camera."""
FLOOR_BOARD = Checkerboard(7, 4, (0.12, 0.12))
"""An A0 print: large enough for cameras 3 m away that see it at 70 degrees from its normal."""

SESSION_FPS = 60.0
"""Of the footage of who moves in the session."""

Progress = Callable[[str], None]


@dataclass(frozen=True)
class FootagePlan:
    """What is filmed, and how.

    hand_board : waved before each camera; floor_board : lies on the floor, and is carried. fps : of the videos.
    brief : half the places in front of each camera. moving_s : how long the board is carried.
    seed, noise, flicker : see `Sensor`.
    """

    hand_board: Board = HAND_BOARD
    floor_board: Board = FLOOR_BOARD
    fps: float = 10.0
    brief: bool = False
    moving_s: float = 24.0
    seed: int = 1
    noise: float = 3.0
    flicker: float = 0.005


def write_setup(
    folder: str | Path,
    rig: Rig,
    plan: FootagePlan | None = None,
    *,
    motion: str | None = "tour",
    seconds: float = 6.0,
    progress: Progress = lambda what: None,
) -> Path:
    """Films the boards, the empty room and a person who does ``motion``, with every camera of a rig, into ``folder``.

    Without a motion the boards alone. The same plan gives the same pictures. ``progress`` is called with what was
    filmed. An older folder of this function is replaced; returns ``folder``. Raises InputError for a folder that holds
    anything else, and as `write_session` does.
    """
    folder, plan = Path(folder), plan or FootagePlan()
    with replaced_folder(folder, lambda found: is_own(found, DESCRIPTION)) as partial:
        _film_boards(partial, rig, plan, progress)
        if motion is not None:
            _film_session(partial, rig, plan, motion, seconds)
            progress(SESSION)
    return folder


def _film_session(folder: Path, rig: Rig, plan: FootagePlan, motion: str, seconds: float) -> None:
    """Films the empty room and the person; what is unknown before the calibration does not stay there."""
    session, body = folder / SESSION, Body.from_stature(REFERENCE_STATURE_M)
    settings = RenderSettings(seed=plan.seed, noise=plan.noise, flicker=plan.flicker)
    write_session(session, rig, body, motion, SESSION_FPS, seconds, settings)
    (session / TRUTH).rename(folder / TRUTH)
    for path in [session / "rig.yaml", session / "body.yaml", *session.glob("*_mask.*")]:
        path.unlink()


def save_truth(rig: Rig, hand_board: Board, floor_board: Board, folder: Path) -> None:
    """Writes board.yaml, floor_board.yaml, truth_rig.yaml and truth_floor.yaml."""
    _save_board(hand_board, folder / BOARD_FILE)
    _save_board(floor_board, folder / FLOOR_BOARD_FILE)
    save_rig(rig, folder / TRUTH_RIG_FILE)
    printed = print_of(floor_board)
    T_world_floor = on_floor(printed) @ transform(np.eye(3), printed.middle_board)
    document = {"T_world_floor": T_world_floor.tolist()}
    save_mapping(folder / TRUTH_FLOOR_FILE, document, default_flow_style=None)


def read_truth_floor(folder: str | Path) -> Array:
    """Reads T_world_floor (4, 4), m: the middle of the floor board's corners, x along its rows, z up."""
    document = read_mapping(Path(folder) / TRUTH_FLOOR_FILE, "Film the set-up again.")
    return np.array(document["T_world_floor"], float)


@dataclass(frozen=True)
class CameraErrors:
    """Errors of one camera's calibration: focal length (the worse one), principal point (the worse coordinate),
    optical centre, and the angle of the rotation between found and true orientation."""

    name: str
    focal_percent: float
    principal_px: float
    centre_mm: float
    rotation_deg: float


def camera_errors(found: Rig, truth: Rig, T_world_floor: Array) -> list[CameraErrors]:
    """Compares a calibration with the truth. Nothing is aligned: the origin of the world that was found lies in the
    middle of the floor board, whose true pose is ``T_world_floor`` (4, 4)."""
    return [_errors_of(camera, truth.camera(camera.name), T_world_floor) for camera in found.cameras]


def _errors_of(found: CameraModel, true: CameraModel, T_world_floor: Array) -> CameraErrors:
    focal = np.abs(found.K.diagonal()[:2] / true.K.diagonal()[:2] - 1.0).max()
    principal = np.abs(found.K[:2, 2] - true.K[:2, 2]).max()
    turned = rotation_vector(true.R_camera_world @ T_world_floor[:3, :3] @ found.R_camera_world.T)
    centre_world = T_world_floor[:3, :3] @ found.centre_world + T_world_floor[:3, 3]
    centre_mm = 1e3 * float(np.linalg.norm(centre_world - true.centre_world))
    turned_deg = float(np.rad2deg(np.linalg.norm(turned)))
    return CameraErrors(found.name, 100.0 * float(focal), float(principal), centre_mm, turned_deg)


def _film_boards(folder: Path, rig: Rig, plan: FootagePlan, progress: Progress) -> None:
    """Films into a folder that is there, and empty."""
    hand, floor = print_of(plan.hand_board), print_of(plan.floor_board)
    save_truth(rig, plan.hand_board, plan.floor_board, folder)
    _write_description(folder / DESCRIPTION, plan)
    sensor = Sensor(plan.noise, plan.flicker, plan.seed)
    with ThreadPoolExecutor(min(len(rig.cameras), os.cpu_count() or 1)) as pool:
        cameras = list(pool.map(lambda job: FilmingCamera(job[1], job[0], sensor), enumerate(rig.cameras)))
        for filmed in pool.map(lambda camera: _film_waved(folder, camera, hand, plan), cameras):
            progress(filmed)
        _film_floor(folder / FLOOR, cameras, floor)
        progress(FLOOR)
        _film_carried(folder / MOVING, cameras, floor, plan, pool)
        progress(MOVING)


def _film_waved(folder: Path, camera: FilmingCamera, board: BoardPrint, plan: FootagePlan) -> str:
    name = camera.camera.name
    waved = wave(camera.camera, board, plan.seed + sum(name.encode()), plan.brief)
    with _videos(folder / INTRINSICS, [camera], plan.fps) as (video,):
        for frame in range(round(waved.duration_s * plan.fps)):
            t = (frame + 0.5) / plan.fps
            shot = FIRST_FRAME[INTRINSICS] + frame, board, waved.path, t, hands(board, waved.path(t))
            video.write(camera.take(*shot))
    return f"{INTRINSICS}/{name}"


def _film_floor(folder: Path, cameras: Sequence[FilmingCamera], board: BoardPrint) -> None:
    lying = on_floor(board)
    folder.mkdir()
    for camera in cameras:
        picture = camera.take(FIRST_FRAME[FLOOR], board, lambda t: lying, 0.0)
        cv2.imwrite(str(folder / f"{camera.camera.name}.png"), picture)


def _film_carried(
    folder: Path, cameras: Sequence[FilmingCamera], board: BoardPrint, plan: FootagePlan, pool: ThreadPoolExecutor
) -> None:
    path, person = carry(board, plan.moving_s, plan.seed), VolumetricBody(Body.from_stature(REFERENCE_STATURE_M))
    with _videos(folder, cameras, plan.fps) as videos:
        for frame in range(round(plan.moving_s * plan.fps)):
            t = (frame + 0.5) / plan.fps
            shot = FIRST_FRAME[MOVING] + frame, board, path, t, person_with(person, board, path(t))
            pictures = pool.map(lambda camera, shot=shot: camera.take(*shot), cameras)
            for video, picture in zip(videos, pictures, strict=True):
                video.write(picture)


@contextmanager
def _videos(folder: Path, cameras: Sequence[FilmingCamera], fps: float) -> Iterator[list[VideoFile]]:
    folder.mkdir(exist_ok=True)
    with ExitStack() as stack:
        yield [stack.enter_context(VideoFile(folder / f"{c.camera.name}{FOOTAGE}", fps)) for c in cameras]


def _save_board(board: Board, path: Path) -> None:
    """Writes a board's description, as ``--board`` reads it."""
    kind = "charuco" if isinstance(board, CharucoBoard) else "checkerboard"
    save_mapping(path, {"type": kind, **_plain(asdict(board))})


def _write_description(path: Path, plan: FootagePlan) -> None:
    recipe = {key: value for key, value in asdict(plan).items() if key not in ("hand_board", "floor_board")}
    source = "rendered by python -m virtual_studio setup"
    document = {"made_by": MADE_BY, "source": source, "fps": plan.fps, "recipe": _plain(recipe)}
    save_mapping(path, document)


def _plain(entries: dict) -> dict:
    """Return the entries with lists for tuples, which YAML knows."""
    return {
        key: _plain(value) if isinstance(value, dict) else list(value) if isinstance(value, tuple) else value
        for key, value in entries.items()
    }
