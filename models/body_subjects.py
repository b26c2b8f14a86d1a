"""Whose outlines builds are learnt from: posed bodies with rays that touch them and the frames of their parts.

Two kinds: rendered people (MakeHuman's mesh, random phenotypes, in clips) and the studio's, whose flesh is centred on
the bones. Capsules of rendered people are fixed to their true bones, hands and feet in frames of their own that start
at wrist and ankle; those of the studio's people to the sticks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mesh_body import NAMES, MeshBody, Phenotype, make_body
from mesh_motions import Play, play
from mesh_outline_rays import SPHERE, SPHERE_TRIANGLES, hull_of_spheres, ring_of_rays
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.body_surface import EXTREMITY_CAPSULES, BodySurface
from stick_figure.kinematics import inverse
from stick_figure.least_squares.contour_factor import RayArrays, RayMatch, match_rays
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place
from stick_figure.pose import Pose
from stick_figure.skeleton import L_CALF, L_FOREARM, R_CALF, R_FOREARM, STICK_AXIS, STICK_SIGN, TORSO
from virtual_studio.people import VolumetricBody, person_of

Array = NDArray[np.float64]

CLIPS = (
    Play("walk", "loop", turn=1.25),
    Play("punch"),
    Play("spin", from_s=0.8),
    Play("dance_a"),
    Play("run", "loop", turn=1.6, kept=0.35, grounded=False),
    Play("kick"),
    Play("getup_facedown", "back and there", from_s=0.4, speed=1.3),
)
"""Those that sets called mesh_fit_ play; walk and punch occur in mesh_prove_ too, with other bodies."""
MESH_SEED, STUDIO_SEED, AVATAR_SEED = 77, 3, 11
CLIPS_EACH, FRAMES_EACH, CLIP_S, MOVING = 3, 4, 4.0, 90  # frames from which on most bodies have left the T-pose
CLOTHED_CLIP_S = 3.0
WRIST_SD = 0.3  # rad: the clips hold wrists straight
VIEWS, RAYS, HALF_STRETCH_M = 8, 110, 0.06
POSES_OF_SESSIONS = (
    *("walk_ring5top_exact", "charleston_ring5top_exact", "zombie_he3_exact", "two_ring8_exact"),
    "charleston2_ring5top_drift_exact",
)
"""Sets of bench/people.py in whose true poses, one of EVERY, the studio's people stand: poses alone, not bodies."""
EVERY, STUDIO_POSES, OPENING = 40, 8, 60
STARTS, ENDS = (-1, 2, 3, 4, 5, 6, 7, 8, 9, 10), (2, 1, 7, 8, 9, 10, 11, 12, 13, 14)  # reference points of the sticks
EXTRA = {L_FOREARM: "l_wrist", R_FOREARM: "r_wrist", L_CALF: "l_toe_tip", R_CALF: "r_toe_tip"}


@dataclass(frozen=True, eq=False)
class View:
    """One pose: its state, each capsule's frame (k, 3, 3) and origin (k, 3) in the world, rays and their normals."""

    state: PoseState
    frames: Array
    origins: Array
    rays: RayArrays
    normals: Array

    def against(self, body: Body, surface: BodySurface) -> tuple[RayMatch, Array]:
        """Which capsule explains each ray, and the ray's normal (n, 3) in that capsule's frame."""
        placed = place(self.state, BodyModel(body.lengths, body.stick_origins_torso, surface))
        starts, ends = (
            np.einsum("kij,kj->ki", self.frames, end) + self.origins for end in (surface.start, surface.end)
        )
        match = match_rays(self.rays, placed._replace(P=starts, Q=ends), 0.0)
        return match, np.einsum("kij,ki->kj", self.frames[match.capsule], self.normals)


@dataclass(frozen=True, eq=False)
class Subject:
    """A body, its stature (m) and its views. wrist (3,) : in the forearm's frame at rest, m; NaN where unknown.
    forearm_m : elbow to finger tips at rest."""

    body: Body
    stature: float
    views: list[View]
    wrist: Array
    forearm_m: float


def rendered_people(data: Path, motions: Path, count: int, poses: int, stick: NDArray[np.int64]) -> Iterator[Subject]:
    """Random people in CLIPS_EACH clips, ``poses`` of each. stick (k,) : that each capsule is fixed to."""
    random = np.random.default_rng(MESH_SEED)
    for k in range(count):
        mesh, stature = random_mesh(data, k, random)
        yield _subject(mesh, stature, motions, CLIP_S, poses, stick, random, MOVING if k % 3 else 0)


def people_in_clothes(
    avatars: Iterable[MeshBody], motions: Path, poses: int, stick: NDArray[np.int64]
) -> Iterator[Subject]:
    """Avatars in clips as the rendered people, their own joints for bones."""
    random = np.random.default_rng(AVATAR_SEED)
    for mesh in avatars:
        stature = float(np.ptp(mesh.vertices[:, 2]))
        yield _subject(mesh, stature, motions, CLOTHED_CLIP_S, poses, stick, random, MOVING)


def _subject(
    mesh: MeshBody,
    stature: float,
    motions: Path,
    seconds: float,
    poses: int,
    stick: NDArray[np.int64],
    random: np.random.Generator,
    first: int,
) -> Subject:
    """A mesh in CLIPS_EACH random clips of ``seconds``, ``poses`` of each from frame ``first`` on."""
    still = mesh.truth(*mesh.posed(np.tile(np.eye(3), (len(NAMES), 1, 1)), mesh.heads[0]))
    shown = []
    for clip in random.permutation(len(CLIPS))[:CLIPS_EACH]:
        motion = play(motions, mesh, CLIPS[clip], seconds)
        for frame in random.integers(first, len(motion), poses):
            rotations = motion.rotations[frame].copy()
            for side in "LR":
                bent = Rotation.from_rotvec(WRIST_SD * random.standard_normal(3)).as_matrix()
                rotations[NAMES.index(f"wrist.{side}")] = rotations[NAMES.index(f"wrist.{side}")] @ bent
            vertices, heads = mesh.posed(rotations, motion.roots[frame])
            shown.append((vertices, mesh.truth(vertices, heads)))
    points = np.array([_fifteen(truth) for _, truth in shown])
    body, views = Body.from_points(points), []
    rest = _at_rest(body, still)
    for (vertices, truth), there in zip(shown, points, strict=True):
        rays = ring_of_rays(vertices, mesh.triangles, VIEWS, RAYS, random)
        pose = inverse(body, there)
        views.append(_view(pose, *_own_frames(body, pose, there, truth, rest, stick), rays))
    wrist, forearm = rest[L_FOREARM]
    return Subject(body, stature, views, wrist, forearm)


def people_of_the_studio(poses: Sequence[Pose], count: int, stick: NDArray[np.int64]) -> Iterator[Subject]:
    """Capsule people of random stature, limbs and girth in some of the poses."""
    random = np.random.default_rng(STUDIO_SEED)
    for _ in range(count):
        stature = random.uniform(1.5, 1.95)
        body = person_of(stature, random.uniform(0.93, 1.07), random.uniform(0.95, 1.05))
        person, views = VolumetricBody(body, random.uniform(0.8, 1.35)), []
        for k in random.permutation(len(poses))[:STUDIO_POSES]:
            pose = Pose(np.array([0.0, 0.0, 1.0]), *poses[k].arrays[1:])
            parts = person.place(pose)
            shapes = zip(parts.starts, parts.ends, *parts.radii.T, strict=True)
            vertices = np.concatenate([hull_of_spheres(*shape) for shape in shapes])
            triangles = np.concatenate([SPHERE_TRIANGLES + i * len(SPHERE) for i in range(len(parts.starts))])
            rays = ring_of_rays(vertices, triangles.astype(np.int32), VIEWS, RAYS, random)
            frames, _, origins, _ = kernels.place_sticks(pose.arrays, body.lengths, body.stick_origins_torso)
            views.append(_view(pose, frames[stick], origins[stick], rays))
        yield Subject(body, stature, views, np.full(3, np.nan), np.nan)


def poses_of(truths: dict[str, Array]) -> list[Pose]:
    """Poses of the sessions' reference points (F, 15, 3) by name; of the opening T-pose only the first one's."""
    poses = []
    for name, points in truths.items():
        known = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
        if name != POSES_OF_SESSIONS[0]:
            known = known[known > OPENING]
        body = Body.from_points(points[known])
        poses += [inverse(body, points[frame]) for frame in known[::EVERY]]
    return poses


def random_mesh(data: Path, number: int, random: np.random.Generator) -> tuple[MeshBody, float]:
    who = Phenotype(gender=float(number % 2 * 0.9 + 0.05 * random.random()), age=random.uniform(0.55, 1.0))
    who = replace(who, muscle=random.uniform(0.15, 0.9), weight=random.uniform(0.15, 0.9))
    who = replace(who, height=random.uniform(0.3, 0.7), proportions=random.uniform(0.2, 1.0))
    who = replace(who, stature_m=random.uniform(1.5, 1.95))
    return make_body(data, who), who.stature_m


def _fifteen(truth: dict[str, Array]) -> Array:
    """The 15 reference points (15, 3) of a mesh's truth."""
    points = [0.5 * (truth["neck"] + 0.5 * (truth["l_hip"] + truth["r_hip"])), truth["head_top"], truth["neck"]]
    for joint in ("shoulder", "hip", "elbow", "knee", "hand_tip", "ankle"):
        points += [truth[f"l_{joint}"], truth[f"r_{joint}"]]
    return np.array(points)


def _at_rest(body: Body, truth: dict[str, Array]) -> dict[int, tuple[Array, float]]:
    """Wrist or toe (3,) in the frame of forearm or calf at rest, and the stick's true length, m."""
    points, found = _fifteen(truth), {}
    frames, _, _, _ = kernels.place_sticks(inverse(body, points).arrays, body.lengths, body.stick_origins_torso)
    for stick, name in EXTRA.items():
        start, way = points[STARTS[stick]], points[ENDS[stick]] - points[STARTS[stick]]
        frame = _turn(frames[stick][:, STICK_AXIS[stick]] * STICK_SIGN[stick], way) @ frames[stick]
        found[stick] = (frame.T @ (truth[name] - start), float(np.linalg.norm(way)))
    return found


def _own_frames(
    body: Body,
    pose: Pose,
    points: Array,
    truth: dict[str, Array],
    rest: dict[int, tuple[Array, float]],
    stick: NDArray[np.int64],
) -> tuple[Array, Array]:
    """Frames (k, 3, 3) and origins (k, 3) of the capsules: along the true bones, hands and feet as they are turned."""
    G, _, A, _ = kernels.place_sticks(pose.arrays, body.lengths, body.stick_origins_torso)
    G, A = G.copy(), A.copy()
    A[TORSO] = 0.5 * (points[5] + points[6])
    for s in range(1, len(G)):
        A[s] = points[STARTS[s]]
        if s in (L_FOREARM, R_FOREARM):  # along the way to the wrist
            G[s] = _turn(G[s] @ rest[s][0], truth[EXTRA[s]] - A[s]) @ G[s]
        else:
            G[s] = _turn(G[s][:, STICK_AXIS[s]] * STICK_SIGN[s], points[ENDS[s]] - A[s]) @ G[s]
    frames, origins = G[stick], A[stick]
    for capsule in EXTREMITY_CAPSULES:
        s = int(stick[capsule])
        extra, straight = rest[s][0], np.zeros(3)
        straight[STICK_AXIS[s]] = STICK_SIGN[s] * rest[s][1]
        hand = s in (L_FOREARM, R_FOREARM)
        pivot, tip = (extra, straight) if hand else (straight, extra)
        near, far = truth[EXTRA[s]], points[ENDS[s]]
        near, far = (near, far) if hand else (far, near)
        frames[capsule] = _turn(G[s] @ (tip - pivot), far - near) @ G[s]
        origins[capsule] = near - frames[capsule] @ pivot
    return frames, origins


def _turn(a: Array, b: Array) -> Array:
    """The least rotation (3, 3) that turns one direction onto another."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    v = np.cross(a, b)
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + a @ b))


def _view(pose: Pose, frames: Array, origins: Array, rays: tuple[Array, Array, Array]) -> View:
    points, directions, normals = rays
    arrays = RayArrays.of(points, directions, normals, np.full(len(points), HALF_STRETCH_M), np.ones(len(points)))
    return View(PoseState.of(pose), frames, origins, arrays, normals)
