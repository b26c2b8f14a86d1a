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
    offset: Array | None = None
    channels: list[tuple[str, str]] = field(default_factory=list)


def read_bvh(path: str | Path) -> JointMotion:
    """Reads the joints of a BVH file; end sites are called JOINT_end.

    Raises InputError naming file and line for anything that is not BVH.
    """
    path = Path(path)
    tokens = _Tokens(path, read_text(path, "Give the path of a BVH file.").splitlines())
    joints = _hierarchy(tokens)
    fps, rows = _motion(tokens, sum(len(joint.channels) for joint in joints))
    return JointMotion(tuple(joint.name for joint in joints), _positions(joints, rows), fps, path)


class _Tokens:
    """The words of a file with the lines they stand on."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        self.path, self.lines = path, lines
        self._words = [(word, n) for n, line in enumerate(lines, 1) for word in _split(line)]
        self._next = 0

    def where(self, line: int | None = None) -> str:
        return f"{self.path}, line {line or self.line}"

    @property
    def line(self) -> int:
        """Line of the next word, or the last line."""
        return self._words[self._next][1] if self._next < len(self._words) else len(self.lines)

    @property
    def peek(self) -> str:
        return self._words[self._next][0] if self._next < len(self._words) else ""

    def take(self, wanted: str = "") -> str:
        """Return the next word, which has to be ``wanted`` (any case) if that is given."""
        word = self.peek
        if not word or (wanted and word.upper() != wanted.upper()):
            raise self.error(wanted or "more")
        self._next += 1
        return word

    def rest_of_line(self) -> str:
        """Return the words up to the end of the line or a brace: names may hold blanks."""
        line, words = self.line, []
        while self.peek not in ("", "{", "}") and self.line == line:
            words.append(self.take())
        return " ".join(words)

    def numbers(self, count: int) -> Array:
        """Return the next ``count`` numbers."""
        values = []
        for _ in range(count):
            where = self.where()
            values.append(_number(self.take(), where))
        return np.array(values)

    def error(self, wanted: str) -> InputError:
        found = f"'{self.peek}'" if self.peek else "the end of the file"
        remedy = "The file is damaged or no BVH: export it again."
        return InputError(f"{found} where BVH has '{wanted}'", where=self.where(), remedy=remedy)


def _error(problem: str, remedy: str, where: str) -> InputError:
    return InputError(problem, where=where, remedy=remedy)


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise _error(f"'{text}' is not a number", "The file is damaged: export it again.", where)
    return value


def _split(line: str) -> list[str]:
    return line.replace("{", " { ").replace("}", " } ").split()


def _hierarchy(tokens: _Tokens) -> list[_Joint]:
    tokens.take("HIERARCHY")
    joints: list[_Joint] = []
    while tokens.peek.upper() == "ROOT":
        _joint(tokens, joints, -1)
    if not joints:
        raise tokens.error("ROOT")
    return joints


def _joint(tokens: _Tokens, joints: list[_Joint], parent: int) -> None:
    """Reads one joint and what hangs on it into ``joints``, parents first."""
    line, kind = tokens.line, tokens.take().upper()
    name = tokens.rest_of_line()
    if kind == "END":
        name = joints[parent].name + END
    if not name:
        raise _error("a joint has no name", "Name it after JOINT.", tokens.where(line))
    if any(joint.name == name for joint in joints):
        if kind != "END":
            raise _error(f"there are two joints '{name}'", "Rename one.", tokens.where(line))
        name += str(sum(joint.parent == parent for joint in joints))
    me = _Joint(name, parent)
    joints.append(me)
    number_of_me = len(joints) - 1
    tokens.take("{")
    while tokens.peek != "}":
        word = tokens.peek.upper()
        if word == "OFFSET":
            tokens.take()
            me.offset = tokens.numbers(3)
        elif word == "CHANNELS" and kind != "END":
            me.channels = _channels(tokens)
        elif word in ("JOINT", "END") and kind != "END":
            _joint(tokens, joints, number_of_me)
        else:
            raise tokens.error("}")
    tokens.take("}")
    if me.offset is None:
        raise _error(f"'{name}' has no OFFSET", "Every joint needs one.", tokens.where(line))


def _channels(tokens: _Tokens) -> list[tuple[str, str]]:
    """Return (position or rotation, axis) of a joint's channels in the file's order."""
    tokens.take("CHANNELS")
    where, count = tokens.where(), tokens.take()
    if not count.isdigit():
        raise _error(f"'{count}' is no number of channels", "Give a whole number.", where)
    found = []
    for _ in range(int(count)):
        where, word = tokens.where(), tokens.take()
        if word.lower() not in CHANNELS:
            raise _error(
                f"there is no channel '{word}'",
                "Channels are Xposition to Zposition and Xrotation to Zrotation.",
                where,
            )
        found.append(CHANNELS[word.lower()])
    return found


def _motion(tokens: _Tokens, channels: int) -> tuple[float, Array]:
    """Frames a second and the channels' values (F, channels)."""
    tokens.take("MOTION")
    tokens.take("Frames:")
    announced, word = tokens.where(), tokens.take()
    frames = int(word) if word.isdigit() else 0
    if frames < 1:
        raise _error(f"the number of frames is '{word}'", "Give a whole number from 1.", announced)
    tokens.take("Frame")
    tokens.take("Time:")
    where, period_s = tokens.where(), tokens.numbers(1)[0]
    if period_s <= 0.0:
        raise _error(f"the frame time is {period_s:g} s", "Give a positive time.", where)
    first = tokens.line if tokens.peek else len(tokens.lines) + 1
    rows = [(n, line) for n, line in enumerate(tokens.lines, 1) if n >= first and line.strip()]
    for n, line in rows:
        if len(line.split()) != channels:
            raise _error(
                f"a frame has {len(line.split())} numbers, its joints have {channels} channels",
                "The file is damaged: export it again.",
                tokens.where(n),
            )
    if len(rows) != frames:
        raise _error(
            f"{len(rows)} frames where {frames} are announced",
            "The file is cut short or its header is wrong: export it again.",
            announced,
        )
    values = [[_number(word, tokens.where(n)) for word in line.split()] for n, line in rows]
    return 1.0 / period_s, np.array(values).reshape(frames, channels)


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
