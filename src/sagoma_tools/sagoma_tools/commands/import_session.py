"""``sagoma import``: recordings of others as session folders. One function a kind adds its arguments."""

from __future__ import annotations

import argparse
from pathlib import Path

from capture_rig.settings import number

from ..console import doing
from ..importers import biocv, image_bag
from ..importers.humaneva import CAMERAS, Trial, import_trial

COPYING = "copying frames"


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand, with a subcommand of its own for each kind of recording."""
    parser = subparsers.add_parser("import", help="make a session folder of a rosbag of images, or a public data set")
    kinds = parser.add_subparsers(title="kinds", required=True, metavar="KIND")
    add_bag(kinds)
    add_humaneva(kinds)
    add_biocv(kinds)


def add_bag(kinds: argparse._SubParsersAction) -> None:
    """Add the arguments of ``sagoma import bag``."""
    parser = kinds.add_parser("bag", help="a rosbag of sensor_msgs Image or CompressedImage, of any driver and writer")
    parser.add_argument("bag", type=Path, help="rosbag2 bag (mcap or sqlite3)")
    parser.add_argument("output", type=Path, help="the session folder to write")
    parser.add_argument("--rig", type=Path, help="rig YAML (default: write the lenses of the bag's camera_info)")
    help_camera = "the topic of a camera whose name is no part of it; once a camera"
    parser.add_argument("--camera", action="append", default=[], metavar="NAME=TOPIC", help=help_camera)
    parser.add_argument("--background", type=Path, metavar="BAG", help="a bag of the empty room, on the same topics")
    parser.set_defaults(run=import_bag)


def add_humaneva(kinds: argparse._SubParsersAction) -> None:
    """Add the arguments of ``sagoma import humaneva``: the trial, its cameras and frames, the folder to write."""
    help_text = "a trial of HumanEva-I (Sigal, Balan & Black 2010) that you have from its owners"
    parser = kinds.add_parser("humaneva", help=help_text)
    parser.add_argument("root", type=Path, help="folder that holds S1, S2, S3, S4 and Background")
    parser.add_argument("output", type=Path, help="the session folder to write")
    parser.add_argument("--subject", required=True, help="S1 to S4")
    parser.add_argument("--action", required=True, help="Walking, Jog, ThrowCatch, Gestures, Box or Combo")
    trial, help_trial = number("", 1, 3, whole=True), "1 has footage and motion capture (default)"
    parser.add_argument("--trial", type=trial, default=1, help=help_trial)
    help_cameras = ", ".join(CAMERAS)
    parser.add_argument("--cameras", nargs="+", choices=CAMERAS, default=CAMERAS, metavar="CAMERA", help=help_cameras)
    frame, help_frames = number("", 1, 1e6, whole=True), "the data set's own frame numbers, from 6 on (default: all)"
    parser.add_argument("--frames", nargs=2, type=frame, metavar=("FIRST", "LAST"), help=help_frames)
    parser.add_argument("--no-truth", action="store_true", help="footage alone; trial 2 has no motion capture")
    parser.set_defaults(run=import_humaneva)


def add_biocv(kinds: argparse._SubParsersAction) -> None:
    """Add the arguments of ``sagoma import biocv``."""
    parser = kinds.add_parser("biocv", help="a trial of BioCV (Evans et al. 2024): nine cameras, markers in C3D")
    parser.add_argument("trial", type=Path, help="folder of one trial: videos and markers.c3d")
    parser.add_argument("output", type=Path, help="the session folder to write")
    help_calibration = "folder of the cameras' calibration files (default: the participant's)"
    parser.add_argument("--calibration", type=Path, metavar="FOLDER", help=help_calibration)
    help_markers = "of which markers each point is the middle, POINT: [MARKER, ...]"
    parser.add_argument("--markers", type=Path, metavar="YAML", help=help_markers)
    help_delay = "time of the first mocap frame after the first image (default 0)"
    parser.add_argument("--mocap-delay", type=number("s", -3600, 3600), default=0.0, metavar="SECONDS", help=help_delay)
    parser.set_defaults(run=import_biocv)


def import_biocv(args: argparse.Namespace) -> int:
    """Import the trial, then print what was written and what to do next."""
    said = biocv.import_trial(args.trial, args.output, args.calibration, args.markers, args.mocap_delay)
    return report(
        *said, f"next: sagoma background --from-footage {args.output}", evaluate(args, "--start session --json")
    )


def import_bag(args: argparse.Namespace) -> int:
    """Import the images, then print what was written and what to do next."""
    topics = dict(one.partition("=")[::2] for one in args.camera)
    said = image_bag.import_bag(args.bag, args.output, args.rig, topics, args.background, doing(COPYING))
    if args.rig is None:
        lenses = f"--intrinsics {args.output / image_bag.LENSES}"
        said.append(f"next: sagoma calibrate extrinsics {lenses} --output {args.output}/rig.yaml ...")
    elif args.background is None:
        said.append(f"next: sagoma background --from-footage {args.output}")
    return report(*said, evaluate(args))


def import_humaneva(args: argparse.Namespace) -> int:
    """Import the trial, then print what was written and what to do next."""
    trial = Trial(args.root, args.subject, args.action, args.trial)
    frames = None if args.frames is None else (args.frames[0], args.frames[1])
    count = frames and frames[1] - frames[0] + 1
    cameras = tuple(dict.fromkeys(args.cameras))
    said = import_trial(trial, args.output, cameras, frames, not args.no_truth, doing(COPYING, count))
    return report(*said, f"then: sagoma up {args.output}" if args.no_truth else evaluate(args, "--start session"))


def evaluate(args: argparse.Namespace, options: str = "") -> str:
    """Return the command that evaluates the session."""
    return f"then: sagoma evaluate {args.output} {options}".rstrip()


def report(*lines: str) -> int:
    """Print lines; returns the exit status."""
    print(*lines, sep="\n")
    return 0
