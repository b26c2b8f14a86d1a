"""python -m virtual_studio FOLDER: render a session of the built-in person; setup FOLDER: film boards as well."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.settings import FRAME_RATE, number
from rig_calibration.boards.board import board_text, read_board
from stick_figure.body import STATURES_M, TYPICAL_STATURE_M, Body

from .motions.catalogue import MOTIONS, MotionFunction
from .motions.recorded import RecordedMotion, is_motion_file
from .motions.together import TOGETHER
from .people import BUILDS, OUTFITS, people_of_sizes
from .recording.footage import FLOOR_BOARD, HAND_BOARD, FootagePlan, write_setup
from .recording.session import SESSION_FPS, RenderSettings, write_scene, write_session
from .rig import HEIGHT_PX, WIDTH_PX, ring

QUICK_FPS, QUICK_MOVING_S = 6.0, 16.0
SIDE = number("pixels", 160, 8192, whole=True)
SECONDS = number("s", 0.1, 3600)


def image_size(text: str) -> tuple[int, int]:
    """Returns width and height of "WIDTHxHEIGHT", pixels; argparse.ArgumentTypeError for anything else."""
    width, _, height = text.partition("x")
    return int(SIDE(width)), int(SIDE(height))


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code: 0, or 2 with one clear line on standard error."""
    arguments = sys.argv[1:] if arguments is None else arguments
    is_setup = arguments[:1] == ["setup"]
    options = _setup_parser().parse_args(arguments[1:]) if is_setup else _session_parser().parse_args(arguments)
    try:
        return _setup(options) if is_setup else _session(options)
    except InputError as error:
        print(f"virtual_studio: {error}", file=sys.stderr)
        return 2


def _session(options: argparse.Namespace) -> int:
    started = time.monotonic()
    rig = ring(options.cameras - options.ceiling, options.ceiling, options.size)
    body = Body.from_stature(options.stature)
    look = RenderSettings(seed=options.seed, noise=options.noise, shadow=options.shadow, build=options.build)
    progress = _show_progress if sys.stderr.isatty() else lambda done, total: None
    if options.motion in TOGETHER:
        cast, worn = people_of_sizes(len(TOGETHER[options.motion].roles)), [*OUTFITS.values()]
        folder = write_scene(options.folder, rig, options.motion, cast, worn, options.fps, look, progress)
        print(f"{folder}: {len(rig.cameras)} cameras, {len(cast)} persons in {time.monotonic() - started:.1f} s")
        return 0
    motion: str | MotionFunction = options.motion
    if is_motion_file(options.motion):
        motion = RecordedMotion(Path(options.motion), options.motion_up)
    folder = write_session(options.folder, rig, body, motion, options.fps, options.seconds, look, progress)
    frames = len((folder / "truth.csv").read_text(encoding="utf-8").splitlines()) - 1
    print(f"{folder}: {len(rig.cameras)} cameras x {frames} frames in {time.monotonic() - started:.1f} s")
    return 0


def _setup(options: argparse.Namespace) -> int:
    started = time.monotonic()
    rig = ring(options.cameras - options.ceiling, options.ceiling, options.size)
    hand, floor = read_board(options.board), read_board(options.floor_board)
    plan = FootagePlan(hand_board=hand, floor_board=floor, seed=options.seed, noise=options.noise)
    if options.quick:
        plan = replace(plan, brief=True, fps=QUICK_FPS, moving_s=QUICK_MOVING_S)
    progress = partial(print, "filmed", file=sys.stderr, flush=True) if sys.stderr.isatty() else lambda what: None
    folder = write_setup(options.folder, rig, plan, motion=options.motion, seconds=options.seconds, progress=progress)
    print(f"{folder}: {len(rig.cameras)} cameras in {time.monotonic() - started:.0f} s; now:")
    given = options.folder
    print(f"  sagoma calibrate intrinsics {given}/intrinsics --board {given}/board.yaml --output {given}/lenses")
    print(
        f"  sagoma calibrate extrinsics --intrinsics {given}/lenses --board {given}/floor_board.yaml"
        f" --floor {given}/floor --moving {given}/moving --output {given}/session/rig.yaml"
    )
    print(f"  sagoma up {given}/session")
    return 0


def _session_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m virtual_studio",
        description="Render a session of the built-in person: videos, empty room, exact silhouettes, rig, truth.",
        epilog="python -m virtual_studio setup FOLDER films calibration boards as well (--help tells more)",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    option = parser.add_argument
    option("folder", help="session folder to write (new, empty, or an older session of this tool)")
    motions = f"what the person does: {', '.join(MOTIONS)}; or a BVH file; or what several do: {', '.join(TOGETHER)}"
    _add_common_arguments(parser, motions, "of noise and flicker")
    option("--seconds", type=SECONDS, default=6.0, help="length, s (of a file: at most); first a T-pose")
    option("--fps", type=FRAME_RATE, default=SESSION_FPS, help="frames a second")
    option("--motion-up", default="y", help="the file's axis that points up")
    option("--stature", type=number("m", *STATURES_M), default=TYPICAL_STATURE_M, help="standing height, m")
    option("--build", type=number("times the average", *BUILDS), default=1.0, help="thickness of the body")
    option("--shadow", action=argparse.BooleanOptionalAction, default=True, help="shadow on the floor")
    return parser


def _setup_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m virtual_studio setup",
        description="Film what setting up a room takes: boards before each camera, on the floor and carried, the empty "
        "room, a person. The truth lies apart, in truth*.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    option = parser.add_argument
    option("folder", help="folder to write (new, empty, or an older one of this command)")
    _add_common_arguments(parser, "what the person does", "of noise, flicker and hands")
    option("--seconds", type=SECONDS, default=6.0, help="length of the session, s")
    option("--board", default=board_text(HAND_BOARD), help="waved before each camera")
    option("--floor-board", default=board_text(FLOOR_BOARD), help="on the floor, and carried")
    option("--quick", action="store_true", help="fewer places and frames of the boards")
    return parser


def _add_common_arguments(parser: argparse.ArgumentParser, motion: str, seed: str) -> None:
    option, ceiling, size = parser.add_argument, "the last camera hangs from the ceiling", f"{WIDTH_PX}x{HEIGHT_PX}"
    option("--cameras", type=number("cameras", 1, 33, whole=True), default=6, help="number of cameras in all")
    option("--ceiling", action=argparse.BooleanOptionalAction, default=True, help=ceiling)
    option("--size", type=image_size, default=size, metavar="WxH", help="of the images, pixels")
    option("--motion", default="tour", metavar="NAME|FILE", help=motion)
    option("--seed", type=number("", 0, 1 << 32, whole=True), default=1, help=seed)
    noise = "standard deviation of a pixel, grey levels"
    option("--noise", type=number("grey levels", 0, 100), default=3.0, help=noise)


def _show_progress(done: int, total: int) -> None:
    print(f"\rrendering {done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
