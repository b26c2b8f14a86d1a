"""Reads Biovision hierarchy files (BVH) as positions of named joints over time, and finds out who is who among them.

A file is a tree of joints with offsets, and channels frame by frame. A joint's position in its parent is its OFFSET; a
position channel takes that axis's place. Its rotation is the product of its rotation channels in the order in which the
file names them, each about the axes that the ones before have turned. (Meredith & Maddock, "Motion capture file formats
explained", Sheffield CS-01-11, 2001.)
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from capture_rig.files import read_text

Array = NDArray[np.float64]
Statement = tuple[int, str]
"""Number of its line, and its words."""

AXES = {"X": 0, "Y": 1, "Z": 2}
CHANNELS = {f"{axis.lower()}{kind}": (kind, axis) for axis in AXES for kind in ("position", "rotation")}
END = "_end"
"""An end site is called after its joint."""


@dataclass
class _Joint:
    name: str
    parent: int
    offset: Array | None = None
    channels: list[tuple[str, str]] = field(default_factory=list)


def read_bvh(path: str | Path) -> tuple[dict[str, Array], float]:
    """Reads world positions (F, 3) of the joints by name, in the file's axes and unit of length, and frames a second.

    End sites are called JOINT_end. Raises InputError naming file and line for anything that is not BVH.
    """
    path = Path(path)
    lines = read_text(path, "Give the path of a BVH file.").splitlines() or [""]
    # a brace is a statement of its own, wherever it stands on its line
    parts = [(n, part.strip()) for n, line in enumerate(lines, 1) for part in re.split("([{}])", line) if part.strip()]
    end = next((k for k, (_, part) in enumerate(parts) if part.upper() == "MOTION"), len(parts))
    joints = _hierarchy(path, parts[:end] or [(1, "")], len(lines))
    fps, rows = _motion(path, parts[end + 1 :], len(lines), sum(len(joint.channels) for joint in joints))
    return {joint.name: places for joint, places in zip(joints, _positions(joints, rows), strict=True)}, fps


def _error(path: Path, line: int, problem: str) -> InputError:
    return InputError(problem, where=f"{path}, line {line}", remedy="The file is damaged or no BVH: export it again.")


def _numbers(path: Path, line: int, words: list[str]) -> Array:
    try:
        values = np.array(words, float)
    except ValueError as error:  # it says which one
        raise _error(path, line, str(error)) from None
    if not np.isfinite(values).all():
        raise _error(path, line, f"'{' '.join(words)}' has what is no number")
    return values


def _hierarchy(path: Path, parts: list[Statement], last: int) -> list[_Joint]:
    """The joints, parents first."""
    joints, opened, wanted = list[_Joint](), list[int](), "HIERARCHY"
    for line, part in parts:
        kind, *words = part.split() or [""]
        kind = kind.upper()
        if (wanted or kind == "{") and kind != wanted:
            raise _error(path, line, f"'{part}' where BVH has '{wanted or 'a joint or what it is'}'")
        begins, wanted = kind in (("JOINT", "END") if opened else ("ROOT",)), ""
        if begins:
            name, wanted = joints[opened[-1]].name + END if kind == "END" else " ".join(words), "{"
            if not name or (kind != "END" and name in [joint.name for joint in joints]):
                raise _error(path, line, f"'{name}' is no name for a joint, or that of two joints")
            joints.append(_Joint(name, opened[-1] if opened else -1))
        elif kind == "{":
            opened.append(len(joints) - 1)
        elif kind == "OFFSET" and opened and len(words) == 3:
            joints[opened[-1]].offset = _numbers(path, line, words)
        elif kind == "CHANNELS" and opened and words and words[0] == str(len(words) - 1):
            unknown = [name for name in words[1:] if name.lower() not in CHANNELS]
            if unknown:
                raise _error(path, line, f"there is no channel '{unknown[0]}'")
            joints[opened[-1]].channels = [CHANNELS[name.lower()] for name in words[1:]]
        elif kind == "}" and opened and joints[opened[-1]].offset is not None:
            opened.pop()
        elif kind != "HIERARCHY":
            raise _error(path, line, f"'{part}' where BVH has a joint, its OFFSET, its CHANNELS or its end")
    if opened or wanted or not joints:
        raise _error(path, last, "the joints end too soon")
    return joints


def _motion(path: Path, parts: list[Statement], last: int, channels: int) -> tuple[float, Array]:
    """Frames a second and the channels' values (F, channels)."""
    header = []
    for key in ("Frames:", "Frame Time:"):
        line, text = parts.pop(0) if parts else (last, "")
        if not text.upper().startswith(key.upper()):
            raise _error(path, line, f"'{text}' where BVH has '{key}' after MOTION")
        header.append((line, *_numbers(path, line, [text[len(key) :]])))
    (announced, frames), (line, period_s) = header
    if period_s <= 0.0:
        raise _error(path, line, f"the frame time is {period_s:g} s")
    rows = [(n, text.split()) for n, text in parts]
    for line, words in rows:
        if len(words) != channels:
            raise _error(path, line, f"a frame has {len(words)} numbers, its joints have {channels} channels")
    if not rows or len(rows) != frames:
        raise _error(path, announced, f"{len(rows)} frames where {frames:g} are announced")
    return 1.0 / period_s, np.array([_numbers(path, line, words) for line, words in rows])


def _positions(joints: list[_Joint], rows: Array) -> list[Array]:
    """World positions (F, 3) of each joint, in the file's axes and unit."""
    column, placed, turned = 0, list[Array](), list[Rotation]()
    for joint in joints:
        local, rotation = np.tile(np.asarray(joint.offset, float), (len(rows), 1)), Rotation.identity(len(rows))
        for kind, axis in joint.channels:
            if kind == "position":
                local[:, AXES[axis]] = rows[:, column]
            else:
                rotation = rotation * Rotation.from_euler(axis, rows[:, column, None], degrees=True)
            column += 1
        if joint.parent >= 0:
            local = placed[joint.parent] + turned[joint.parent].apply(local)
            rotation = turned[joint.parent] * rotation
        placed.append(local)
        turned.append(rotation)
    return placed


# --- Which joint of the figure each one is.

SIDED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
NEEDED = ("neck", "head", *(f"{side}_{joint}" for side in ("left", "right") for joint in SIDED))
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


def joints_by_role(joints: Collection[str], path: Path) -> dict[str, str]:
    """Finds the joint of each role in `NEEDED` (and ``head_tip`` where there is one), by the first naming that fits.

    Raises InputError when none does.
    """
    names = {plain(name): name for name in joints}
    for naming in NAMINGS.values():
        found = {
            role: names[next(n for n in choice if n in names)]
            for role, choice in naming.items()
            if any(n in names for n in choice)
        }
        if all(role in found for role in NEEDED):
            return found
    problem = f"its joints are named in no known way: {', '.join(list(joints)[:8])} ..."
    raise InputError(problem, where=str(path), remedy=f"Rename them as one of these has them: {', '.join(NAMINGS)}.")
