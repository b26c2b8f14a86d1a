"""python -m virtual_studio FOLDER: render a session of the built-in person; setup FOLDER: the boards as well."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from capture_rig.errors import InputError

from .motion_files.recorded import ReadingOptions, RecordedMotion, is_motion_file
from .motions.catalogue import MOTIONS, MotionFunction
from .people import person_of
from .recording.session import write_session
from .recording.setup_command import main as setup
from .rig import ring


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code: 0, or 2 with one clear line on standard error."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["setup"]:
        return setup(arguments[1:])
    options = _parser().parse_args(arguments)
    started = time.monotonic()
    try:
        rig = ring(options.cameras - options.ceiling, options.ceiling)
        body = person_of(options.stature, options.arms, options.legs)
        folder = write_session(
            options.folder,
            rig,
            body,
            _motion(options),
            options.fps,
            options.seconds,
            options.seed,
            options.noise,
            options.shadow,
            options.flicker,
            options.build,
            _show_progress if sys.stderr.isatty() else lambda done, total: None,
        )
    except InputError as error:
        print(f"virtual_studio: {error}", file=sys.stderr)
        return 2
    frames = len((folder / "truth.csv").read_text(encoding="utf-8").splitlines()) - 1
    print(f"{folder}: {len(rig.cameras)} cameras x {frames} frames in {time.monotonic() - started:.1f} s")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m virtual_studio",
        description="Render a session of the built-in person: videos, empty room, exact silhouettes, rig, truth.",
        epilog="python -m virtual_studio setup FOLDER films calibration boards as well (--help tells more)",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("folder", help="session folder to write (new, empty, or an older session of this tool)")
    parser.add_argument("--cameras", type=int, default=6, help="number of cameras in all")
    parser.add_argument(
        "--ceiling", action=argparse.BooleanOptionalAction, default=True, help="the last camera hangs from the ceiling"
    )
    parser.add_argument("--seconds", type=float, default=6.0, help="length, s (of a file: at most); first a T-pose")
    parser.add_argument("--fps", type=float, default=60.0, help="frames a second")
    parser.add_argument(
        "--motion",
        default="tour",
        metavar="NAME|FILE",
        help=f"what the person does: {', '.join(MOTIONS)}; or a BVH or AMC file",
    )
    parser.add_argument("--motion-start", type=float, default=0.0, help="seconds of the file to leave out")
    parser.add_argument("--motion-up", default="y", help="the file's axis that points up")
    parser.add_argument("--motion-fps", type=float, help="frames a second of an AMC file")
    parser.add_argument("--motion-skeleton", type=Path, help="ASF file of an AMC file, if it is not beside it")
    parser.add_argument("--motion-joints", type=Path, help="YAML that says which of the file's joints is which")
    parser.add_argument("--stature", type=float, default=1.75, help="standing height, m")
    parser.add_argument("--build", type=float, default=1.0, help="thickness over the average's: 0.85 slim, 1.2 heavy")
    parser.add_argument("--arms", type=float, default=1.0, help="length of the arms over the average's")
    parser.add_argument("--legs", type=float, default=1.0, help="length of the legs over the average's")
    parser.add_argument("--seed", type=int, default=1, help="of noise and flicker")
    parser.add_argument("--noise", type=float, default=3.0, help="standard deviation of a pixel, grey levels")
    parser.add_argument("--flicker", type=float, default=0.005, help="relative deviation of a frame's brightness")
    parser.add_argument("--shadow", action=argparse.BooleanOptionalAction, default=True, help="shadow on the floor")
    return parser


def _motion(options: argparse.Namespace) -> str | MotionFunction:
    if not is_motion_file(options.motion):
        return options.motion
    reading = ReadingOptions(
        up=options.motion_up,
        fps=options.motion_fps,
        skeleton=options.motion_skeleton,
        joints=options.motion_joints,
        start_s=options.motion_start,
    )
    return RecordedMotion(Path(options.motion), reading)


def _show_progress(done: int, total: int) -> None:
    print(f"\rrendering {done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
