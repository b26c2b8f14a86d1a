"""The motion of a take as files of other programs: which formats there are, which files they make, who writes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.files import make_folder
from motion_export.bvh import write_bvh
from motion_export.gltf import write_glb
from motion_export.marker_files import write_c3d, write_csv, write_trc
from motion_export.motion import Motion
from motion_export.opensim import write_mot, write_osim

from ..recording.recorded_motion import recorded_motions

Writer = Callable[[Motion, Path], None]
FORMATS: Mapping[str, Mapping[str, Writer]] = {
    "bvh": {"bvh": write_bvh},
    "glb": {"glb": write_glb},
    "c3d": {"c3d": write_c3d},
    "trc": {"trc": write_trc},
    "opensim": {"osim": write_osim, "mot": write_mot},
    "csv": {"csv": write_csv},
}
"""Format -> the extensions of its files and who writes them."""
WITHOUT_GAPS = ("bvh", "opensim")
EXPORTS = "export"
"""The folder in a take's folder into which its files go unless told otherwise."""


@dataclass(frozen=True)
class Options:
    """How files are written. rate_hz : frames a second, None for the take's own. mass_kg : of the OpenSim model, None
    for a BMI of 22. constant_bones : BVH without position channels below the root. overwrite : replace files."""

    rate_hz: float | None = None
    mass_kg: float | None = None
    constant_bones: bool = False
    overwrite: bool = False


def export_take(
    take: Path,
    folder: Path,
    formats: Sequence[str],
    options: Options | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> list[Path]:
    """Write every person of a take in every format wanted, each file whole or not at all; returns the files.

    tell : hears of every person and file. Raises InputError for a take without a person, and for files that exist.
    """
    chosen = options or Options()
    motions = recorded_motions(take, chosen.rate_hz)
    planned = [
        (body_id, kind, folder / f"{motion.name}.{extension}", write)
        for body_id, motion in motions.items()
        for kind in dict.fromkeys(formats)
        for extension, write in _writers(kind, chosen).items()
    ]
    existing = [str(path) for _, _, path, _ in planned if path.exists()]
    if existing and not chosen.overwrite:
        remedy = "Give another --output, or --overwrite."
        raise InputError(f"{', '.join(existing)} exists", where="--output", remedy=remedy)
    make_folder(folder)
    for body_id, motion in motions.items():
        tell(f"{body_id}: {describe(motion)}")
    for body_id, kind, path, write in planned:
        write_whole(motions[body_id], path, write)
        filled = motions[body_id].gaps and kind in WITHOUT_GAPS
        tell(f"  {path}{'  (gaps are filled by interpolation)' if filled else ''}")
    return [path for _, _, path, _ in planned]


def describe(motion: Motion) -> str:
    """Return length, rate and gaps of a motion in words."""
    lost = sum(end - first for first, end in motion.gaps) / motion.rate_hz
    gaps = f", {len(motion.gaps)} gaps of {lost:.1f} s in all" if motion.gaps else ", no gaps"
    return f"{len(motion)} frames at {motion.rate_hz:g} Hz{gaps}"


def write_whole(motion: Motion, path: Path, write: Writer) -> None:
    """Write beside the file and rename, so that a file is there whole or not at all."""
    beside = path.with_name(f".{path.name}.part")
    try:
        write(motion, beside)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def _writers(kind: str, options: Options) -> Mapping[str, Writer]:
    """Extension -> writer, with the options that concern it."""
    if kind == "bvh":
        return {"bvh": partial(write_bvh, constant_bones=options.constant_bones)}
    if kind == "opensim":
        return {"osim": partial(write_osim, mass_kg=options.mass_kg), "mot": write_mot}
    return FORMATS[kind]
