"""Files beside what is filmed: the boards, which everybody knows; the rig and the floor's place, for scoring only."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import yaml

from capture_rig.rig import Rig, save_rig
from rig_calibration.boards.board import Board, CharucoBoard

from .board_caster import Array
from .carrying import on_floor
from .paths import pose
from .prints import print_of

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
