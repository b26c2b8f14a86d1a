"""Reads Biovision hierarchy files (BVH) as positions of named joints over time, and finds out who is who among them.

A file is a tree of joints with offsets, and channels frame by frame. A joint's position in its parent is its OFFSET; a
position channel takes that axis's place. Its rotation is the product of its rotation channels in the order in which the
file names them, each about the axes that the ones before have turned. (Meredith & Maddock, "Motion capture file formats
explained", Sheffield CS-01-11, 2001.)
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from capture_rig.files import read_text
from capture_rig.yaml_file import read_mapping

Array = NDArray[np.float64]

AXES = {"X": 0, "Y": 1, "Z": 2}
CHANNELS = {f"{axis.lower()}{kind}": (kind, axis) for axis in AXES for kind in ("position", "rotation")}
END = "_end"
"""An end site is called after its joint."""
DAMAGED = "The file is damaged or no BVH: export it again."


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joints of one skeleton, frame by frame, in the file's own axes and unit of length.

    names (J,): each once; positions (F, J, 3): world; fps: frames a second; source: the file they come from.
    """

    names: tuple[str, ...]
    positions: Array
    fps: float
    source: Path

    def of(self, name: str) -> Array:
        """Returns the positions (F, 3) of one joint."""
        return self.positions[:, self.names.index(name)]

    def error(self, problem: str, remedy: str) -> InputError:
        """Makes the error that names the file."""
        return InputError(problem, where=str(self.source), remedy=remedy)


@dataclass
class _Joint:
    name: str
    parent: int
    line: int
    offset: Array | None = None
    channels: list[tuple[str, str]] = field(default_factory=list)


def read_bvh(path: str | Path) -> JointMotion:
    """Reads the joints of a BVH file; end sites are called JOINT_end.

    Raises InputError naming file and line for anything that is not BVH.
    """
    path = Path(path)
    lines = read_text(path, "Give the path of a BVH file.").splitlines()
    end = next((n for n, line in enumerate(lines) if line.strip().upper() == "MOTION"), len(lines))
    joints = _hierarchy(path, lines[:end])
    fps, rows = _motion(path, lines, end, sum(len(joint.channels) for joint in joints))
    return JointMotion(tuple(joint.name for joint in joints), _positions(joints, rows), fps, path)


def _error(path: Path, line: int, problem: str, remedy: str = DAMAGED) -> InputError:
    return InputError(problem, where=f"{path}, line {line}", remedy=remedy)


def _numbers(path: Path, line: int, words: list[str]) -> list[float]:
    values = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError:
            values.append(np.nan)
        if not np.isfinite(values[-1]):
            raise _error(path, line, f"'{word}' is not a number")
    return values


def _hierarchy(path: Path, lines: list[str]) -> list[_Joint]:
    """The joints, parents first. A brace is a statement of its own, wherever it stands on its line."""
    parts = ((n, part) for n, line in enumerate(lines, 1) for part in re.split("([{}])", line) if part.strip())
    line, first = next(parts, (max(len(lines), 1), ""))
    if first.strip().upper() != "HIERARCHY":
        raise _error(path, line, f"'{first.strip()}' where BVH has 'HIERARCHY'")
    joints, opened, named = list[_Joint](), list[int](), False
    for line, part in parts:
        kind, *words = part.split()
        kind = kind.upper()
        if named != (kind == "{"):
            raise _error(path, line, f"'{part.strip()}' where BVH has {'{' if named else 'a joint or what it is'}")
        named = kind in (("JOINT", "END") if opened else ("ROOT",))
        if named:
            joints.append(_Joint(_name(path, line, kind, words, joints, opened), opened[-1] if opened else -1, line))
        elif kind == "{":
            opened.append(len(joints) - 1)
        elif kind == "OFFSET" and opened and len(words) == 3:
            joints[opened[-1]].offset = np.array(_numbers(path, line, words))
        elif kind == "CHANNELS" and opened:
            joints[opened[-1]].channels = _channels(path, line, words)
        elif kind == "}" and opened:
            joint = joints[opened.pop()]
            if joint.offset is None:
                raise _error(path, joint.line, f"'{joint.name}' has no OFFSET", "Every joint needs one.")
        else:
            raise _error(path, line, f"'{part.strip()}' where BVH has a joint, its OFFSET, its CHANNELS or its end")
    if opened or named or not joints:
        raise _error(path, len(lines), "the joints end too soon")
    return joints


def _name(path: Path, line: int, kind: str, words: list[str], joints: list[_Joint], opened: list[int]) -> str:
    """The name (blanks may be in it) of the joint that begins here."""
    name, names = " ".join(words), [joint.name for joint in joints]
    if kind == "END":
        name = joints[opened[-1]].name + END
        return name if name not in names else name + str(sum(joint.parent == opened[-1] for joint in joints))
    if not name:
        raise _error(path, line, "a joint has no name", f"Name it after {kind}.")
    if name in names:
        raise _error(path, line, f"there are two joints '{name}'", "Rename one.")
    return name


def _channels(path: Path, line: int, words: list[str]) -> list[tuple[str, str]]:
    """(position or rotation, axis) of a joint's channels in the file's order."""
    count, *names = words or [""]
    if not count.isdigit() or int(count) != len(names):
        raise _error(path, line, f"'{count}' is no number of channels, or not of these", "Give a whole number.")
    for name in names:
        if name.lower() not in CHANNELS:
            known = "Channels are Xposition to Zposition and Xrotation to Zrotation."
            raise _error(path, line, f"there is no channel '{name}'", known)
    return [CHANNELS[name.lower()] for name in names]


def _motion(path: Path, lines: list[str], start: int, channels: int) -> tuple[float, Array]:
    """Frames a second and the channels' values (F, channels)."""
    rows = [(n, line.split()) for n, line in enumerate(lines, 1) if n > start and line.strip()]
    header = dict[str, tuple[int, str]]()
    for key, (line, words) in zip(("MOTION", "Frames:", "Frame Time:"), rows, strict=False):
        if not " ".join(words).upper().startswith(key.upper()):
            raise _error(path, line, f"'{' '.join(words)}' where BVH has '{key}'")
        header[key] = line, " ".join(words)[len(key) :].strip()
    if len(header) < 3:
        raise _error(path, len(lines), "the end of the file where BVH has MOTION, Frames: and Frame Time:")
    (announced, count), (line, period), rows = header["Frames:"], header["Frame Time:"], rows[3:]
    frames = int(count) if count.isdigit() else 0
    if frames < 1:
        raise _error(path, announced, f"the number of frames is '{count}'", "Give a whole number from 1.")
    (period_s,) = _numbers(path, line, [period])
    if period_s <= 0.0:
        raise _error(path, line, f"the frame time is {period_s:g} s", "Give a positive time.")
    for line, words in rows:
        if len(words) != channels:
            raise _error(path, line, f"a frame has {len(words)} numbers, its joints have {channels} channels")
    if len(rows) != frames:
        cut = "The file is cut short or its header is wrong: export it again."
        raise _error(path, announced, f"{len(rows)} frames where {frames} are announced", cut)
    return 1.0 / period_s, np.array([_numbers(path, line, words) for line, words in rows]).reshape(frames, channels)


def _positions(joints: list[_Joint], rows: Array) -> Array:
    """World positions (F, J, 3) of the joints, in the file's axes and unit."""
    frames, column = len(rows), 0
    placed = np.empty((frames, len(joints), 3))
    turned: list[Rotation] = []
    for j, joint in enumerate(joints):
        channels = joint.channels
        values = rows[:, column : column + len(channels)]
        column += len(channels)
        local, rotation = np.tile(np.asarray(joint.offset, float), (frames, 1)), Rotation.identity(frames)
        for (kind, axis), value in zip(channels, values.T, strict=True):
            if kind == "position":
                local[:, AXES[axis]] = value
            else:
                rotation = rotation * Rotation.from_euler(axis, value[:, None], degrees=True)
        if joint.parent < 0:
            placed[:, j] = local
        else:
            placed[:, j] = placed[:, joint.parent] + turned[joint.parent].apply(local)
            rotation = turned[joint.parent] * rotation
        turned.append(rotation)
    return placed


# --- Which joint of the figure each one is.

SIDED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
NEEDED = ("neck", "head", *(f"{side}_{joint}" for side in ("left", "right") for joint in SIDED))
OPTIONAL = ("head_tip",)
Choice = dict[str, tuple[str, ...]]


def _naming(neck: str, head: str, tip: str, left: str, right: str, joints: str) -> Choice:
    """Return a way of naming: alternatives are separated by blanks; {} in a joint's name is the side."""
    table = {"neck": tuple(neck.split()), "head": tuple(head.split()), "head_tip": tuple(tip.split())}
    for side, word in (("left", left), ("right", right)):
        for joint, names in zip(SIDED, joints.split(","), strict=True):
            table[f"{side}_{joint}"] = tuple(name.format(word) for name in names.split())
    return table


NAMINGS: dict[str, Choice] = {
    # bones' ends: a humerus ends at the elbow
    "CMU": _naming(
        "lowerneck", "upperneck", "head", "l", "r", "{}clavicle,{}humerus,{}radius,{}hipjoint,{}femur,{}tibia"
    ),
    "MotionBuilder, Mixamo, cgspeed": _naming(
        "neck1 neck", "head", "headtopend headend", "left", "right", "{}arm,{}forearm,{}hand,{}upleg,{}leg,{}foot"
    ),
    "3ds Max, Xsens, SMPL": _naming(
        "neck", "head", "headend headtopend", "left", "right", "{}shoulder,{}elbow,{}wrist,{}hip,{}knee,{}ankle"
    ),
    "Poser, DAZ": _naming("neck", "head", "headend", "l", "r", "{}shldr,{}forearm,{}hand,{}thigh,{}shin,{}foot"),
    "Unreal": _naming("neck01", "head", "headend", "l", "r", "upperarm{},lowerarm{},hand{},thigh{},calf{},foot{}"),
    "Bandai Namco": _naming(
        "neck", "head", "headend", "l", "r", "upperarm{},lowerarm{},hand{},upperleg{},lowerleg{},foot{}"
    ),
}
"""Names as `plain` writes them."""


def plain(name: str) -> str:
    """Strips case, punctuation and an exporter's prefix (``mixamorig:LeftArm``) from a joint's name."""
    return re.sub(r"[\s_.-]", "", re.sub(r"^(mixamorig\d*[:_])?(.*:)?", "", name.strip().lower()))


def joints_by_role(motion: JointMotion) -> dict[str, str]:
    """Finds the joint of each role in `NEEDED` (and `OPTIONAL` where there is one), by the first naming that fits.

    Raises InputError when none does.
    """
    names = {plain(name): name for name in motion.names}
    for naming in NAMINGS.values():
        found = {
            role: names[next(n for n in choice if n in names)]
            for role, choice in naming.items()
            if any(n in names for n in choice)
        }
        if all(role in found for role in NEEDED):
            return found
    problem = f"its joints are named in no known way: {', '.join(motion.names[:8])} ..."
    raise motion.error(problem, f"Give a YAML file that says which joint is {', '.join(NEEDED)}.")


def load_joints_by_role(path: str | Path, motion: JointMotion) -> dict[str, str]:
    """Reads the same from a YAML file, ``role: joint``. Raises InputError naming file, key and value."""
    document = read_mapping(Path(path), "Give a YAML file with 'role: joint' on every line.")
    for role in document:
        if role not in NEEDED + OPTIONAL:
            known = f"Known: {', '.join(NEEDED + OPTIONAL)}."
            raise InputError(f"there is no joint '{role}'", where=str(path), remedy=known)
    missing = [role for role in NEEDED if role not in document]
    if missing:
        raise InputError(f"'{missing[0]}' is missing", where=str(path), remedy="Give all of them.")
    for role, name in document.items():
        if name not in motion.names:
            near = f"It has {', '.join(difflib.get_close_matches(str(name), motion.names, 3, 0.0))}."
            raise InputError(f"{motion.source.name} has no joint '{name}'", where=f"{path}, {role}", remedy=near)
    return {str(role): str(name) for role, name in document.items()}
