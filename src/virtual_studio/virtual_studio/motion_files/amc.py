"""Acclaim motion (AMC) on its skeleton (ASF), as in the CMU motion capture database.

Its motion turns a bone about the bone's own axes: with C the rotation of those axes in the rest pose, M that of the
frame and G the parent's, G_bone = G C M C^-1.
(J. Lander, "Working with motion capture file formats", Game Developer, January 1998.)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError

from .acclaim_lines import DAMAGED, Line, content
from .asf import ROOT, AcclaimSkeleton, Bone, read_asf
from .joint_motion import Array, JointMotion


def read_amc(path: str | Path, fps: float | None, skeleton: str | Path | None = None) -> JointMotion:
    """Motion of an AMC file on its ASF skeleton: the ends of the bones by name, and the root.

    fps: frames a second, which the format does not tell. skeleton: the ASF file; without, the one beside the AMC file:
    of the same name, of the name's part before the last underscore (CMU: 02_01.amc, 02.asf), or the only one.
    Raises InputError naming file and line for whatever is not Acclaim.
    """
    path = Path(path)
    if fps is None or not (np.isfinite(fps) and fps > 0.0):
        what = "an AMC file does not tell its frame rate" if fps is None else f"the frame rate is {fps!r}"
        raise InputError(
            what, where=str(path), remedy="Give it: most of CMU's files have 120 frames a second, some 60."
        )
    asf = read_asf(_skeleton_of(path) if skeleton is None else Path(skeleton))
    degrees, frames = _frames(path, asf)
    return JointMotion(tuple(asf.bones), _positions(asf, frames, degrees), fps, path)


def _skeleton_of(path: Path) -> Path:
    beside = sorted(p for p in path.parent.glob("*") if p.suffix.lower() == ".asf")
    for stem in (path.stem, path.stem.rpartition("_")[0]):
        for candidate in beside:
            if candidate.stem == stem:
                return candidate
    if len(beside) == 1:
        return beside[0]
    found = f"{len(beside)} ASF files are" if beside else "no ASF file is"
    raise InputError(f"{found} beside it, and none of its name", where=str(path), remedy="Say which skeleton it has.")


def _frames(path: Path, asf: AcclaimSkeleton) -> tuple[bool, list[dict[str, Line]]]:
    """Whether angles are degrees, and each frame's lines by bone."""
    degrees, where = asf.degrees, str(path)
    frames: list[dict[str, Line]] = []
    for line in content(path, "AMC"):
        word, where = line.words[0], line.where
        if word.startswith(":"):
            if word.lower() in (":degrees", ":radians"):
                degrees = word.lower() == ":degrees"
        elif word.isdigit() and len(line.words) == 1:
            _check_complete(frames, asf, where)
            frames.append({})
        else:
            _check(line, asf, frames)
            frames[-1][word] = line
    _check_complete(frames, asf, where)
    if not frames:
        raise InputError("holds no frame", where=str(path), remedy="Give an AMC file.")
    return degrees, frames


def _check(line: Line, asf: AcclaimSkeleton, frames: list[dict[str, Line]]) -> None:
    """InputError unless the line gives one known bone of the last frame all its numbers, for the first time."""
    name, count = line.words[0], len(line.words) - 1
    if not frames:
        raise InputError(f"'{name}' before the first frame", where=line.where, remedy="Give an AMC file.")
    if name not in asf.bones:
        raise InputError(
            f"the skeleton {asf.source} has no bone '{name}'",
            where=line.where,
            remedy="Give the skeleton that the motion was recorded with.",
        )
    if name in frames[-1]:
        raise InputError(f"'{name}' comes twice in a frame", where=line.where, remedy=DAMAGED)
    if count != len(asf.bones[name].dofs):
        raise InputError(
            f"'{name}' has {count} numbers and {len(asf.bones[name].dofs)} degrees of freedom",
            where=line.where,
            remedy="Give the skeleton that the motion was recorded with.",
        )


def _check_complete(frames: list[dict[str, Line]], asf: AcclaimSkeleton, where: str) -> None:
    """InputError when a bone that can move has no numbers in the last frame, which ends at ``where``."""
    for name, bone in asf.bones.items() if frames else ():
        if bone.dofs and name not in frames[-1]:
            raise InputError(f"the frame that ends here says nothing of '{name}'", where=where, remedy=DAMAGED)


def _positions(asf: AcclaimSkeleton, frames: list[dict[str, Line]], degrees: bool) -> Array:
    """World positions (F, bones, 3) of the bones' ends, in the file's axes and unit."""
    ends: dict[str, Array] = {}
    turned: dict[str, Rotation] = {}
    for name, bone in asf.bones.items():
        values = np.array([[frame[name].value(1 + k) for k in range(len(bone.dofs))] for frame in frames])
        M, shift = _motion_of(bone, values.reshape(len(frames), -1), degrees)
        local = bone.axes * M * bone.axes.inv()
        if name == ROOT:
            turned[name], ends[name] = M * bone.axes, asf.start + shift
            continue
        turned[name] = turned[bone.parent] * local
        ends[name] = ends[bone.parent] + turned[name].apply(bone.direction * bone.length)
    return np.stack(list(ends.values()), axis=1)


def _motion_of(bone: Bone, values: Array, degrees: bool) -> tuple[Rotation, Array]:
    """M of every frame, and the translation (F, 3)."""
    rotation, shift = Rotation.identity(len(values)), np.zeros((len(values), 3))
    for dof, value in zip(bone.dofs, values.T, strict=True):
        if dof[0] == "t":
            shift[:, "xyz".index(dof[1])] = value
        else:
            rotation = Rotation.from_euler(dof[1], value[:, None], degrees=degrees) * rotation
    return rotation, shift
