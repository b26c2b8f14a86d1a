"""Reads Acclaim skeletons (ASF) and motion (AMC), as in the CMU motion capture database.

A bone of the skeleton reaches from the end of its parent along a direction that is given in the world's axes of the
rest pose. Angles are about fixed axes, applied in the order in which the file names them. The motion turns a bone about
the bone's own axes: with C the rotation of those axes in the rest pose, M that of the frame and G the parent's,
G_bone = G C M C^-1. (J. Lander, "Working with motion capture file formats", Game Developer, January 1998.)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError

from .joints import Array, JointMotion, number, read_lines

DAMAGED = "The file is damaged: get it again."
OTHER_SKELETON = "Give the skeleton that the motion was recorded with."
ROOT = "root"


@dataclass(frozen=True)
class Line:
    """The words of one line of a file, and where it stands."""

    words: list[str]
    path: Path
    number: int

    @property
    def where(self) -> str:
        return f"{self.path}, line {self.number}"

    def error(self, problem: str, remedy: str = DAMAGED) -> InputError:
        return InputError(problem, where=self.where, remedy=remedy)

    def text(self, k: int) -> str:
        if k >= len(self.words):
            raise self.error(f"'{self.words[0]}' has no value")
        return self.words[k]

    def value(self, k: int) -> float:
        return number(self.text(k), self.where)

    def vector(self, first: int = 1) -> Array:
        return np.array([self.value(k) for k in range(first, first + 3)])


def _content(path: Path, kind: str) -> list[Line]:
    """Return the lines that hold more than a comment."""
    lines = [(n, line.split("#", 1)[0].split()) for n, line in enumerate(read_lines(path, kind), 1)]
    return [Line(words, path, n) for n, words in lines if words]


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
    """Reads the skeleton of an ASF file. Raises InputError naming file and line for anything that is not ASF."""
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
    for line in _content(path, "ASF"):
        if line.words[0].startswith(":"):
            current = sections.setdefault(line.words[0][1:].lower(), [])
        elif current is None:
            raise line.error(f"'{line.words[0]}' before any section", "Give an Acclaim skeleton (ASF).")
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
            raise line.error(f"'{key}' outside of a bone")
        elif key == "end":
            if not bone.name or bone.name in bones or bone.name == ROOT:
                raise line.error(f"a bone is called '{bone.name}'", "Give each its own name.")
            bones[bone.name], bone = bone, None
        else:
            _describe(bone, key, line, degrees)
    return bones


def _describe(bone: Bone, key: str, line: Line, degrees: bool) -> None:
    """Reads one line of a bone; ids, masses and limits are not used."""
    if key == "name":
        bone.name = line.text(1)
    elif key == "direction":
        vector = line.vector()
        if np.linalg.norm(vector) < 1e-9:
            raise line.error("a bone's direction is zero")
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
            raise line.error(f"degree of freedom '{dof}'", f"Known are {allowed}, each once.")
    return dofs


def _turned(letters: str, values: Array, degrees: bool, where: str) -> Rotation:
    """Return the rotation about the fixed axes ``letters``, the first one first."""
    if sorted(letters.lower()) != ["x", "y", "z"]:
        raise InputError(f"order of rotation '{letters}'", where=where, remedy="It names x, y and z, each once.")
    return Rotation.from_euler(letters.lower(), values, degrees=degrees)


def _in_order(bones: dict[str, Bone], hierarchy: list[Line], path: Path) -> dict[str, Bone]:
    """Return the bones with their parents, parents first."""
    children: dict[str, list[str]] = {}
    for line in hierarchy:
        if line.words[0].lower() in ("begin", "end") and len(line.words) == 1:
            continue
        for name in line.words:
            if name not in bones:
                raise line.error(f"there is no bone '{name}'")
        for child in line.words[1:]:
            if bones[child].parent or child == ROOT:
                raise line.error(f"'{child}' has two parents")
            bones[child].parent = line.words[0]
            children.setdefault(line.words[0], []).append(child)
    ordered, open_ends = {ROOT: bones[ROOT]}, [ROOT]
    while open_ends:
        for child in children.get(open_ends.pop(0), []):
            ordered[child] = bones[child]
            open_ends.append(child)
    loose = [name for name in bones if name not in ordered]
    if loose:
        where = f"{path}, line {bones[loose[0]].line}"
        raise InputError(f"bone '{loose[0]}' has no parent", where=where, remedy="Name it in the hierarchy.")
    return ordered


def read_amc(path: str | Path, fps: float | None, skeleton: str | Path | None = None) -> JointMotion:
    """Reads the motion of an AMC file on its ASF skeleton: the ends of the bones by name, and the root.

    fps: frames a second, which the format does not tell. skeleton: the ASF file; without, the one beside the AMC file:
    of the same name, of the name's part before the last underscore (CMU: 02_01.amc, 02.asf), or the only one.
    Raises InputError naming file and line for anything that is not Acclaim.
    """
    path = Path(path)
    if fps is None or not (np.isfinite(fps) and fps > 0.0):
        what = "an AMC file does not tell its frame rate" if fps is None else f"the frame rate is {fps!r}"
        remedy = "Give it: most of CMU's files have 120 frames a second, some 60."
        raise InputError(what, where=str(path), remedy=remedy)
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
    """Return whether angles are degrees, and each frame's lines by bone."""
    degrees, where = asf.degrees, str(path)
    frames: list[dict[str, Line]] = []
    for line in _content(path, "AMC"):
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
    """Raises InputError unless the line gives one known bone of the last frame all its numbers, for the first time."""
    name, count = line.words[0], len(line.words) - 1
    if not frames:
        raise line.error(f"'{name}' before the first frame", "Give an AMC file.")
    if name not in asf.bones:
        raise line.error(f"the skeleton {asf.source} has no bone '{name}'", OTHER_SKELETON)
    if name in frames[-1]:
        raise line.error(f"'{name}' comes twice in a frame")
    if count != len(asf.bones[name].dofs):
        raise line.error(
            f"'{name}' has {count} numbers and {len(asf.bones[name].dofs)} degrees of freedom", OTHER_SKELETON
        )


def _check_complete(frames: list[dict[str, Line]], asf: AcclaimSkeleton, where: str) -> None:
    """Raises InputError when a bone that can move has no numbers in the last frame, which ends at ``where``."""
    for name, bone in asf.bones.items() if frames else ():
        if bone.dofs and name not in frames[-1]:
            raise InputError(f"the frame that ends here has no numbers for '{name}'", where=where, remedy=DAMAGED)


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
