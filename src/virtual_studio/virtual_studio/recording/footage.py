"""Writes the footage of a room's set-up: for intrinsics, a board on the floor, a carried board, a person.

intrinsics/camNN.mp4, floor/camNN.png, moving/camNN.mp4, board.yaml (waved before each camera),
floor_board.yaml (the one on the floor, and carried), and session/ with camNN.mp4, camNN_background.mp4 and
session.yaml: only rig.yaml is missing for tracking. For scoring only: truth_rig.yaml, truth_floor.yaml and truth.csv.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from capture_rig.files import replaced_folder
from capture_rig.rig import Rig, save_rig
from capture_rig.rigid import rotation_vector, transform
from capture_rig.video import VideoFile
from capture_rig.yaml_file import read_mapping, save_mapping
from rig_calibration.boards.board import Board, CharucoBoard, Checkerboard
from stick_figure.body import TYPICAL_STATURE_M, Body

from ..boards import Array, BoardPrint, PosePath, carry, hands, on_floor, person_with, print_of, wave
from ..people import Capsules, VolumetricBody
from ..rendering.board_camera import BoardCamera
from ..rendering.camera import Image, Sensor
from .session import FOOTAGE, MADE_BY, SESSION_FPS, RenderSettings, is_own, write_session

DESCRIPTION = "setup.yaml"
INTRINSICS, FLOOR, MOVING = "intrinsics", "floor", "moving"
SESSION, TRUTH = "session", "truth.csv"
BOARD_FILE, FLOOR_BOARD_FILE = "board.yaml", "floor_board.yaml"
TRUTH_RIG_FILE, TRUTH_FLOOR_FILE = "truth_rig.yaml", "truth_floor.yaml"
FIRST_FRAME = {INTRINSICS: 0, FLOOR: 100_000, MOVING: 200_000}
"""Numbers of the first frames for the sensor's noise, so that none repeats."""
HAND_BOARD = Checkerboard(9, 6, (0.04, 0.04))
"""An A3 print: waved before each camera."""
FLOOR_BOARD = Checkerboard(7, 4, (0.12, 0.12))
"""An A0 print: large enough for cameras 3 m away that see it at 70 degrees from its normal."""

Progress = Callable[[str], None]


@dataclass(frozen=True)
class FootagePlan:
    """Plan of the footage.

    hand_board : waved before each camera; floor_board : lies on the floor, and is carried. fps : of the videos.
    brief : half the places in front of each camera. moving_s : time of carrying the board.
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

    Without a motion the boards alone. The same plan gives the same pictures. ``progress`` is called with the name of
    each finished film. An older folder of this function is replaced; returns ``folder``. Raises InputError for a folder
    that holds anything else, and as `write_session` does.
    """
    folder, plan = Path(folder), plan or FootagePlan()
    with replaced_folder(folder, lambda found: is_own(found, DESCRIPTION)) as partial:
        save_truth(rig, plan.hand_board, plan.floor_board, partial)
        recipe = {key: value for key, value in asdict(plan).items() if key not in ("hand_board", "floor_board")}
        source = "rendered by python -m virtual_studio setup"
        description = {"made_by": MADE_BY, "source": source, "fps": plan.fps, "recipe": recipe}
        save_mapping(partial / DESCRIPTION, description)
        with ThreadPoolExecutor(min(len(rig.cameras), os.cpu_count() or 1)) as pool:
            films = _BoardFilms(partial, rig, plan, pool)
            for filmed in pool.map(films.film_waved, range(len(rig.cameras))):
                progress(filmed)
            films.film_floor()
            progress(FLOOR)
            films.film_carried()
            progress(MOVING)
        if motion is not None:
            session, body = partial / SESSION, Body.from_stature(TYPICAL_STATURE_M)
            settings = RenderSettings(seed=plan.seed, noise=plan.noise, flicker=plan.flicker)
            write_session(session, rig, body, motion, SESSION_FPS, seconds, settings)
            (session / TRUTH).rename(partial / TRUTH)
            for path in [session / "rig.yaml", session / "body.yaml", *session.glob("*_mask.*")]:
                path.unlink()  # unknown before the calibration
            progress(SESSION)
    return folder


def save_truth(rig: Rig, hand_board: Board, floor_board: Board, folder: Path) -> None:
    """Writes board.yaml, floor_board.yaml, truth_rig.yaml and truth_floor.yaml."""
    for name, board in ((BOARD_FILE, hand_board), (FLOOR_BOARD_FILE, floor_board)):
        kind = "charuco" if isinstance(board, CharucoBoard) else "checkerboard"
        save_mapping(folder / name, {"type": kind, **asdict(board)})
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
    errors = []
    for camera in found.cameras:
        true = truth.camera(camera.name)
        focal = np.abs(camera.K.diagonal()[:2] / true.K.diagonal()[:2] - 1.0).max()
        principal = np.abs(camera.K[:2, 2] - true.K[:2, 2]).max()
        turned = rotation_vector(true.R_camera_world @ T_world_floor[:3, :3] @ camera.R_camera_world.T)
        centre_world = T_world_floor[:3, :3] @ camera.centre_world + T_world_floor[:3, 3]
        centre_mm = 1e3 * float(np.linalg.norm(centre_world - true.centre_world))
        turned_deg = float(np.rad2deg(np.linalg.norm(turned)))
        errors.append(CameraErrors(camera.name, 100.0 * float(focal), float(principal), centre_mm, turned_deg))
    return errors


class _BoardFilms:
    """Films boards with every camera of a rig into a folder that is there, and empty."""

    def __init__(self, folder: Path, rig: Rig, plan: FootagePlan, pool: ThreadPoolExecutor) -> None:
        self._folder, self._plan, self._pool = folder, plan, pool
        self._hand, self._floor = print_of(plan.hand_board), print_of(plan.floor_board)
        self._cameras = list(pool.map(BoardCamera, rig.cameras))
        self._sensor = Sensor(plan.noise, plan.flicker, plan.seed)

    def film_waved(self, number: int) -> str:
        """Film the board that is waved before one camera; returns the film's name."""
        camera, plan = self._cameras[number].camera, self._plan
        waved = wave(camera, self._hand, plan.seed + sum(camera.name.encode()), plan.brief)
        with VideoFile(self._folder / INTRINSICS / f"{camera.name}{FOOTAGE}", plan.fps) as video:
            for frame in range(round(waved.duration_s * plan.fps)):
                t = (frame + 0.5) / plan.fps
                held = hands(self._hand, waved.path(t))
                video.write(self._expose(number, FIRST_FRAME[INTRINSICS] + frame, self._hand, waved.path, t, held))
        return f"{INTRINSICS}/{camera.name}"

    def film_floor(self) -> None:
        """Film the board on the floor with every camera."""
        lying = on_floor(self._floor)
        (self._folder / FLOOR).mkdir()
        for number, camera in enumerate(self._cameras):
            picture = self._expose(number, FIRST_FRAME[FLOOR], self._floor, lambda t: lying, 0.0)
            cv2.imwrite(str(self._folder / FLOOR / f"{camera.camera.name}.png"), picture)

    def film_carried(self) -> None:
        """Film the board that is carried through the volume with every camera."""
        plan, board, path = self._plan, self._floor, carry(self._floor, self._plan.moving_s, self._plan.seed)
        person = VolumetricBody(Body.from_stature(TYPICAL_STATURE_M))
        names = [f"{camera.camera.name}{FOOTAGE}" for camera in self._cameras]
        with ExitStack() as stack:
            videos = [stack.enter_context(VideoFile(self._folder / MOVING / name, plan.fps)) for name in names]
            for frame in range(round(plan.moving_s * plan.fps)):
                t = (frame + 0.5) / plan.fps
                shot = FIRST_FRAME[MOVING] + frame, board, path, t, person_with(person, board, path(t))
                pictures = self._pool.map(lambda number, shot=shot: self._expose(number, *shot), range(len(videos)))
                for video, picture in zip(videos, pictures, strict=True):
                    video.write(picture)

    def _expose(
        self, number: int, frame: int, board: BoardPrint, path: PosePath, t: float, people: Capsules | None = None
    ) -> Image:
        """Return a camera's picture of a board on its path at time t (the middle of the exposure), s."""
        return self._sensor.expose(self._cameras[number].film(board, path, t, people), number, frame)
