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
import yaml

from capture_rig.rig import Rig
from rig_calibration.boards.board import Board, Checkerboard
from stick_figure.body import Body

from ..body import VolumetricBody
from ..sensor import Sensor
from ..video import FOOTAGE, VideoFile
from ..whole_folder import MADE_BY, whole_folder
from .carrying import carry, on_floor, swing
from .hands import hands, person_with
from .photographer import Image, Optics, Photographer
from .prints import BoardPrint, print_of
from .truth_files import save_truth
from .wand import Wand
from .waving import wave

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
        crew = list(pool.map(lambda job: Photographer(job[1], job[0], plan.optics), enumerate(rig.cameras)))
        for filming in pool.map(lambda camera: _film_waved(folder, camera, hand, plan), crew):
            progress(filming)
        _film_floor(folder, crew, floor)
        progress(FLOOR)
        _film_carried(folder, crew, floor, plan, pool)
        progress(MOVING)
        if plan.wand is not None:
            _film_wand(folder, crew, plan.wand, plan, pool)
            progress(WAND)


def _film_waved(folder: Path, camera: Photographer, board: BoardPrint, plan: FootagePlan) -> str:
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


def _film_floor(folder: Path, crew: Sequence[Photographer], board: BoardPrint) -> None:
    lying = on_floor(board)
    (folder / FLOOR).mkdir()
    for camera in crew:
        picture = camera.take(FIRST_FRAME[FLOOR], board, lambda t: lying, 0.0)
        cv2.imwrite(str(folder / FLOOR / f"{camera.camera.name}.png"), picture)


def _film_carried(
    folder: Path, crew: Sequence[Photographer], board: BoardPrint, plan: FootagePlan, pool: ThreadPoolExecutor
) -> None:
    path, person = carry(board, plan.moving_s, plan.seed), VolumetricBody(Body.from_stature(plan.stature_m))
    with _videos(folder / MOVING, crew, plan.fps) as videos:
        for frame in range(round(plan.moving_s * plan.fps)):
            t, number = (frame + 0.5) / plan.fps, FIRST_FRAME[MOVING] + frame
            holder = person_with(person, board, path(t))
            pictures = pool.map(lambda c, n=number, t=t, h=holder: c.take(n, board, path, t, h), crew)
            _write(videos, pictures)


def _film_wand(
    folder: Path, crew: Sequence[Photographer], wand: Wand, plan: FootagePlan, pool: ThreadPoolExecutor
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
def _videos(folder: Path, crew: Sequence[Photographer], fps: float) -> Iterator[list[VideoFile]]:
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
