"""Reads Biovision hierarchy files (BVH) as positions of named joints over time, and assigns roles to the joints.

A file is a tree of joints with offsets, and channels frame by frame. A joint's position in its parent is its OFFSET; a
position channel takes that axis's place. Its rotation is the product of its rotation channels in the order in which the
file names them, each about the axes that the ones before have turned. (Meredith & Maddock, "Motion capture file formats
explained", Sheffield CS-01-11, 2001.)
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from capture_rig.files import read_text

Array = NDArray[np.float64]

END = "_end"
"""An end site is called after its joint."""
_FILE = re.compile(r"\s*HIERARCHY\b(.*?)\bMOTION\s+Frames:\s*(\S+)\s+Frame\s+Time:\s*(\S+)(.*)", re.I | re.S)
_STATEMENT = re.compile(
    r"(ROOT|JOINT|END)[ \t]+([^\n{}]+?)\s*{|OFFSET((?:\s+\S+){3})"
    r"|CHANNELS\s+(\d+)((?:\s+[XYZ](?:position|rotation)\b)*)|(})",
    re.I,
)


@dataclass
class _Joint:
    name: str
    parent: int
    offset: Array | None = None
    channels: list[str] = field(default_factory=list)


def read_bvh(path: str | Path) -> tuple[dict[str, Array], float]:
    """Reads world positions (F, 3) of the joints by name, in the file's axes and unit of length, and frames a second.

    End sites are called JOINT_end. Raises InputError naming the file and the invalid part.
    """
    text = read_text(path, "Give the path of a BVH file.")
    try:
        if (parts := _FILE.match(text)) is None:
            raise ValueError("BVH has HIERARCHY, then MOTION, 'Frames:' and 'Frame Time:'")
        hierarchy, frames, period, numbers = parts.groups()
        joints, (period_s,), values = _hierarchy(hierarchy), _numbers([period]), _numbers(numbers.split())
        channels = sum(len(joint.channels) for joint in joints)
        if period_s <= 0.0:
            raise ValueError(f"the frame time is {period_s:g} s")
        if len(values) != int(frames) * channels or not len(values):
            raise ValueError(f"{len(values)} numbers where {frames} frames of {channels} channels are announced")
    except (ValueError, IndexError) as error:
        remedy = "The file is damaged or no BVH: export it again."
        raise InputError(f"is no BVH file: {error}", where=str(path), remedy=remedy) from None
    placed = _positions(joints, values.reshape(-1, channels))
    return {joint.name: places for joint, places in zip(joints, placed, strict=True)}, 1.0 / period_s


def _numbers(words: Sequence[str]) -> Array:
    """Parses numbers. Raises ValueError naming an invalid one."""
    values = np.array(words, float)
    if not np.isfinite(values).all():
        raise ValueError(f"{words[int(np.argmin(np.isfinite(values)))]} is no number")
    return values


def _hierarchy(text: str) -> list[_Joint]:
    """The joints, parents first. Raises ValueError, or IndexError for a brace too many."""
    joints, opened, read_to = list[_Joint](), [-1], 0
    for found in _STATEMENT.finditer(text):
        kind, name, offset, count, channels, _ = found.groups()
        if unknown := text[read_to : found.start()].strip():
            raise ValueError(f"'{unknown}' where BVH has a joint, its OFFSET, its CHANNELS or its end")
        read_to = found.end()
        if kind:
            name = joints[opened[-1]].name + END if kind.upper() == "END" else name
            if name in [joint.name for joint in joints]:
                raise ValueError(f"two joints are called '{name}'")
            joints.append(_Joint(name, opened[-1]))
            opened.append(len(joints) - 1)
        elif offset:
            joints[opened[-1]].offset = _numbers(offset.split())
        elif count:
            joints[opened[-1]].channels = channels.split()
            if int(count) != len(channels.split()):
                raise ValueError(f"'{found[0]}' where BVH has {count} channels, such as Xposition and Zrotation")
        else:
            opened.pop()
    if text[read_to:].strip() or opened != [-1] or any(joint.offset is None for joint in joints):
        raise ValueError("the joints end too soon, or a joint has no OFFSET")
    return joints


def _positions(joints: list[_Joint], rows: Array) -> list[Array]:
    """World positions (F, 3) of each joint, in the file's axes and unit."""
    column, placed, turned = 0, list[Array](), list[Rotation]()
    for joint in joints:
        local, rotation = np.tile(np.asarray(joint.offset, float), (len(rows), 1)), Rotation.identity(len(rows))
        for channel in joint.channels:
            axis = channel[0].upper()
            if channel[1:].lower() == "position":
                local[:, "XYZ".index(axis)] = rows[:, column]
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
