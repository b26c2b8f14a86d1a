"""python -m virtual_studio FOLDER: render a session of the built-in person."""

from __future__ import annotations

import argparse
import sys
import time

from capture_rig.errors import InputError
from stick_figure.body import Body

from .motion import MOTIONS
from .rig import ring
from .session import write_session


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code: 0, or 2 with one clear line on standard error."""
    options = _parser().parse_args(arguments)
    started = time.monotonic()
    try:
        rig = ring(options.cameras - options.ceiling, options.ceiling)
        body = Body.from_stature(options.stature)
        folder = write_session(
            options.folder, rig, body, options.motion, options.fps, options.seconds, options.seed, options.noise,
            options.shadow, options.flicker, _show_progress if sys.stderr.isatty() else lambda done, total: None,
        )  # fmt: skip
    except InputError as error:
        print(f"virtual_studio: {error}", file=sys.stderr)
        return 2
    frames = round(options.seconds * options.fps)
    print(f"{folder}: {len(rig.cameras)} cameras x {frames} frames in {time.monotonic() - started:.1f} s")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m virtual_studio",
        description="Render a session of the built-in person: videos, empty room, exact silhouettes, rig, truth.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("folder", help="session folder to write (new, empty, or an older session of this tool)")
    parser.add_argument("--cameras", type=int, default=6, help="number of cameras in all")
    parser.add_argument("--ceiling", action=argparse.BooleanOptionalAction, default=True,
                        help="the last camera hangs from the ceiling")  # fmt: skip
    parser.add_argument("--seconds", type=float, default=6.0, help="length, s; the first second is a T-pose")
    parser.add_argument("--fps", type=float, default=60.0, help="frames a second")
    parser.add_argument("--motion", choices=sorted(MOTIONS), default="tour", help="what the person does")
    parser.add_argument("--stature", type=float, default=1.75, help="standing height, m")
    parser.add_argument("--seed", type=int, default=1, help="of noise and flicker")
    parser.add_argument("--noise", type=float, default=3.0, help="standard deviation of a pixel, grey levels")
    parser.add_argument("--flicker", type=float, default=0.005, help="relative deviation of a frame's brightness")
    parser.add_argument("--shadow", action=argparse.BooleanOptionalAction, default=True, help="shadow on the floor")
    return parser


def _show_progress(done: int, total: int) -> None:
    print(f"\rrendering {done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
