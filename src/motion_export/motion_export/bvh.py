"""Biovision hierarchy files (BVH): centimetres, y up, a T-pose that looks along +z.

Source: Meredith & Maddock, Motion capture file formats explained, Sheffield CS-01-11, 2001.

A bone's length is constant in most BVH files. Where the take's body was still being refined, each joint gets position
channels as well, which Blender, MotionBuilder and Maya read; ``constant_bones`` leaves them out.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.files import write_text

from .joint_tree import JOINTS, PARENTS, JointTree
from .motion import Motion

CM_PER_M = 100
ROTATION_ORDER = "ZXY"
"""Body-fixed, as most BVH files have it; singular where a bone pitches by 90 degrees about x, after its z turn."""
DIGITS = 5
"""A tenth of a micrometre and of a microradian's degree: below any reader's single precision."""


def write_bvh(motion: Motion, path: Path, *, constant_bones: bool = False) -> None:
    """Write one person's motion; gaps are filled, since the format has none."""
    tree = JointTree.of_motion(motion)
    moving = not (tree.rigid or constant_bones)
    lines = ["HIERARCHY", *_joint_lines(tree, 0, 0, moving), "MOTION"]
    lines += [f"Frames: {len(motion)}", f"Frame Time: {1.0 / motion.rate_hz:.9f}"]
    write_text(path, "\n".join([*lines, *_rows(tree, moving)]) + "\n")


def _joint_lines(tree: JointTree, joint: int, depth: int, moving: bool) -> Iterator[str]:
    """Describe a joint and all below it."""
    indent, inner = "\t" * depth, "\t" * (depth + 1)
    children = [child for child, parent in enumerate(PARENTS) if parent == joint]
    rotations = " ".join(f"{axis}rotation" for axis in ROTATION_ORDER)
    positions = "Xposition Yposition Zposition " if _has_positions(joint, moving) else ""
    yield f"{indent}{'ROOT' if joint == 0 else 'JOINT'} {JOINTS[joint].name}"
    yield f"{indent}{{"
    yield f"{inner}OFFSET {_numbers(CM_PER_M * tree.offsets[joint])}"
    yield f"{inner}CHANNELS {6 if positions else 3} {positions}{rotations}"
    for child in children:
        yield from _joint_lines(tree, child, depth + 1, moving)
    if not children:
        yield from (f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET 0 0 0", f"{inner}}}")
    yield f"{indent}}}"


def _rows(tree: JointTree, moving: bool) -> Iterator[str]:
    """One line a frame: the channels in the order of the hierarchy, which is that of JOINTS."""
    columns = []
    for joint in range(len(JOINTS)):
        if _has_positions(joint, moving):
            columns.append(CM_PER_M * tree.translations[:, joint])
        columns.append(Rotation.from_matrix(tree.rotations[:, joint]).as_euler(ROTATION_ORDER, degrees=True))
    return (_numbers(row) for row in np.concatenate(columns, axis=1))


def _has_positions(joint: int, moving: bool) -> bool:
    return joint == 0 or moving


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.{DIGITS}f}" for value in values)
