"""Where the first pose comes from: a parameter file, the reference of a session, or (`hull_source`) the hull."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from capture_rig.errors import InputError
from capture_rig.rigid import rotation_matrix
from capture_rig.yaml_file import read_mapping
from mocap_packets.hull import HullProducts
from stick_figure.body import Body, load_body
from stick_figure.kinematics import inverse
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES, T_POSE_ANGLES

from .body_sizes import BodyEstimate

KEYS = ("torso_position", "heading", "torso_rotation", "angles", "body")


@dataclass(frozen=True, eq=False)
class InitialPose:
    """A first pose with its body, or the reason why there is none yet.

    estimate : the sizes of ``body`` with their covariance, where they were measured. is_fitted : whether the pose was
    tracked from set to set and judged by their outlines.
    """

    pose: Pose | None = None
    body: Body | None = None
    reason: str = ""
    estimate: BodyEstimate | None = None
    is_fitted: bool = False


class PoseSource(Protocol):
    """Finds a first pose in one frame set after another."""

    def find_pose(self, seen: HullProducts) -> InitialPose:
        """Return the first pose, if this frame set brings it."""
        ...


@dataclass(frozen=True, eq=False)
class KnownPose:
    """A first pose that is given."""

    pose: Pose
    body: Body

    def find_pose(self, seen: HullProducts) -> InitialPose:
        return InitialPose(self.pose, self.body)


def load_initial_pose(path: str | Path) -> tuple[Pose, Body | None]:
    """Read a pose file: torso position (m), heading or torso rotation vector (rad), angles by name (rad), body file.

    Angles that are not given are those of the T-pose; without ``body`` the second result is None. The body's path is
    relative to the pose file. Raises InputError naming file, key, value and remedy.
    """
    path = Path(path)
    document = read_mapping(path, f"A pose file is a mapping with the keys {', '.join(KEYS)}.")
    _refuse_unknown(document, KEYS, str(path))
    if "torso_position" not in document:
        raise InputError("torso_position is missing", where=str(path), remedy="Give [x, y, z] in metres, map frame.")
    position = _numbers(document["torso_position"], "torso_position", 3, str(path))
    if "heading" in document and "torso_rotation" in document:
        raise InputError("heading and torso_rotation are both given", where=str(path), remedy="Keep one of them.")
    if "torso_rotation" in document:
        torso_rotation = _numbers(document["torso_rotation"], "torso_rotation", 3, str(path))
    else:
        torso_rotation = np.array([0.0, 0.0, _numbers([document.get("heading", 0.0)], "heading", 1, str(path))[0]])
    pose = Pose.from_angles(position, rotation_matrix(torso_rotation), _angles(document.get("angles"), str(path)))
    return pose, load_body(path.parent / str(document["body"])) if document.get("body") else None


def pose_from_reference(
    frames: np.ndarray, points_world: np.ndarray, frame: int, where: str, body: Body | None = None
) -> KnownPose:
    """Return the pose and body of a reference (F, 15, 3) m with frame numbers (F,), at video frame ``frame``.

    The body is measured over all frames unless it is given. Raises InputError when the frame or a point is missing.
    """
    rows = np.flatnonzero(np.asarray(frames) == frame)
    if rows.size == 0:
        raise InputError(
            f"the reference has no frame {frame}", where=where, remedy=f"Choose {frames.min()} to {frames.max()}."
        )
    body = body or Body.from_points(points_world)
    points = points_world[rows[0]]
    if unknown := [name for name, point in zip(POINT_NAMES, points, strict=True) if not np.isfinite(point).all()]:
        what = f"the reference does not know the {', '.join(unknown)} at frame {frame}"
        raise InputError(what, where=where, remedy="Choose a frame at which all points are known.")
    return KnownPose(inverse(body, points), body)


def _refuse_unknown(document: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for key in document:
        if key not in known:
            raise InputError(f"unknown key '{key}'", where=where, remedy=f"Known keys: {', '.join(known)}.")


def _numbers(value: Any, key: str, count: int, where: str) -> np.ndarray:
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise InputError(
            f"{key} = {value!r} is not {count} finite number{'s' * (count > 1)}",
            where=where,
            remedy="Give metres or radians.",
        )
    return numbers


def _angles(given: Any, where: str) -> np.ndarray:
    angles = np.array(T_POSE_ANGLES)
    if given is None:
        return angles
    if not isinstance(given, Mapping):
        raise InputError(f"angles = {given!r} is not a mapping", where=where, remedy="Give angles by name, in radians.")
    _refuse_unknown(given, ANGLE_NAMES, f"{where}: angles")
    for name, value in given.items():
        angles[ANGLE_NAMES.index(name)] = _numbers([value], f"angles.{name}", 1, where)[0]
    return angles
