"""A recorded motion as something the built-in person can do: T-pose, a blend, and then what the file holds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from capture_rig.errors import InputError
from stick_figure.body import Body
from stick_figure.pose import Pose
from stick_figure.skeleton import L_CALF, L_THIGH, R_CALF, R_THIGH, T_POSE_ANGLES

from ..body import VolumetricBody
from ..motions.timeline import T_POSE_S, Motion, ease, frame_count
from .to_stick_figure import SUFFIXES, ReadingOptions, read_stick_motion

BLEND_S = 1.0
"""From the T-pose into the first frame; longer than between activities, because a file may begin with anything."""
FLOOR_PERCENTILE = 2.0
"""So many percent of the frames may have a foot in the floor: recorded feet are not exact."""
ROOM_M = 1.4
"""Half the width of the room that the studio's cameras see."""


@dataclass(frozen=True)
class RecordedMotion:
    """The motion of a BVH or AMC file, done by a person of any size.

    Steps are as long as the person's legs, so the file's unit does not matter. The path is moved to the middle of the
    room, and its lowest frames onto the floor.
    """

    path: Path
    options: ReadingOptions = field(default_factory=ReadingOptions)

    def __call__(self, body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
        """At most ``seconds`` of it, T-pose and blend included; less where the file ends before.

        Raises InputError for a file that cannot be read, a time too short, or a path that leaves the room.
        """
        person = VolumetricBody(body, build)
        opening = round((T_POSE_S + BLEND_S) * fps)
        frames = frame_count(seconds, fps) - opening
        if frames < 1:
            raise InputError(
                f"{seconds:g} s end before the recorded motion begins, at {T_POSE_S + BLEND_S:g} s",
                remedy="Give a longer time.",
            )
        poses = _placed(person, self._poses(body, fps)[:frames], self.path)
        poses = [*_opening(person, poses[0], fps, opening), *poses]
        angles: list[np.ndarray] = []
        for pose in poses:
            angles.append(pose.angles(angles[-1] if angles else None))
        return Motion(tuple(poses), np.array(angles), fps)

    def _poses(self, body: Body, fps: float) -> tuple[Pose, ...]:
        options = replace(self.options, metres_per_unit=None, leg_m=float(body.lengths[_LEGS].sum() / 2.0))
        return read_stick_motion(self.path, fps, options).poses

    def __str__(self) -> str:
        return self.path.name


_LEGS = [L_THIGH, R_THIGH, L_CALF, R_CALF]


def is_motion_file(name: str) -> bool:
    """Whether a name is that of a motion file rather than of a built-in motion."""
    return Path(name).suffix.lower() in SUFFIXES


def _placed(person: VolumetricBody, poses: tuple[Pose, ...], path: Path) -> list[Pose]:
    """The poses with their path in the middle of the room and their feet on the floor."""
    places = np.array([pose.position_world for pose in poses])
    shift = np.zeros(3)
    shift[:2] = -0.5 * (places[:, :2].min(0) + places[:, :2].max(0))
    shift[2] = -np.percentile([_lowest(person, pose) for pose in poses], FLOOR_PERCENTILE)
    farthest = np.abs(places[:, :2] + shift[:2]).max()
    if farthest > ROOM_M:
        raise InputError(
            f"the person walks {2.0 * farthest:.1f} m, the room is {2.0 * ROOM_M:g} m wide",
            where=str(path),
            remedy="Take fewer seconds of it, or start elsewhere.",
        )
    return [_moved(pose, shift) for pose in poses]


def _opening(person: VolumetricBody, first: Pose, fps: float, frames: int) -> list[Pose]:
    """The T-pose and the blend into ``first``, on the same spot, facing the same way."""
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
    centres, radii = person.touchpoints(pose)
    return float((centres[:, 2] - radii).min())


def _moved(pose: Pose, shift: np.ndarray) -> Pose:
    return replace(pose, position_world=pose.position_world + shift)
