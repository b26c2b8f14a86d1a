"""Positions of named joints over time, which every motion file becomes, and which joint of the figure each one is."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_rig.errors import InputError
from capture_rig.yaml_file import read_mapping

Array = NDArray[np.float64]

SIDED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
NEEDED = ("neck", "head", *(f"{side}_{joint}" for side in ("left", "right") for joint in SIDED))
OPTIONAL = ("head_tip",)
Choice = dict[str, tuple[str, ...]]


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


def number(text: str, where: str) -> float:
    """Parses a finite number. Raises InputError where the file has something else."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"'{text}' is not a number", where=where, remedy="The file is damaged: export it again.")
    return value


def read_lines(path: Path, kind: str) -> list[str]:
    """Reads the lines of a text file. Raises InputError when it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="strict").splitlines()
    except FileNotFoundError:
        raise InputError("does not exist", where=str(path), remedy=f"Give the path of a {kind} file.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", where=str(path), remedy=f"Give a {kind} text file.") from None


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
