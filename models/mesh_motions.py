"""What the rendered mesh people do: the clips of DeepMimic, put on the bones of `mesh_body`.

The clips (motion capture of CMU and SFU, turned into joint rotations by Peng et al., "DeepMimic", ACM TOG 37(4), 2018)
come with the package `pybullet` (PyPI) as pybullet_data/data/motions/humanoid3d_*.txt: a row for each frame with its
duration, the root's place and quaternion (w first), and a quaternion or hinge angle for each joint. At rest that figure
stands upright with its arms hanging; x is forward, y up, z right.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mesh_body import NAMES, PARENTS, MeshBody
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from capture_rig.errors import InputError

Array = NDArray[np.float64]

FPS, T_POSE_S = 60.0, 1.0
"""As in the test data, as is half a second from the T-pose into most clips."""
MESH_FROM_CLIP = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
CLIP_LEG = (1.686184 + 1.639480) / 4.0
"""Hip to ankle of the clips' figure, m (pybullet_data/humanoid/humanoid.urdf, drawn four times as large)."""
COLUMNS = {"root": 4, "chest": 8, "neck": 12} | {
    f"{joint}.{side}": column + (14 if side == "L" else 0)
    for side in "RL"
    for joint, column in {"hip": 16, "knee": 20, "ankle": 21, "shoulder": 25, "elbow": 29}.items()
}
"""Where a joint's quaternion or, at knees and elbows, its angle begins in a row."""
TURNING_S = 0.15
"""Time in which a clip played there and back slows down to its end: nobody reverses in a sixtieth of a second."""
RAISED, WITH_THE_ARM = np.radians(30.0), 0.4
"""A shoulder girdle turns with its arm by about a third to a half of what the arm is raised beyond 30 degrees (Inman,
Saunders & Abbott 1944)."""
STRAIGHT = 0.1
"""Sine of an elbow's angle at rest below which it does not show the hinge: such arms are modelled palms down or in."""
NO_CLIPS = "Unpack the wheel of `pybullet` (pip download pybullet --no-deps) and name pybullet_data/data/motions."


class Play(NamedTuple):
    """How a clip is played.

    clip : its name. way : "loop" (its path goes on), "there and back", or "back and there" (from its last frame).
    from_s : where it begins. speed : times its own. turn : rad/s that the path bends. kept : share of its way kept.
    grounded : the lowest point of every frame is on the floor, else that of the clip. blend_s : T-pose to clip.
    """

    clip: str
    way: str = "there and back"
    from_s: float = 0.0
    speed: float = 1.0
    turn: float = 0.0
    kept: float = 1.0
    grounded: bool = True
    blend_s: float = 0.5


@dataclass(frozen=True, eq=False)
class MeshMotion:
    """Bones' rotations (F, S, 3, 3) in the world and places (F, 3) of the first one's head, m, at FPS."""

    rotations: Array
    roots: Array

    def __len__(self) -> int:
        return len(self.roots)

    def moved(self, yaw: float, shift: tuple[float, float]) -> MeshMotion:
        """Turned about the vertical axis through the origin, then moved across the floor."""
        R = Rotation.from_euler("z", yaw).as_matrix()
        return MeshMotion(R @ self.rotations, self.roots @ R.T + np.array([*shift, 0.0]))


def play(folder: Path, body: MeshBody, how: Play, seconds: float, from_t_pose: bool = True) -> MeshMotion:
    """A clip on a body, its path around the origin; with the T-pose and the blend into it first.

    Raises InputError where the clips are not.
    """
    path = folder / f"humanoid3d_{how.clip}.txt"
    if not path.is_file():
        raise InputError("is not there", where=str(path), remedy=NO_CLIPS)
    rows = np.array(json.loads(path.read_text())["Frames"])
    opening = T_POSE_S + how.blend_s if from_t_pose else 0.0
    times = how.from_s + how.speed * np.arange(round((seconds - opening) * FPS)) / FPS
    joints, way = _sampled(rows, times, how)
    turns = Rotation.from_euler("z", how.turn * np.arange(len(times))[:, None] / FPS)
    joints["root"] = turns * joints["root"]
    scale = _leg(body) / CLIP_LEG
    steps = np.diff(way, axis=0, prepend=way[:1])
    steps[:, :2] *= how.kept
    roots = scale * np.cumsum(turns.apply(steps), axis=0)
    roots[:, 2] = scale * way[:, 2]
    roots[:, :2] -= 0.5 * (roots[:, :2].min(axis=0) + roots[:, :2].max(axis=0))
    rotations = _on_bones(body, joints)
    if from_t_pose:
        rotations = np.concatenate([_opening(body, rotations[0], how.blend_s), rotations])
        still = np.repeat(roots[:1], len(rotations) - len(roots), axis=0)
        roots = np.concatenate([still, roots])
    return MeshMotion(rotations, _on_the_floor(body, rotations, roots, how.grounded, round(opening * FPS)))


def _sampled(rows: Array, times: Array, how: Play) -> tuple[dict[str, Rotation], Array]:
    """Each joint's rotation about its parent, in the mesh's axes, and the root's way (F, 3) in the clip's size.

    What the end of a lap differs from its beginning is spread over the lap.
    """
    begins = np.append(0.0, np.cumsum(rows[:-1, 0]))
    length = begins[-1]
    if how.way == "loop":
        laps, within = np.divmod(times, length)
    else:
        within = np.abs((times + (length if how.way == "back and there" else 0.0)) % (2.0 * length) - length)
        within, laps = _rounded(length - within, length), np.zeros(len(times))
    seam = within / length if how.way == "loop" else np.zeros(len(times))
    place = np.stack([np.interp(within, begins, rows[:, k]) for k in (1, 2, 3)], axis=1)
    lap = rows[-1, 1:4] - rows[0, 1:4]
    place += laps[:, None] * lap * [1.0, 0.0, 1.0] - seam[:, None] * lap * [0.0, 1.0, 0.0]
    M = Rotation.from_matrix(MESH_FROM_CLIP)
    joints = {}
    for name, column in COLUMNS.items():
        if name.startswith(("knee", "elbow")):
            angle = np.interp(within, begins, rows[:, column]) - seam * (rows[-1, column] - rows[0, column])
            turned = Rotation.from_euler("z", angle[:, None])
        else:
            keys = Rotation.from_quat(rows[:, [column + 1, column + 2, column + 3, column]])
            gap = (keys[-1].inv() * keys[0]).as_rotvec()
            turned = Slerp(begins, keys)(within) * Rotation.from_rotvec(seam[:, None] * gap)
        joints[name] = M * turned * M.inv()
    return joints, place @ MESH_FROM_CLIP.T


def _rounded(within: Array, length: float) -> Array:
    """Times in a clip that is played there and back, slowed down within TURNING_S of its ends."""
    left = np.minimum(within, length - within)
    eased = np.where(left < TURNING_S, (TURNING_S**2 + left**2) / (2.0 * TURNING_S), left)
    return np.where(within < 0.5 * length, eased, length - eased)


def _on_bones(body: MeshBody, joint: dict[str, Rotation]) -> Array:
    """Rotations (F, S, 3, 3) of the bones from their rest, from the joints' rotations."""
    turned = {"spine05": joint["root"]}
    for k, bone in enumerate(("spine04", "spine03", "spine02", "spine01"), 1):
        turned[bone] = joint["root"] * _part(joint["chest"], 0.25 * k)
    chest = turned["spine01"]
    for k, bone in enumerate(("neck01", "neck02", "head"), 1):
        turned[bone] = chest * _part(joint["neck"], k / 3.0)
    for s in "LR":
        arm, leg = chest * joint[f"shoulder.{s}"], joint["root"] * joint[f"hip.{s}"]
        fore, calf = arm * joint[f"elbow.{s}"], leg * joint[f"knee.{s}"]
        A, B = _hanging(body, s)
        turned[f"clavicle.{s}"] = _girdle(chest, arm)
        turned |= {f"upperarm01.{s}": arm * A, f"lowerarm01.{s}": fore * B, f"wrist.{s}": fore * B}
        for bone, end, R in (("upperleg01", "lowerleg01", leg), ("lowerleg01", "foot", calf)):
            turned[f"{bone}.{s}"] = R * _onto(body.head(f"{end}.{s}") - body.head(f"{bone}.{s}"), (0.0, 0.0, -1.0))
        turned[f"foot.{s}"] = calf * joint[f"ankle.{s}"]
    return np.stack([turned[name].as_matrix() for name in NAMES], axis=1)


def _part(rotation: Rotation, share: float) -> Rotation:
    return Rotation.from_rotvec(share * rotation.as_rotvec())


def _onto(way: Array, target: tuple[float, float, float]) -> Rotation:
    """The least rotation that turns one direction onto another."""
    a, b = way / np.linalg.norm(way), np.array(target)
    axis = np.cross(a, b)
    angle = np.arctan2(np.linalg.norm(axis), a @ b)
    return Rotation.from_rotvec(angle * axis / max(float(np.linalg.norm(axis)), 1e-12))


def _hanging(body: MeshBody, side: str) -> tuple[Rotation, Rotation]:
    """What turns upper arm and forearm from rest into hanging straight down, the elbow's hinge across the body."""
    shoulder, elbow, wrist = (body.head(f"{bone}.{side}") for bone in ("upperarm01", "lowerarm01", "wrist"))
    down = _onto(elbow - shoulder, (0.0, 0.0, -1.0))
    ahead = down.apply(wrist - elbow)
    bent = np.hypot(ahead[0], ahead[1]) > STRAIGHT * np.linalg.norm(ahead)
    yaw = np.arctan2(ahead[0], -ahead[1]) if bent else 0.0  # of the bent forearm, from straight ahead, -y
    A = Rotation.from_euler("z", -yaw) * down
    return A, _onto(A.apply(wrist - elbow), (0.0, 0.0, -1.0)) * A


def _girdle(chest: Rotation, arm: Rotation) -> Rotation:
    """A collar bone's rotation: with the chest, and a share of how far the arm is raised."""
    way = (chest.inv() * arm).apply([0.0, 0.0, -1.0])
    axis = np.cross([0.0, 0.0, -1.0], way)
    raised = np.arctan2(np.linalg.norm(axis, axis=1), -way[:, 2])
    angle = WITH_THE_ARM * np.clip(raised - RAISED, 0.0, None) * np.clip(np.hypot(way[:, 0], 0.0), 0.0, 1.0)
    lift = Rotation.from_rotvec(np.array([0.0, 1.0, 0.0]) * (-np.sign(way[:, 0]) * angle)[:, None])
    return chest * lift


def t_pose(body: MeshBody) -> Array:
    """Rotations (S, 3, 3) of the bones from rest: arms straight out to the sides, all else as at rest."""
    rotations = np.tile(np.eye(3), (len(NAMES), 1, 1))
    for side, out in (("L", (1.0, 0.0, 0.0)), ("R", (-1.0, 0.0, 0.0))):
        for bone, end in (("upperarm01", "lowerarm01"), ("lowerarm01", "wrist")):
            R = _onto(body.head(f"{end}.{side}") - body.head(f"{bone}.{side}"), out).as_matrix()
            rotations[NAMES.index(f"{bone}.{side}")] = R
        rotations[NAMES.index(f"wrist.{side}")] = R
    return rotations


def _opening(body: MeshBody, first: Array, blend_s: float) -> Array:
    """T-pose and blend into the first frame, facing its way: every bone turns evenly against its parent."""
    ahead = first[0] @ np.array([0.0, -1.0, 0.0])
    yaw = np.arctan2(ahead[0], -ahead[1])
    start = Rotation.from_euler("z", yaw).as_matrix() @ t_pose(body)
    still, ways = round(T_POSE_S * FPS), np.linspace(0.0, 1.0, round(blend_s * FPS), endpoint=False)
    blend = np.empty((len(ways), *start.shape))
    for bone, parent in enumerate(PARENTS):
        a, b = (R[bone] if parent < 0 else R[parent].T @ R[bone] for R in (start, first))
        local = Slerp([0.0, 1.0], Rotation.from_matrix([a, b]))(ways).as_matrix()
        blend[:, bone] = local if parent < 0 else blend[:, parent] @ local
    return np.concatenate([np.repeat(start[None], still, axis=0), blend])


def _on_the_floor(body: MeshBody, rotations: Array, roots: Array, grounded: bool, opening: int) -> Array:
    """The way with feet, or what is lowest, on the floor, and nothing under it."""
    lowest = np.array([body.posed(R, root)[0][:, 2].min() for R, root in zip(rotations, roots, strict=True)])
    floor = np.full(len(roots), np.percentile(lowest[opening:], 5.0))
    down = lowest if grounded else np.minimum(lowest, floor)
    down[:opening] = lowest[:opening]
    return roots - down[:, None] * np.array([0.0, 0.0, 1.0])


def _leg(body: MeshBody) -> float:
    joints = [body.head(f"{bone}.L") for bone in ("upperleg01", "lowerleg01", "foot")]
    return float(sum(np.linalg.norm(np.diff(joints, axis=0), axis=1)))
