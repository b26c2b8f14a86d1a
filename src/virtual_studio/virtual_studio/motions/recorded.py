"""Recorded motions: from the joints of a motion file to the stick figure, and played by a person of any size.

The joints give 15 reference points, these a body and its poses. `RecordedMotion` plays them after a T-pose and a blend.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from capture_rig.errors import InputError
from stick_figure.body import Body
from stick_figure.kinematics import inverse
from stick_figure.pose import Pose
from stick_figure.skeleton import L_CALF, L_THIGH, R_CALF, R_THIGH, T_POSE_ANGLES

from ..people import VolumetricBody
from ..rig import VOLUME
from .bvh import Array, joints_by_role, read_bvh
from .timeline import T_POSE_S, Motion, ease, frame_count

SUFFIX = ".bvh"
UPRIGHT = 0.5
"""Least cosine between the way from ankles to neck, on average, and up."""
WORLD_FROM_UP = {
    "x": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "y": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "z": np.eye(3),
}
"""Rotations that turn the file's up axis to z; even permutations, so nothing is mirrored."""
ORDER = tuple(
    f"{side}_{joint}" for joint in ("shoulder", "hip", "elbow", "knee", "wrist", "ankle") for side in ("left", "right")
)
"""Joints of the reference points from the fourth on."""


BLEND_S = T_POSE_S
"""From the T-pose into the first frame; longer than between activities, because a file may begin with anything."""
FLOOR_PERCENTILE = 2.0
"""So many percent of the frames may have a foot in the floor: recorded feet are not exact."""
ROOM_M = float(VOLUME.high[0])
"""Half the width of the room that the studio's cameras see."""
_LEGS = [L_THIGH, R_THIGH, L_CALF, R_CALF]


@dataclass(frozen=True)
class RecordedMotion:
    """Plays the motion of a BVH file with a person of any size.

    Steps are as long as the person's legs, so the file's unit does not matter. The path is moved to the middle of the
    room, and its lowest frames onto the floor.

    up : the axis that points up in the file.
    """

    path: Path
    up: str = "y"

    def __call__(self, body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
        """Plays at most ``seconds`` of it, T-pose and blend included; less where the file ends before.

        Raises InputError for a file that cannot be read, a time too short, or a path that leaves the room.
        """
        person = VolumetricBody(body, build)
        opening = round((T_POSE_S + BLEND_S) * fps)
        frames = frame_count(seconds, fps) - opening
        if frames < 1:
            late = f"{seconds:g} s end before the recorded motion begins, at {T_POSE_S + BLEND_S:g} s"
            raise InputError(late, remedy="Give a longer time.")
        played = self.figure(float(body.lengths[_LEGS].sum() / 2.0), fps)
        poses = _placed(person, played[:frames], self.path)
        poses = [*_opening(person, poses[0], fps, opening), *poses]
        angles: list[np.ndarray] = []
        for pose in poses:
            angles.append(pose.angles(angles[-1] if angles else None))
        return Motion(tuple(poses), np.array(angles), fps)

    def figure(self, leg_m: float, fps: float) -> list[Pose]:
        """Reads poses of a stick figure of the file's own, at ``fps`` frames a second, by cubic splines through time.

        leg_m : length of the person's legs, hip to ankle; the file's unit does not matter.
        World frame: z up, metres; origin and heading are the file's. Raises InputError for anything that cannot be
        read.
        """
        points, file_hz = self.reference_points(leg_m)
        body, times = Body.from_points(points), np.arange(len(points)) / file_hz
        if len(points) > 1 and abs(fps - file_hz) >= 1e-9 * file_hz:
            count = int(np.floor(times[-1] * fps + 1e-6)) + 1
            points = CubicSpline(times, points, axis=0)(np.arange(count) / fps)
        poses: list[Pose] = []
        for frame in points:
            poses.append(inverse(body, frame, poses[-1] if poses else None))
        return poses

    def reference_points(self, leg_m: float) -> tuple[Array, float]:
        """Computes the 15 reference points (F, 15, 3), m, z up, of a person with legs of ``leg_m``; frames a second.

        The file's wrist is used as the finger tip, and the head's joint as its tip where the file has none: they lie
        on the same sticks, whose directions alone are played.
        """
        placed, fps = read_bvh(self.path)
        if self.up not in WORLD_FROM_UP:
            raise InputError(f"the axis that points up is '{self.up}'", remedy="Give x, y or z.")
        R = WORLD_FROM_UP[self.up]
        joint = {role: placed[name] @ R.T for role, name in joints_by_role(placed, self.path).items()}
        self._check_upright(joint)
        points = np.empty((len(joint["neck"]), 15, 3))
        points[:, 2] = joint["neck"]
        points[:, 3:] = np.stack([joint[role] for role in ORDER], axis=1)
        points[:, 0] = 0.5 * (points[:, 2] + points[:, 5:7].mean(1))
        points[:, 1] = joint.get("head_tip", joint["head"])
        return leg_m / _leg(joint) * points, fps

    def _check_upright(self, joint: dict[str, Array]) -> None:
        """Raises InputError when the person mostly does not stand along the given up axis."""
        ankles = 0.5 * (joint["left_ankle"] + joint["right_ankle"])
        standing = (joint["neck"] - ankles).mean(0)
        if standing[2] < UPRIGHT * np.linalg.norm(standing):
            likely = "xyz"[int(np.argmax(np.abs(WORLD_FROM_UP[self.up].T @ standing)))]
            remedy = f"Say which axis points up, probably {likely}."
            raise InputError(f"the person does not stand along {self.up}", where=str(self.path), remedy=remedy)

    def __str__(self) -> str:
        return self.path.name


def _leg(joint: dict[str, Array]) -> float:
    """Hip to ankle along the leg, the file's unit."""
    legs = ([f"{side}_{joint}" for joint in ("hip", "knee", "ankle")] for side in ("left", "right"))
    bones = [bone for leg in legs for bone in pairwise(leg)]
    return 0.5 * float(sum(np.median(np.linalg.norm(joint[a] - joint[b], axis=1)) for a, b in bones))


def is_motion_file(name: str) -> bool:
    """Returns whether a name is a motion file's, not a built-in motion's."""
    return Path(name).suffix.lower() == SUFFIX


def _placed(person: VolumetricBody, poses: list[Pose], path: Path) -> list[Pose]:
    """Return the poses with their path in the middle of the room and their feet on the floor."""
    places = np.array([pose.position_world for pose in poses])
    shift = np.zeros(3)
    shift[:2] = -0.5 * (places[:, :2].min(0) + places[:, :2].max(0))
    shift[2] = -np.percentile([_lowest(person, pose) for pose in poses], FLOOR_PERCENTILE)
    farthest = np.abs(places[:, :2] + shift[:2]).max()
    if farthest > ROOM_M:
        too_far = f"the person walks {2.0 * farthest:.1f} m, the room is {2.0 * ROOM_M:g} m wide"
        raise InputError(too_far, where=str(path), remedy="Take fewer seconds of it.")
    return [_moved(pose, shift) for pose in poses]


def _opening(person: VolumetricBody, first: Pose, fps: float, frames: int) -> list[Pose]:
    """Return the T-pose and the blend into ``first``, on the same spot, facing the same way."""
    forward = first.R_world_torso[:2, 0]
    yaw = float(np.arctan2(forward[1], forward[0]))
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    t_pose = Pose.from_angles(first.position_world, R, T_POSE_ANGLES)
    way, height = first.minus(t_pose), _lowest(person, first)
    opening = []
    for frame in range(frames):
        done = ease((frame / fps - T_POSE_S) / BLEND_S)
        pose = t_pose.retract(done * way)
        opening.append(_moved(pose, np.array([0.0, 0.0, done * height - _lowest(person, pose)])))
    return opening


def _lowest(person: VolumetricBody, pose: Pose) -> float:
    """Height of the lowest part of the body, m."""
    centres, radii = person.contact_spheres(pose)
    return float((centres[:, 2] - radii).min())


def _moved(pose: Pose, shift: np.ndarray) -> Pose:
    return replace(pose, position_world=pose.position_world + shift)
