"""Animations of a figure as a tree of joints, y up, that looks along +z: BVH and glTF 2.0 binary.

BVH, in cm, from a T-pose (Meredith & Maddock, Motion capture file formats explained, Sheffield CS-01-11, 2001):
a bone's length is constant in most files. Where the take's body was still being refined, each joint gets position
channels as well, which Blender, MotionBuilder and Maya read.

glTF, in metres (Khronos glTF 2.0 specification, 3.4): every joint is a node; every bone shows itself as an octahedron,
so that viewers without skeleton display show the motion. Gaps hold no keys: programs interpolate over them, and
``extras`` of the animation lists them.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pygltflib as gltf
from scipy.spatial.transform import Rotation

from capture_rig.files import write_bytes, write_text

from .joint_tree import JOINTS, PARENTS, JointTree
from .motion import Motion

CM_PER_M = 100
ROTATION_ORDER = "ZXY"
"""Body-fixed, as most BVH files have it; singular where a bone pitches by 90 degrees about x, after its z turn."""
DIGITS = 5
"""A tenth of a micrometre and of a microradian's degree: below any reader's single precision."""


def write_bvh(motion: Motion, path: Path) -> None:
    """Write one person's motion; gaps are filled, since the format has none."""
    tree = JointTree.of_motion(motion)
    lines = ["HIERARCHY", *_joint_lines(tree, 0, 0), "MOTION"]
    lines += [f"Frames: {len(motion)}", f"Frame Time: {1.0 / motion.rate_hz:.9f}"]
    columns = []  # the channels in the order of the hierarchy, which is that of JOINTS
    for joint in range(len(JOINTS)):
        if joint == 0 or not tree.rigid:
            columns.append(CM_PER_M * tree.translations[:, joint])
        columns.append(Rotation.from_matrix(tree.rotations[:, joint]).as_euler(ROTATION_ORDER, degrees=True))
    lines += map(_numbers, np.concatenate(columns, axis=1))
    write_text(path, "\n".join(lines) + "\n")


def _joint_lines(tree: JointTree, joint: int, depth: int) -> Iterator[str]:
    """Describe a joint and all below it."""
    indent, inner = "\t" * depth, "\t" * (depth + 1)
    children = [child for child, parent in enumerate(PARENTS) if parent == joint]
    rotations = " ".join(f"{axis}rotation" for axis in ROTATION_ORDER)
    positions = "Xposition Yposition Zposition " if joint == 0 or not tree.rigid else ""
    yield f"{indent}{'ROOT' if joint == 0 else 'JOINT'} {JOINTS[joint].name}"
    yield f"{indent}{{"
    yield f"{inner}OFFSET {_numbers(CM_PER_M * tree.offsets[joint])}"
    yield f"{inner}CHANNELS {6 if positions else 3} {positions}{rotations}"
    for child in children:
        yield from _joint_lines(tree, child, depth + 1)
    if not children:
        yield from (f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET 0 0 0", f"{inner}}}")
    yield f"{indent}}}"


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.{DIGITS}f}" for value in values)


# glTF -----------------------------------------------------------------------------------------------------------------


BONE_WIDTH = 0.12
"""Of the octahedron, over its length; its waist lies as far along the bone."""
FLOAT, UINT16 = gltf.FLOAT, gltf.UNSIGNED_SHORT


def write_glb(motion: Motion, path: Path) -> None:
    """Write one person's motion."""
    tree, keys = JointTree.of_motion(motion), np.flatnonzero(motion.tracked)
    buffer = _Buffer()
    _add_octahedron(buffer)
    nodes = [gltf.Node(name=joint.name, children=[]) for joint in JOINTS]
    for joint, parent in enumerate(PARENTS):
        nodes[joint].translation = tree.translations[keys[0], joint].tolist()
        nodes[joint].rotation = Rotation.from_matrix(tree.rotations[keys[0], joint]).as_quat().tolist()
        if parent >= 0:
            nodes[parent].children.append(joint)
            nodes[parent].children.append(len(nodes))
            nodes.append(_bone_node(joint, tree.offsets[joint]))
    animation = _animation(buffer, motion, tree, keys)
    document = gltf.GLTF2(
        asset=gltf.Asset(version="2.0", generator="sagoma"),
        scene=0,
        scenes=[gltf.Scene(name=motion.name, nodes=[0])],
        nodes=nodes,
        meshes=[gltf.Mesh(primitives=[gltf.Primitive(attributes=gltf.Attributes(POSITION=0), indices=1)])],
        animations=[animation],
        accessors=buffer.accessors,
        bufferViews=buffer.views,
        buffers=[gltf.Buffer(byteLength=len(buffer.data))],
    )
    document.set_binary_blob(bytes(buffer.data))
    write_bytes(path, b"".join(document.save_to_bytes()))


def _animation(buffer: _Buffer, motion: Motion, tree: JointTree, keys: np.ndarray) -> gltf.Animation:
    """Keys at the tracked frames: rotations of all joints, translations of the root and of bones that change length."""
    times = buffer.add(motion.times_s[keys].astype(np.float32), gltf.SCALAR, bounds=True)
    samplers: list[gltf.AnimationSampler] = []
    channels: list[gltf.AnimationChannel] = []

    def animate(joint: int, path: str, values: np.ndarray, kind: str) -> None:
        output = buffer.add(values.astype(np.float32), kind)
        channels.append(
            gltf.AnimationChannel(sampler=len(samplers), target=gltf.AnimationChannelTarget(node=joint, path=path))
        )
        samplers.append(gltf.AnimationSampler(input=times, output=output, interpolation="LINEAR"))

    for joint in range(len(JOINTS)):
        animate(joint, "rotation", _continuous(tree.rotations[keys, joint]), gltf.VEC4)
        if joint == 0 or not tree.rigid:
            animate(joint, "translation", tree.translations[keys, joint], gltf.VEC3)
    gaps = [[a / motion.rate_hz, b / motion.rate_hz] for a, b in motion.gaps]
    extras = {"gaps_s": gaps} if gaps else {}
    return gltf.Animation(name=motion.name, samplers=samplers, channels=channels, extras=extras)


def _continuous(R: np.ndarray) -> np.ndarray:
    """Quaternions (F, 4), scalar last, of rotations, each with the sign nearer to the one before."""
    quaternions = Rotation.from_matrix(R).as_quat()
    turned_over = np.einsum("fi,fi->f", quaternions[1:], quaternions[:-1]) < 0.0
    quaternions[1:] *= np.where(np.cumsum(turned_over) % 2, -1.0, 1.0)[:, None]
    return quaternions


def _bone_node(joint: int, offset: np.ndarray) -> gltf.Node:
    """Return the octahedron, mesh 0, from a joint's parent to it: along y and of length 1, turned and scaled."""
    length = float(np.linalg.norm(offset))
    turned = Rotation.align_vectors(offset[None] / length, [[0.0, 1.0, 0.0]])[0] if length > 0 else Rotation.identity()
    return gltf.Node(
        name=f"bone_to_{JOINTS[joint].name}", mesh=0, rotation=turned.as_quat().tolist(), scale=[max(length, 1e-6)] * 3
    )


def _add_octahedron(buffer: _Buffer) -> None:
    """Add the bone of length 1 along y; its accessors are the first two."""
    w = BONE_WIDTH
    corners = [[0, 0, 0], [w, w, 0], [0, w, w], [-w, w, 0], [0, w, -w], [0, 1, 0]]
    sides = [(1, 2), (2, 3), (3, 4), (4, 1)]
    faces = [[0, a, b] for a, b in sides] + [[5, b, a] for a, b in sides]
    buffer.add(np.array(corners, np.float32), gltf.VEC3, gltf.ARRAY_BUFFER, bounds=True)
    buffer.add(np.array(faces, np.uint16).ravel(), gltf.SCALAR, gltf.ELEMENT_ARRAY_BUFFER)


class _Buffer:
    """The binary part, and the accessors into it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[gltf.BufferView] = []
        self.accessors: list[gltf.Accessor] = []

    def add(self, values: np.ndarray, kind: str, target: int | None = None, bounds: bool = False) -> int:
        """Append an array, and return its accessor's number."""
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append(gltf.BufferView(buffer=0, byteOffset=len(self.data), byteLength=values.nbytes, target=target))
        self.data += values.tobytes()
        accessor = gltf.Accessor(
            bufferView=len(self.views) - 1,
            componentType=FLOAT if values.dtype == np.float32 else UINT16,
            count=len(values),
            type=kind,
        )
        if bounds:
            flat = values.reshape(len(values), -1)
            accessor.min, accessor.max = flat.min(axis=0).tolist(), flat.max(axis=0).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1
