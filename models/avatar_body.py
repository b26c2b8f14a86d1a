"""A skinned avatar (GLB) as a body of `mesh_body`: any maker's skeleton on the segments that the clips move.

The file has no compression and one pose at rest, a T-pose or arms that hang at a slant (`models/avatar_people.py` says
where such files come from). Joints are known by their names (Mixamo, VRM, Biped, Blender's `.L` and `.R`): each of the
skeleton's joints moves with the segment of the nearest named joint towards its root, so hair goes with the head and a
skirt with the pelvis. Segments that a skeleton lacks lie between their neighbours and carry no vertex.

Truth are the avatar's own joints; finger tips and the top of the head are vertices of its surface, with hair and hat.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pygltflib
from mesh_body import NAMES, SEGMENTS, MeshBody
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

WORLD_FROM_GLTF = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""y up, facing z, into z up, facing -y; x is the person's left in both."""
PREFIX = re.compile(r"^(mixamorig\d*|bip0?\d*|j_bip|b)[ :_]+(c_)?", re.IGNORECASE)
ONE_OF = {
    "spine05": ("hips", "pelvis"),
    "neck01": ("neck", "neck01"),
    "head": ("head",),
    "clavicle": ("shoulder", "clavicle", "collar"),
    "upperarm01": ("arm", "upperarm"),
    "lowerarm01": ("forearm", "lowerarm"),
    "wrist": ("hand", "wrist"),
    "upperleg01": ("upleg", "thigh", "upperleg"),
    "lowerleg01": ("leg", "calf", "lowerleg", "shin"),
    "foot": ("foot", "ankle"),
}
"""Segments and how makers call the joints at which they begin, without side and prefix."""
INSIDE = re.compile("eye|gland|teeth|tongue", re.IGNORECASE)
"""Meshes that no camera sees from outside."""
SPINE = ("spine04", "spine03", "spine02", "spine01")
DTYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
STATURES_M, USUAL_M = (1.4, 2.1), 1.75  # an avatar of another stature is one of other units: scaled to the usual one


def load_avatar(path: Path) -> MeshBody:
    """Read an avatar. Raises ValueError where its skeleton lacks a segment that is no part of spine or neck."""
    gltf = pygltflib.GLTF2().load(str(path))
    blob, places, parents = gltf.binary_blob(), _rest(gltf), _parents(gltf)
    joints = _named_joints(gltf, parents)
    segment_of = {node: NAMES.index(name) for name, node in joints.items()}
    vertices, triangles, weights = [], [], []
    for node in gltf.nodes:
        if node.mesh is None or node.skin is None or INSIDE.search(node.name or ""):
            continue
        skin = gltf.skins[node.skin]
        inverses = _accessor(gltf, blob, skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
        motions = np.array([places[j] for j in skin.joints]) @ inverses
        segments = np.array([_segment(j, segment_of, parents) for j in skin.joints])
        for primitive in gltf.meshes[node.mesh].primitives:
            own = _accessor(gltf, blob, primitive.attributes.POSITION)
            shares = _accessor(gltf, blob, primitive.attributes.WEIGHTS_0).astype(float)
            shares /= shares.sum(axis=1, keepdims=True)
            chosen = _accessor(gltf, blob, primitive.attributes.JOINTS_0).astype(int)
            blended = np.einsum("vk,vkij->vij", shares, motions[chosen])
            placed = np.einsum("vij,vj->vi", blended[:, :3, :3], own) + blended[:, :3, 3]
            of_segment = np.zeros((len(own), len(NAMES)))
            np.add.at(of_segment, (np.arange(len(own))[:, None], segments[chosen]), shares)
            triangles.append(_accessor(gltf, blob, primitive.indices).reshape(-1, 3) + sum(map(len, vertices)))
            vertices.append(placed)
            weights.append(of_segment)
    V, T, W = np.concatenate(vertices) @ WORLD_FROM_GLTF.T, np.concatenate(triangles), np.concatenate(weights)
    heads = _heads({name: WORLD_FROM_GLTF @ places[node][:3, 3] for name, node in joints.items()})
    floor, stature = V[:, 2].min(), np.ptp(V[:, 2])
    scale = 1.0 if STATURES_M[0] < stature < STATURES_M[1] else USUAL_M / stature
    V, heads = scale * (V - [0.0, 0.0, floor]), scale * (heads - [0.0, 0.0, floor])
    return MeshBody(V, T.astype(np.int32), heads, W.astype(np.float32), _trunk(V, T, W), _tips(V, W, heads))


def _named_joints(gltf: pygltflib.GLTF2, parents: dict[int, int]) -> dict[str, int]:
    """The node of each segment that the skeleton has."""
    candidates = {joint for skin in gltf.skins for joint in skin.joints}
    joints: dict[str, int] = {}
    for node in sorted(candidates):
        name, side = _plain_name(gltf.nodes[node].name)
        for segment, names in ONE_OF.items():
            if name in names and (f"{segment}.{side}" if side else segment) in SEGMENTS:
                joints.setdefault(f"{segment}.{side}" if side else segment, node)
    missing = [n for n in NAMES if n not in joints and n not in SPINE and n != "neck02"]
    if missing:
        raise ValueError(f"no joints for {missing} among {[gltf.nodes[n].name for n in sorted(candidates)]}")
    between, node = [], parents[joints["neck01"]]
    while node != joints["spine05"] and node in parents:
        between.insert(0, node)
        node = parents[node]
    for k, node in enumerate(between, 1):
        joints[SPINE[max(round(4.0 * k / len(between)), 1) - 1]] = node
    return joints


def _plain_name(name: str) -> tuple[str, str]:
    """A joint's name in small letters, without prefix and side, and its side: L, R or none."""
    name = PREFIX.sub("", name)
    found = re.search(r"^(left|right)|(?:^|[ _.])([lr])(?:$|[ _.])", name, re.IGNORECASE)
    side = (found.group(1) or found.group(2))[0].upper() if found else ""
    plain = name[: found.start()] + name[found.end() :] if found else name
    return re.sub(r"[ _.:]", "", plain).lower(), side


def _heads(known: dict[str, Array]) -> Array:
    """Where the segments begin (S, 3): those that a skeleton lacks lie evenly between the next ones that it has."""
    chain = ["spine05", *SPINE, "neck01", "neck02", "head"]
    at = [k for k, name in enumerate(chain) if name in known]
    between = [np.interp(range(len(chain)), at, [known[chain[k]][axis] for k in at]) for axis in range(3)]
    known = known | dict(zip(chain, np.transpose(between), strict=True))
    return np.array([known[name] for name in NAMES])


def _segment(node: int, segment_of: dict[int, int], parents: dict[int, int]) -> int:
    while node not in segment_of and node in parents:
        node = parents[node]
    return segment_of.get(node, 0)


def _parents(gltf: pygltflib.GLTF2) -> dict[int, int]:
    return {child: k for k, node in enumerate(gltf.nodes) for child in node.children or []}


def _rest(gltf: pygltflib.GLTF2) -> list[Array]:
    """Every node's place (4, 4) at rest."""
    parents, places = _parents(gltf), {}

    def place(k: int) -> Array:
        if k not in places:
            own = _local(gltf.nodes[k])
            places[k] = place(parents[k]) @ own if k in parents else own
        return places[k]

    return [place(k) for k in range(len(gltf.nodes))]


def _local(node: pygltflib.Node) -> Array:
    if node.matrix is not None:
        return np.array(node.matrix, float).reshape(4, 4).T
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(node.rotation or [0.0, 0.0, 0.0, 1.0]).as_matrix() * (node.scale or [1.0, 1.0, 1.0])
    T[:3, 3] = node.translation or [0.0, 0.0, 0.0]
    return T


def _accessor(gltf: pygltflib.GLTF2, blob: bytes, index: int) -> np.ndarray:
    """An accessor's rows (n, width); normalised integers as shares of one."""
    accessor = gltf.accessors[index]
    view, dtype, width = gltf.bufferViews[accessor.bufferView], DTYPES[accessor.componentType], WIDTHS[accessor.type]
    size = np.dtype(dtype).itemsize * width
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    rows = np.ndarray((accessor.count, width), dtype, blob, start, (view.byteStride or size, np.dtype(dtype).itemsize))
    return rows / float(np.iinfo(dtype).max) if accessor.normalized else rows.copy()


def _trunk(V: Array, T: NDArray[np.int64], W: Array) -> Array:
    """Share of each vertex in the trunk's surface."""
    corners = V[T]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    of_trunk = W[:, [NAMES.index(n) for n in ("spine05", *SPINE, "clavicle.L", "clavicle.R")]].sum(axis=1) > 0.5
    shares = np.bincount(T.ravel(), np.repeat(areas, 3), len(V)) * of_trunk
    return np.asarray(shares / shares.sum())


def _tips(V: Array, W: Array, heads: Array) -> dict[str, int]:
    """Vertices of the surface: top of the head, what reaches farthest beyond a wrist, and forward of an ankle."""
    own = {name: np.flatnonzero(W[:, k] > 0.5) for k, name in enumerate(NAMES)}
    tips = {"head_top": int(own["head"][np.argmax(V[own["head"], 2])])}
    for side in "LR":
        hand, foot = own[f"wrist.{side}"], own[f"foot.{side}"]
        way = heads[NAMES.index(f"wrist.{side}")] - heads[NAMES.index(f"lowerarm01.{side}")]
        tips[f"{side.lower()}_hand_tip"] = int(hand[np.argmax(V[hand] @ way)])
        tips[f"{side.lower()}_toe_tip"] = int(foot[np.argmin(V[foot, 1])])
    return tips
