"""python -m virtual_studio setup FOLDER: film everything that setting up a room takes."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace

from capture_rig.errors import InputError
from rig_calibration.boards.specification import board_text, read_board

from ..rig import ring
from ..scene.boards import Wand
from .footage import FLOOR_BOARD, HAND_BOARD, FootagePlan, write_setup

QUICK_FPS, QUICK_MOVING_S = 6.0, 16.0


def main(arguments: list[str]) -> int:
    """Returns the exit code: 0, or 2 with one clear line on standard error."""
    options = _parser().parse_args(arguments)
    started = time.monotonic()
    try:
        rig = ring(options.cameras - options.ceiling, options.ceiling)
        folder = write_setup(
            options.folder,
            rig,
            plan_of(options),
            motion=options.motion,
            seconds=options.seconds,
            progress=_say if sys.stderr.isatty() else lambda what: None,
        )
    except InputError as error:
        print(f"virtual_studio: {error}", file=sys.stderr)
        return 2
    print(f"{folder}: {len(rig.cameras)} cameras in {time.monotonic() - started:.0f} s; now:")
    for line in next_steps(options):
        print(f"  {line}")
    return 0


def plan_of(options: argparse.Namespace) -> FootagePlan:
    """Raises InputError for a text that describes no board."""
    plan = FootagePlan(
        hand_board=read_board(options.board),
        floor_board=read_board(options.floor_board),
        wand=Wand() if options.wand else None,
        seed=options.seed,
        noise=options.noise,
    )
    return replace(plan, brief=True, fps=QUICK_FPS, moving_s=QUICK_MOVING_S) if options.quick else plan


def next_steps(options: argparse.Namespace) -> list[str]:
    """The commands that calibrate and track what was filmed."""
    folder = options.folder
    return [
        f"sagoma calibrate intrinsics {folder}/intrinsics --board {folder}/board.yaml --output {folder}/lenses",
        f"sagoma calibrate extrinsics --intrinsics {folder}/lenses --board {folder}/floor_board.yaml"
        f" --floor {folder}/floor --moving {folder}/moving --output {folder}/session/rig.yaml",
        f"sagoma up {folder}/session",
    ]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m virtual_studio setup",
        description="Film what setting up a room takes: boards before each camera, on the floor and carried, the empty "
        "room, a person. The truth lies apart, in truth*.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("folder", help="folder to write (new, empty, or an older one of this command)")
    parser.add_argument("--cameras", type=int, default=6, help="number of cameras in all")
    parser.add_argument(
        "--ceiling", action=argparse.BooleanOptionalAction, default=True, help="the last camera hangs from the ceiling"
    )
    parser.add_argument("--board", default=board_text(HAND_BOARD), help="waved before each camera")
    parser.add_argument("--floor-board", default=board_text(FLOOR_BOARD), help="on the floor, and carried")
    parser.add_argument("--wand", action="store_true", help="swing a wand of three balls, too")
    parser.add_argument("--motion", default="tour", help="what the person does")
    parser.add_argument("--seconds", type=float, default=6.0, help="length of the session, s")
    parser.add_argument("--quick", action="store_true", help="fewer places and frames of the boards")
    parser.add_argument("--seed", type=int, default=1, help="of noise, flicker and hands")
    parser.add_argument("--noise", type=float, default=3.0, help="standard deviation of a pixel, grey levels")
    return parser


def _say(what: str) -> None:
    print(f"filmed {what}", file=sys.stderr, flush=True)
