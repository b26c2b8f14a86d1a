"""What bench/centerline.py measures on: hulls of the built-in body and of rendered sessions, and their true axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from scenes import STATURE_M, canvas_masks
from scipy.spatial.transform import Rotation

from capture_rig import Rig
from capture_rig.session import Session
from hull_server.grid import BrickVolume
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import HullSettings
from mocap_packets.frame_set import FrameSet
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES, T_POSE_ANGLES, mirror_angles
from virtual_studio.motions.catalogue import tour
from virtual_studio.people import VolumetricBody
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

BODY = Body.from_stature(STATURE_M)
EVERY, FIRST = 15, 7  # frames of a session that are measured
SAMPLE_M = 0.020
TOUR_S = {"walking": (1.9, 3.3), "raising arms": (3.9, 5.6), "squatting": (6.3, 8.1), "turning": (8.7, 10.4)}
LIMBS = ("torso", "head", "upper arms", "forearms", "thighs", "calves")


@dataclass(frozen=True, eq=False)
class Axes:
    """The true axes of one frame: k segments, metres, map frame.

    limb, side : (k,) names; LIMBS count for coverage, shoulders, hips and feet are axes only. starts, ends : (k, 3).
    frames : (k, 3, 3) rotations of frames that turn with the limbs; their x axes lie along them.
    """

    limb: np.ndarray
    side: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    frames: np.ndarray

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each point (n, 3): distance to the axes, nearest segment, offset from it in the segment's frame."""
        along = self.ends - self.starts
        from_start = points[:, None] - self.starts
        share = np.clip(np.einsum("nkj,kj->nk", from_start, along) / np.einsum("kj,kj->k", along, along), 0, 1)
        offsets = from_start - share[..., None] * along
        distances = np.linalg.norm(offsets, axis=-1)
        segment, rows = distances.argmin(axis=1), np.arange(len(points))
        return (
            distances[rows, segment],
            segment,
            np.einsum("nji,nj->ni", self.frames[segment], offsets[rows, segment]),
        )

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Points (s, 3) every 20 mm along the limbs, and the segment of each."""
        points, segments = [], []
        for k, (limb, start, end) in enumerate(zip(self.limb, self.starts, self.ends, strict=True)):
            if limb in LIMBS:
                steps = max(1, round(float(np.linalg.norm(end - start)) / SAMPLE_M))
                points.append(start + (np.arange(steps)[:, None] + 0.5) / steps * (end - start))
                segments += [k] * steps
        return np.concatenate(points), np.array(segments)


def axes_of(at: dict[str, np.ndarray]) -> Axes:
    """From named points; a wrist bends the forearm, a heel starts the foot (otherwise the ankle does)."""
    hips = (at["left_hip"] + at["right_hip"]) / 2
    segments = [("torso", "", "up", hips, at["neck"]), ("head", "", "up", at["neck"], at["head"])]
    for side in ("left", "right"):
        get = {name.removeprefix(f"{side}_"): point for name, point in at.items()}
        wrist = get.get("wrist", get["elbow"])
        segments += [
            ("upper arms", side, side, get["shoulder"], get["elbow"]),
            ("forearms", side, side, wrist, get["hand"]),
            *([("forearms", side, side, get["elbow"], wrist)] if "wrist" in get else []),
            ("thighs", side, "down", get["hip"], get["knee"]),
            ("calves", side, "down", get["knee"], get["foot"]),
            ("shoulders", side, side, at["neck"], get["shoulder"]),
            ("hips", side, side, hips, get["hip"]),
            ("feet", side, "ahead", get.get("heel", get["foot"]), get["toe"]),
        ]
    up = at["neck"] - hips
    left = at["left_hip"] - at["right_hip"]
    ahead = np.cross(left, up)
    torso = np.stack([v / np.linalg.norm(v) for v in (ahead, np.cross(up, ahead), up)], axis=1)
    rest = {"ahead": [1, 0, 0], "left": [0, 1, 0], "right": [0, -1, 0], "up": [0, 0, 1], "down": [0, 0, -1]}
    frames = [_swing(torso, torso @ np.array(rest[way], float), end - start) for _, _, way, start, end in segments]
    limb, side_of, _, starts, ends = zip(*segments, strict=True)
    return Axes(np.array(limb), np.array(side_of), np.array(starts), np.array(ends), np.array(frames))


def _swing(frame: np.ndarray, rest: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The frame, turned by the smallest rotation from one direction to another."""
    direction = direction / np.linalg.norm(direction)
    axis = np.cross(rest, direction)
    sine = np.linalg.norm(axis)
    turn = np.arctan2(sine, rest @ direction)
    return Rotation.from_rotvec(axis / max(sine, 1e-12) * turn).as_matrix() @ frame


# --- scenes ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Frame:
    """A hull and the truth about it."""

    volume: BrickVolume
    axes: Axes


Scenes = dict[str, list[Frame]]


def still(**left: float) -> Pose:
    """A symmetric pose on the floor, from the left side's angles."""
    angles = np.zeros(18)
    for name, value in left.items():
        angles[ANGLE_NAMES.index(f"left_{name}")] = value
    right = np.array([name.startswith("right") for name in ANGLE_NAMES])
    return on_the_floor(np.where(right, mirror_angles(angles), angles))


def on_the_floor(angles: np.ndarray) -> Pose:
    lowest = forward(BODY, Pose.from_angles(np.zeros(3), np.eye(3), angles))[13:, 2].min()
    height = VolumetricBody(BODY).ankle_height - lowest
    return Pose.from_angles(np.array([0.0, 0.0, height]), np.eye(3), angles)


def poses(number: int) -> dict[str, list[Pose]]:
    """Seven kinds of pose, ``number`` of each, turned and placed differently."""
    down = -np.pi / 2
    standing = still(shoulder_x=down + 0.16, shoulder_z=-0.05, shoulder_y=0.25, elbow=-0.28, hip_x=0.04)
    arms_near = still(shoulder_x=down + 0.03, shoulder_z=-0.02, shoulder_y=0.2, elbow=-0.12, hip_x=0.03)
    t_pose = on_the_floor(T_POSE_ANGLES)
    kinds = {"T-pose": [t_pose] * number, "standing": [standing] * number, "arms near": [arms_near] * number}
    motion = tour(BODY, 12.0, 20.0)
    for kind, (begin, end) in TOUR_S.items():
        kinds[kind] = [motion.poses[round(20.0 * t)] for t in np.linspace(begin, end, number)]
    return {
        kind: [
            _placed(pose, 2 * np.pi * n / number + 0.2, 0.2 * np.cos(n), 0.2 * np.sin(1.7 * n))
            for n, pose in enumerate(chosen)
        ]
        for kind, chosen in kinds.items()
    }


def _placed(pose: Pose, yaw: float, x: float, y: float) -> Pose:
    turn = Rotation.from_rotvec([0, 0, yaw]).as_matrix()
    return replace(pose, position_world=turn @ pose.position_world + [x, y, 0], R_world_torso=turn @ pose.R_world_torso)


def built_in(cameras: int, voxel_m: float, number: int) -> Scenes:
    rig = ring(cameras - 1)
    eyes, carve = ExactSilhouettes(rig), _carver(rig, voxel_m)
    scenes: Scenes = {}
    for kind, chosen in poses(number).items():
        for pose in chosen:
            parts = VolumetricBody(BODY).place(pose)
            at = dict(zip(POINT_NAMES, forward(BODY, pose), strict=True))
            for side, feet in (("left", slice(-4, -2)), ("right", slice(-2, None))):
                at |= {f"{side}_heel": parts.starts[feet].mean(axis=0), f"{side}_toe": parts.ends[feet].mean(axis=0)}
            scenes.setdefault(kind, []).append(Frame(carve(eyes.render(parts)), axes_of(at)))
    return scenes


def rendered(session: Session, exact: bool, voxel_m: float) -> list[Frame]:
    table = np.genfromtxt(session.folder / "truth.csv", delimiter=",", names=True)
    rows = {int(row["frame"]): row for row in table}
    carve = _carver(session.rig, voxel_m)
    frames = []
    for number, frame_masks in enumerate(canvas_masks(session, exact)):
        if number % EVERY == FIRST and number in rows:
            frames.append(Frame(carve(frame_masks), axes_of(_bones(rows[number]))))
    return frames


def _bones(row: np.void) -> dict[str, np.ndarray]:
    names = {"neck": "neck", "head": "head_top"}
    for side in ("left", "right"):
        for name in ("shoulder", "elbow", "wrist", "hip", "knee"):
            names[f"{side}_{name}"] = f"{side[0]}_{name}"
        for name, column in (("hand", "hand_tip"), ("foot", "ankle"), ("toe", "toe_tip")):
            names[f"{side}_{name}"] = f"{side[0]}_{column}"
    return {name: np.array([row[f"{column}_{axis}"] for axis in "xyz"]) for name, column in names.items()}


def _carver(rig: Rig, voxel_m: float) -> Callable[[dict[str, np.ndarray]], BrickVolume]:
    """Silhouettes to hull, as the hull server does it; every call is a second after the one before."""
    pipeline = HullPipeline(rig, HullSettings(voxel_size_m=voxel_m, backend="cpu"))
    seconds = count(1)

    def carve(masks: dict[str, np.ndarray]) -> BrickVolume:
        stamp_ns = next(seconds) * 1_000_000_000
        volume = pipeline.run(FrameSet.of_instant(stamp_ns, masks)).volume
        return BrickVolume(volume.grid, volume.index.copy(), volume.leaves.copy())

    return carve
