"""python -m virtual_studio.gige: run a studio in the foreground, or talk to one that runs; without any of ROS."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import textwrap
from fractions import Fraction
from pathlib import Path
from typing import Any

from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from capture_rig.settings import build_settings, leaves, number
from capture_rig.stop_signals import StopOnSignal
from capture_rig.yaml_file import parse_value, save_mapping
from rig_calibration.boards.board import read_board

from ..recording.footage import BOARD_FILE, FLOOR_BOARD_FILE, TRUTH_RIG_FILE, save_truth
from .device import NO_FAULTS
from .loop import Request, ask, default_path
from .rendered_scenes import PHASES
from .studio import Studio, StudioSettings

RIG_FILE = "rig.yaml"
CAMERA_FOLDER = "cameras"
OPTIONS = {
    **{f"--{key}": key for key in ("session", "cameras", "scene", "speed", "address")},
    "--fps": "frame_rate",
    "--memory": "memory_mb",
}
"""Settings that have an option of their own."""
_SPEED = number("of the time's speed", 1 / 32, 1)
DESCRIPTION = "Simulated GigE Vision cameras on loopback, which any GenICam client can open."
EPILOG = f"""talking to a running studio:
  status                          what every camera does
  set [CAMERA ...] FAULT=VALUE    faults:
{textwrap.fill(", ".join(NO_FAULTS), 78, initial_indent=" " * 6, subsequent_indent=" " * 6)}
  clear [CAMERA ...]              no faults any more
  off | on [CAMERA ...]           power (all cameras where none is named)
  room empty | occupied           for learning the background
  show PHASE                      of a set-up: next, or
{textwrap.fill(", ".join(PHASES), 78, initial_indent=" " * 6)}
  play [once] [at_ns=N]           begin at frame 0; prints when that is
  hold                            stay at frame 0
  wire rate=HZ                    pulses on trigger input Line1 of all cameras;
                                  0 stops them
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments to a parser, for :func:`run`."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description, parser.epilog = DESCRIPTION, EPILOG
    add = parser.add_argument
    add("words", nargs="*", metavar="WORD", help="talk to a running studio (below); none: run one")
    add("--control", metavar="PATH", help=f"the studio's control socket (default: {default_path()})")
    known = {leaf.key: leaf for leaf in leaves(StudioSettings)}
    for flag, key in OPTIONS.items():
        leaf = known[key]
        parse = number(leaf.metadata["unit"], *leaf.bounds, whole=leaf.type is int) if leaf.type is not str else str
        text = leaf.metadata["help"] + (f" (default: {leaf.default})" if leaf.default else "")
        choices = leaf.metadata["choices"] or None
        add(flag, dest=key, type=speed_argument if key == "speed" else parse, choices=choices, help=text)
    add("--pattern", action="store_true", default=None, help=known["pattern"].metadata["help"])
    add("--empty", action="store_true", help="begin with the empty room")
    add("--write", metavar="FOLDER", help="write rig.yaml and cameras/*.yaml for `sagoma up` into it")
    others = "any other setting, such as camera.generation=old or camera.noise=2"
    add("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings", help=others)


def speed_argument(text: str) -> float:
    """Parses a speed, a number or a fraction such as 1/4, for argparse."""
    part, bar, whole = text.partition("/")
    with contextlib.suppress(ValueError, ArithmeticError):
        text = repr(int(part) / int(whole)) if bar else text
    return _SPEED(text)  # raises the error


def run(args: argparse.Namespace) -> int:
    """Runs a studio until Ctrl-C or SIGTERM, or sends one request and prints its answer."""
    if args.words:
        answer = ask(request_from(args.words), args.control)
        print(json.dumps(answer, indent=2))
        return 0
    with StopOnSignal() as stop:
        studio = Studio(settings_from(args), args.control or default_path())
        if args.empty:
            studio.handle({"do": "room", "state": "empty"})
        with studio:
            _announce(studio, args)
            stop.wait()
    return 0


def settings_from(args: argparse.Namespace) -> StudioSettings:
    """Builds the settings of the studio that the arguments describe. Raises InputError."""
    keys = (leaf.key for leaf in leaves(StudioSettings))
    given = {key: value for key in keys if (value := getattr(args, key, None)) is not None}
    # the built-in room is rendered without noise: it comes from the cameras' sensors
    noise = {} if args.session or args.pattern else {"camera.noise": 2.0}
    return build_settings(StudioSettings, {**noise, **given, **_pairs(args.settings)}, "sagoma studio")


def request_from(words: list[str]) -> Request:
    """Makes a request of the control channel from the words of a command line. Raises InputError."""
    verb, *rest = words
    values = _pairs([word for word in rest if "=" in word])
    names = [word for word in rest if "=" not in word]
    if verb == "set":
        return {"do": verb, "cameras": names, "faults": values}
    if verb in ("room", "show"):
        return {"do": verb, "state" if verb == "room" else "phase": names[0] if names else ""}
    if verb == "play":
        return {"do": verb, "loop": "once" not in names, **values}
    return {"do": verb, "cameras": names, **values}


def write_rig_files(studio: Studio, folder: str | Path) -> Path:
    """Writes rig.yaml, and cameras/CAMERA.yaml for each camera PC, as `sagoma up --rig --cameras` reads them.

    Of cameras that are still to be calibrated: the boards' files, and the rig as truth_rig.yaml, for scoring only.
    """
    folder = Path(folder)
    cameras = folder / CAMERA_FOLDER
    cameras.mkdir(parents=True, exist_ok=True)
    rig_file = folder / RIG_FILE
    calibrated = studio.setup is None
    if calibrated:
        save_rig(studio.rig, rig_file)
    else:
        hand, floor = read_board(studio.settings.hand_board), read_board(studio.settings.floor_board)
        save_truth(studio.rig, hand, floor, folder)
    slow = {} if studio.settings.speed == 1 else {"clock_speed": studio.settings.speed}
    for name, camera in studio.cameras.items():
        parameters = {
            "autostart": True,
            **({"rig_file": str(rig_file.resolve())} if calibrated else {}),
            "camera_name": name,
            "source": "aravis",
            "aravis": {"address": camera.address, "frame_rate": studio.frame_rate, **slow},
            "background_file": str((folder / f"{name}_background.npz").resolve()),
        }
        document = {f"/{name}/camera_client": {"ros__parameters": parameters}}
        save_mapping(cameras / f"{name}.yaml", document)
    return folder


def _pairs(words: list[str]) -> dict[str, Any]:
    pairs = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            raise InputError(f"'{word}' has no value", where="sagoma studio", remedy="Write KEY=VALUE.")
        pairs[key] = parse_value(value, f"sagoma studio: {key}", "Write KEY=VALUE; a text with : [ ] { } in quotes.")
    return pairs


def _announce(studio: Studio, args: argparse.Namespace) -> None:
    speed = Fraction(studio.settings.speed).limit_denominator(1000)
    slow = f", at {speed} of the speed" if speed < 1 else ""
    print(f"{len(studio.cameras)} cameras at {studio.frame_rate:g} Hz{slow}; Ctrl-C ends them")
    for name, camera in studio.cameras.items():
        height, width = camera.scene.shape[:2]
        kind = "colour" if len(camera.scene.shape) == 3 else "mono"
        print(f"  {name}  {camera.address:<12} serial {camera.settings.serial}  {width} x {height} {kind}")
    for note in studio.scene.notes:
        print(f"note: {note}")
    first = next(iter(studio.cameras.values())).address
    print(f"look at one:  arv-tool-0.8 -a {first} control Width Height PixelFormat   |   arv-viewer-0.8 {first}")
    print(f"talk to it:   sagoma studio --control {args.control or default_path()} status")
    if args.write:
        folder = write_rig_files(studio, args.write)
        if studio.setup is None:
            print(f"run on it:    sagoma up --rig {folder / RIG_FILE} --cameras {folder / CAMERA_FOLDER}")
        else:
            words = f"sagoma up --cameras {folder / CAMERA_FOLDER}"
            print(f"run on it:    {words}    (uncalibrated; {TRUTH_RIG_FILE} is for scoring only)")
            print(f"its boards:   {folder / BOARD_FILE}, {folder / FLOOR_BOARD_FILE}")
    print("ready", flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code: 0, or 2 with one clear line on standard error."""
    parser = argparse.ArgumentParser(prog="python -m virtual_studio.gige")
    add_arguments(parser)
    try:
        return run(parser.parse_args(arguments))
    except InputError as error:
        print(f"studio: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
