"""``sagoma export``: the motion of a recorded take as files of other programs."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from capture_rig.errors import InputError
from motion_export.bvh import write_bvh
from motion_export.gltf import write_glb
from motion_export.marker_files import write_c3d, write_trc
from motion_export.motion import Motion
from motion_export.opensim import write_mot, write_osim
from motion_export.tables import write_csv

from ..recording.recorded_motion import recorded_motions

Writer = Callable[[Motion, Path], None]
WITHOUT_GAPS = ("bvh", "opensim")
ALL = "all"


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("export", help="write a take as BVH, glTF, C3D, TRC, OpenSim or CSV")
    option = parser.add_argument
    option("take", help="bag that `sagoma record`, `demo` or `smooth` wrote")
    help_format = "one or several of bvh, glb, c3d, trc, opensim (.osim and .mot), csv; or all"
    option("--format", nargs="+", default=[ALL], choices=(*FORMATS, ALL), metavar="FORMAT", help=help_format)
    option("--output", metavar="FOLDER", help="where the files go (default: TAKE/export)")
    option("--rate", type=float, metavar="HZ", help="frames a second of the files (default: the take's own)")
    option("--mass", type=float, metavar="KG", help="of the person, for the OpenSim model (default: a BMI of 22)")
    option("--constant-bones", action="store_true", help="BVH without position channels below the root")
    option("--overwrite", action="store_true", help="replace files of earlier exports")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write every person of the take in every format wanted, and print what was written and what a format lost."""
    formats = list(FORMATS) if ALL in args.format else list(dict.fromkeys(args.format))
    motions = recorded_motions(args.take, args.rate)
    folder = Path(args.output) if args.output else Path(args.take) / "export"
    planned = [
        (motion, kind, folder / f"{motion.name}.{extension}", write)
        for motion in motions.values()
        for kind in formats
        for extension, write in _writers(kind, args).items()
    ]
    existing = [str(path) for _, _, path, _ in planned if path.exists()]
    if existing and not args.overwrite:
        remedy = "Give another --output, or --overwrite."
        raise InputError(f"{', '.join(existing)} exists", where="--output", remedy=remedy)
    folder.mkdir(parents=True, exist_ok=True)
    for body_id, motion in motions.items():
        print(f"{body_id}: {describe(motion)}")
    for motion, kind, path, write in planned:
        write_whole(motion, path, write)
        print(f"  {path}{note(motion, kind)}")
    return 0


def describe(motion: Motion) -> str:
    """Return length, rate and gaps of a motion in words."""
    lost = sum(end - first for first, end in motion.gaps) / motion.rate_hz
    gaps = f", {len(motion.gaps)} gaps of {lost:.1f} s in all" if motion.gaps else ", no gaps"
    return f"{len(motion)} frames at {motion.rate_hz:g} Hz{gaps}"


def note(motion: Motion, kind: str) -> str:
    """Return what this format did to the motion, empty when it holds all of it."""
    return "  (gaps are filled by interpolation)" if motion.gaps and kind in WITHOUT_GAPS else ""


def write_whole(motion: Motion, path: Path, write: Writer) -> None:
    """Write beside the file and rename, so that a file is there whole or not at all."""
    beside = path.with_name(f".{path.name}.part")
    try:
        write(motion, beside)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def _writers(kind: str, args: argparse.Namespace) -> Mapping[str, Writer]:
    """Extension -> writer, with the options that concern it."""
    if kind == "bvh":
        return {"bvh": partial(write_bvh, constant_bones=args.constant_bones)}
    if kind == "opensim":
        return {"osim": partial(write_osim, mass_kg=args.mass), "mot": write_mot}
    return FORMATS[kind]


FORMATS: Mapping[str, Mapping[str, Writer]] = {
    "bvh": {"bvh": write_bvh},
    "glb": {"glb": write_glb},
    "c3d": {"c3d": write_c3d},
    "trc": {"trc": write_trc},
    "opensim": {"osim": write_osim, "mot": write_mot},
    "csv": {"csv": write_csv},
}
"""Format -> the extensions of its files and who writes them."""
