"""Acclaim skeletons (ASF): bones with their rest pose.

A bone reaches from the end of its parent along a direction that is given in the world's axes of the rest pose. Angles
are about fixed axes, applied in the order in which the file names them.
(J. Lander, "Working with motion capture file formats", Game Developer, January 1998.)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError

from .acclaim_lines import DAMAGED, Line, content
from .joint_motion import Array

ROOT = "root"


@dataclass
class Bone:
    """A bone of the rest pose, in the file's axes and unit; the root is a bone of no length.

    direction (3,) unit; axes: C; dofs: rx, ry, rz (the root: tx to tz too) in the order of the motion's numbers.
    """

    name: str
    line: int
    direction: Array = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axes: Rotation = field(default_factory=Rotation.identity)
    dofs: tuple[str, ...] = ()
    parent: str = ""


@dataclass(frozen=True, eq=False)
class AcclaimSkeleton:
    """Bones by name, parents first; start (3,): the root's place, added to its motion; degrees: the skeleton's unit of
    angle; unit_length: what the file says a unit of length is worth (CMU: 0.45, meaning 1 unit = 1 inch / 0.45)."""

    bones: dict[str, Bone]
    start: Array
    degrees: bool
    unit_length: float
    source: Path


def read_asf(path: str | Path) -> AcclaimSkeleton:
    """The skeleton of an ASF file; InputError naming file and line for whatever is not ASF."""
    path = Path(path)
    sections = _sections(path)
    for needed in ("root", "bonedata", "hierarchy"):
        if needed not in sections:
            raise InputError(f"has no section ':{needed}'", where=str(path), remedy="Give an Acclaim skeleton (ASF).")
    units = {line.words[0].lower(): line for line in sections.get("units", [])}
    degrees = "angle" not in units or units["angle"].text(1).lower().startswith("deg")
    root, start = _root(sections["root"], degrees)
    bones = {ROOT: root} | _bones(sections["bonedata"], degrees)
    ordered = _in_order(bones, sections["hierarchy"], path)
    unit = units["length"].value(1) if "length" in units else 1.0
    return AcclaimSkeleton(ordered, start, degrees, unit, path)


def _sections(path: Path) -> dict[str, list[Line]]:
    sections: dict[str, list[Line]] = {}
    current: list[Line] | None = None
    for line in content(path, "ASF"):
        if line.words[0].startswith(":"):
            current = sections.setdefault(line.words[0][1:].lower(), [])
        elif current is None:
            raise InputError(
                f"'{line.words[0]}' before any section", where=line.where, remedy="Give an Acclaim skeleton (ASF)."
            )
        else:
            current.append(line)
    return sections


def _root(lines: list[Line], degrees: bool) -> tuple[Bone, Array]:
    by_key = {line.words[0].lower(): line for line in lines}
    root = Bone(ROOT, lines[0].number if lines else 1)
    order = by_key.get("order")
    root.dofs = _dofs(order, "rt") if order else ("tx", "ty", "tz", "rx", "ry", "rz")
    if "orientation" in by_key:
        letters = by_key["axis"].text(1) if "axis" in by_key else "XYZ"
        root.axes = _turned(letters, by_key["orientation"].vector(), degrees, by_key["orientation"].where)
    start = by_key["position"].vector() if "position" in by_key else np.zeros(3)
    return root, start


def _bones(lines: list[Line], degrees: bool) -> dict[str, Bone]:
    bones: dict[str, Bone] = {}
    bone: Bone | None = None
    for line in lines:
        key = line.words[0].lower()
        if key == "begin":
            bone = Bone("", line.number)
        elif bone is None:
            raise InputError(f"'{key}' outside of a bone", where=line.where, remedy=DAMAGED)
        elif key == "end":
            if not bone.name or bone.name in bones or bone.name == ROOT:
                raise InputError(f"a bone is called '{bone.name}'", where=line.where, remedy="Give each its own name.")
            bones[bone.name], bone = bone, None
        else:
            _describe(bone, key, line, degrees)
    return bones


def _describe(bone: Bone, key: str, line: Line, degrees: bool) -> None:
    """One line of a bone; ids, masses and limits do not matter here."""
    if key == "name":
        bone.name = line.text(1)
    elif key == "direction":
        vector = line.vector()
        if np.linalg.norm(vector) < 1e-9:
            raise InputError("a bone's direction is zero", where=line.where, remedy=DAMAGED)
        bone.direction = vector / np.linalg.norm(vector)
    elif key == "length":
        bone.length = line.value(1)
    elif key == "axis":
        bone.axes = _turned(line.text(4), line.vector(), degrees, line.where)
    elif key == "dof":
        bone.dofs = _dofs(line, "r")


def _dofs(line: Line, kinds: str) -> tuple[str, ...]:
    dofs = tuple(word.lower() for word in line.words[1:])
    for dof in dofs:
        if len(dof) != 2 or dof[0] not in kinds or dof[1] not in "xyz" or dofs.count(dof) > 1:
            allowed = "rx, ry, rz" if kinds == "r" else "tx to tz and rx to rz"
            raise InputError(f"degree of freedom '{dof}'", where=line.where, remedy=f"Known are {allowed}, each once.")
    return dofs


def _turned(letters: str, values: Array, degrees: bool, where: str) -> Rotation:
    """Rotation about the fixed axes ``letters``, the first one first."""
    if sorted(letters.lower()) != ["x", "y", "z"]:
        raise InputError(f"order of rotation '{letters}'", where=where, remedy="It names x, y and z, each once.")
    return Rotation.from_euler(letters.lower(), values, degrees=degrees)


def _in_order(bones: dict[str, Bone], hierarchy: list[Line], path: Path) -> dict[str, Bone]:
    """The bones with their parents, parents first."""
    children: dict[str, list[str]] = {}
    for line in hierarchy:
        if line.words[0].lower() in ("begin", "end") and len(line.words) == 1:
            continue
        for name in line.words:
            if name not in bones:
                raise InputError(f"there is no bone '{name}'", where=line.where, remedy=DAMAGED)
        for child in line.words[1:]:
            if bones[child].parent or child == ROOT:
                raise InputError(f"'{child}' has two parents", where=line.where, remedy=DAMAGED)
            bones[child].parent = line.words[0]
            children.setdefault(line.words[0], []).append(child)
    ordered, open_ends = {ROOT: bones[ROOT]}, [ROOT]
    while open_ends:
        for child in children.get(open_ends.pop(0), []):
            ordered[child] = bones[child]
            open_ends.append(child)
    loose = [name for name in bones if name not in ordered]
    if loose:
        raise InputError(
            f"bone '{loose[0]}' hangs on nothing",
            where=f"{path}, line {bones[loose[0]].line}",
            remedy="Name it in the hierarchy.",
        )
    return ordered
