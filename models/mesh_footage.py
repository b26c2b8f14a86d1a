"""Pictures of rendered mesh people: exact silhouettes, and films in the studio's room as session folders with footage.

The room, its lamps and the sensor are the virtual studio's; the people wear its outfits, shaded triangle by triangle,
and throw the shadow of the capsules around their bones. Footage is MPEG-4, silhouettes are exact and lossless.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from mesh_body import NAMES, SEGMENTS, MeshBody
from mesh_motions import FPS, MeshMotion
from numpy.typing import NDArray

from capture_rig import Rig
from capture_rig.camera import CameraModel
from capture_rig.kernel import njit
from capture_rig.rig import save_rig
from capture_rig.video import VideoFile
from virtual_studio.people import HAIR, OUTFITS, SHIRT, SHOES, SKIN, SLEEVE, TROUSERS, Capsules, Outfit, together
from virtual_studio.recording.session import BACKGROUND_S, FIRST_BACKGROUND_FRAME, FOOTAGE, LOSSLESS
from virtual_studio.rendering.camera import Sensor, VirtualCamera
from virtual_studio.rendering.capsules import floor_shadow, lambert

Array = NDArray[np.float64]

SENSOR = Sensor(noise=2.0, flicker=0.005, seed=15)
"""As bench/rooms.py has it."""
WORN = {"head": SKIN, "neck": SKIN, "upperarm": SLEEVE, "lowerarm": SKIN, "wrist": SKIN, "upperleg": TROUSERS,
        "lowerleg": TROUSERS, "foot": SHOES, "spine05": TROUSERS}  # fmt: skip
"""What covers the skin that moves with a bone; the rest is a shirt."""
THICKNESS = {"upperarm01": 0.05, "lowerarm01": 0.04, "wrist": 0.035, "upperleg01": 0.08, "lowerleg01": 0.05,
             "foot": 0.04, "spine05": 0.13, "spine04": 0.13, "spine03": 0.13, "spine02": 0.13, "spine01": 0.11,
             "head": 0.09}  # fmt: skip
"""Radii, m, of the capsules that throw a body's shadow, by the bone they begin at."""
HAND_M, FOOT_M, HEAD_M = 0.15, 0.18, 0.14
"""How far those without a bone after them reach."""


NEAR_M = 0.1
"""What is nearer to a camera than this is not drawn."""


def mesh_silhouettes(rig: Rig, bodies: list[MeshBody], motions: list[MeshMotion], frame: int) -> dict[str, np.ndarray]:
    """Every camera's picture (H, W), 0 or 255, of the people in one frame."""
    vertices = [
        body.posed(motion.rotations[frame], motion.roots[frame])[0]
        for body, motion in zip(bodies, motions, strict=True)
    ]
    triangles = [body.triangles for body in bodies]
    return {camera.name: silhouette(camera, vertices, triangles) for camera in rig.cameras}


def silhouette(camera: CameraModel, vertices: Iterable[Array], triangles: Iterable[NDArray[np.int32]]) -> np.ndarray:
    """One camera's picture of meshes in the world."""
    canvas = Canvas(np.zeros((camera.height, camera.width), np.float32))
    for points, corners in zip(vertices, triangles, strict=True):
        canvas.draw(camera, points, corners, np.zeros(len(corners)))
    return canvas.mask


class Canvas:
    """A camera's light (h, w), drawn into; depth (h, w) m of what was drawn, and its silhouette (h, w), 0 or 255."""

    def __init__(self, light: NDArray[np.float32]) -> None:
        self.light = light
        self.depth, self.mask = np.full(light.shape, np.inf, np.float32), np.zeros(light.shape, np.uint8)

    def draw(self, camera: CameraModel, vertices: Array, triangles: NDArray[np.int32], shades: Array) -> None:
        """Draws a mesh in the world, triangle t in the light shades[t]."""
        pixels = camera.project(vertices)
        depth = vertices @ camera.R_camera_world[2] + camera.t_camera_world[2]
        pixels[depth < NEAR_M] = np.nan
        _draw(pixels, depth, triangles, shades, self.light, self.depth, self.mask)


@dataclass(frozen=True)
class Look:
    """How people and light look: one of the studio's outfits, and the strength of the floor's shadows, 0 to 1."""

    outfit: str = "middle"
    shadow: float = 0.5


@dataclass(frozen=True, eq=False)
class Dressed:
    """A body in clothes: albedo (T,) of each triangle."""

    body: MeshBody
    albedo: Array

    @classmethod
    def of(cls, body: MeshBody, outfit: Outfit) -> Dressed:
        """Dresses every triangle by the bone that moves its first corner most."""
        cloth = Capsules(np.empty(0), np.empty(0), np.empty(0), np.array([_worn(name) for name in NAMES]))
        of_bone = outfit.albedo_bgr(cloth).mean(axis=1)
        return cls(body, of_bone[body.weights[body.triangles[:, 0]].argmax(axis=1)])

    def light(self, vertices: Array) -> Array:
        """Light (T,) that each triangle reflects, 0..1."""
        corners = vertices[self.body.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return self.albedo * _shading(normals)


def capsules_around(heads: Array, rotations: Array) -> Capsules:
    """The capsules around a posed body's bones, for its shadow."""
    starts, ends, radii = [], [], []
    for bone, name in enumerate(NAMES):
        kind = name.split(".")[0]
        if kind not in THICKNESS:
            continue
        tip = _beyond(kind, name, rotations[bone])
        after = [k for k, n in enumerate(NAMES) if tip is None and _follows(name, n)]
        starts.append(heads[bone])
        ends.append(heads[after[0]] if after else heads[bone] + (0.0 if tip is None else tip))
        radii.append((THICKNESS[kind], THICKNESS[kind]))
    return Capsules(np.array(starts), np.array(ends), np.array(radii), np.full(len(radii), HAIR))


def film(folder: Path, rig: Rig, people: list[MeshBody], motions: list[MeshMotion], look: Look) -> None:
    """Writes the rig, and footage, empty room and exact silhouettes of every camera."""
    folder.mkdir(parents=True, exist_ok=True)
    save_rig(rig, folder / "rig.yaml")
    (folder / "session.yaml").write_text(yaml.safe_dump({"fps": FPS, "source": "rendered by models/mesh_people.py"}))
    dressed = [Dressed.of(body, OUTFITS[look.outfit]) for body in people]
    cameras = [VirtualCamera(model) for model in rig.cameras]
    with ExitStack() as stack:
        for number, camera in enumerate(cameras):
            with VideoFile(folder / f"{camera.camera.name}_background{FOOTAGE}", FPS) as video:
                for frame in range(round(BACKGROUND_S * FPS)):
                    video.write(SENSOR.expose(camera.empty_room(), number, FIRST_BACKGROUND_FRAME + frame))
        films = [stack.enter_context(VideoFile(folder / f"{model.name}{FOOTAGE}", FPS)) for model in rig.cameras]
        masks = [stack.enter_context(VideoFile(folder / f"{model.name}_mask{LOSSLESS}", FPS)) for model in rig.cameras]
        for frame in range(min(map(len, motions))):
            moves = [(motion.rotations[frame], motion.roots[frame]) for motion in motions]
            posed = [body.posed(*move) for body, move in zip(people, moves, strict=True)]
            throwing = [capsules_around(heads, move[0]) for (_, heads), move in zip(posed, moves, strict=True)]
            shadow = floor_shadow(together(*throwing), look.shadow)
            for number, camera in enumerate(cameras):
                canvas = Canvas(camera.shaded_room(shadow))
                for one, (vertices, _) in zip(dressed, posed, strict=True):
                    canvas.draw(camera.camera, vertices, one.body.triangles, one.light(vertices))
                films[number].write(SENSOR.expose(canvas.light, number, frame))
                masks[number].write(canvas.mask)


def write_truth(path: Path, rows: list[dict[str, Array]]) -> None:
    """Writes truth.csv, the points of every frame in metres, in the test data's columns."""
    names = [*TRUTH_ORDER]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["frame", *(f"{name}_{axis}" for name in names for axis in "xyz")])
        for frame, row in enumerate(rows):
            writer.writerow([frame, *(f"{value:.5f}" for name in names for value in row[name])])


SIDED = ("shoulder", "elbow", "wrist", "hand_tip", "hip", "knee", "ankle", "toe_tip")
TRUTH_ORDER = ("pelvis", "torso_centroid", "neck", "head_top", *(f"{side}_{name}" for name in SIDED for side in "lr"))


def _worn(bone: str) -> float:
    return next((cloth for begin, cloth in WORN.items() if bone.startswith(begin)), SHIRT)


def _follows(name: str, other: str) -> bool:
    """Tells the bone that a capsule ends at: the next one of the same limb, or of the spine."""
    limb = {"upperarm01": "lowerarm01", "lowerarm01": "wrist", "upperleg01": "lowerleg01", "lowerleg01": "foot"}
    kind, _, side = name.partition(".")
    return other == f"{limb[kind]}.{side}" if kind in limb else not side and SEGMENTS.get(other) == name


def _beyond(kind: str, name: str, rotation: Array) -> Array | None:
    """From the head of a bone without one after it to its capsule's end."""
    if kind == "head":
        return np.asarray(rotation @ [0.0, -0.02, HEAD_M])
    if kind == "foot":
        return np.asarray(rotation @ [0.0, -FOOT_M, -0.04])
    if kind == "wrist":
        out = 1.0 if name.endswith("L") else -1.0
        return HAND_M * np.asarray(rotation @ [0.4 * out, -0.7, -0.6])
    return None


@njit(cache=True)
def _shading(normals: Array) -> Array:
    light = np.empty(len(normals))
    for k in range(len(normals)):
        light[k] = lambert(normals[k, 0], normals[k, 1], normals[k, 2])
    return light


@njit(cache=True)
def _draw(
    pixels: Array,
    away: Array,
    triangles: NDArray[np.int32],
    shades: Array,
    light: NDArray[np.float32],
    depth: NDArray[np.float32],
    mask: NDArray[np.uint8],
) -> None:
    """Sets the pixels whose centres, at whole numbers, lie in a triangle or on its edge, where it is the nearest."""
    height, width = mask.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1], pixels[c, 0], pixels[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if not area * area > 0.0:
            continue
        distance = (away[a] + away[b] + away[c]) / 3.0
        left, right = max(0.0, np.ceil(min(ax, bx, cx))), min(width - 1.0, np.floor(max(ax, bx, cx)))
        top, bottom = max(0.0, np.ceil(min(ay, by, cy))), min(height - 1.0, np.floor(max(ay, by, cy)))
        sign = 1.0 if area > 0.0 else -1.0
        for y in range(int(top), int(bottom) + 1):
            for x in range(int(left), int(right) + 1):
                if (
                    sign * ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) >= 0.0
                    and sign * ((cx - bx) * (y - by) - (cy - by) * (x - bx)) >= 0.0
                    and sign * ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) >= 0.0
                    and distance < depth[y, x]
                ):
                    depth[y, x], light[y, x], mask[y, x] = distance, shades[t], 255
