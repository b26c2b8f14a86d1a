"""Joint angles against the truth (thesis Table 7.1)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from capture_rig.errors import InputError
from capture_rig.session import Truth
from stick_figure import metrics
from stick_figure.body import Body
from stick_figure.kinematics import inverse
from stick_figure.pose import Pose
from stick_figure.skeleton import BALL_ANGLES, HINGE_ANGLES

STRAIGHT_RAD = np.deg2rad(20.0)
"""Closer to straight (or to an arm's or thigh's singular direction) a limb does not determine its angles.

At 20 degrees an error of 20 mm of the hand turns the upper arm's twist by about 0.15 rad; straight, without bound.
"""


@dataclass(frozen=True, eq=False)
class AngleTruth:
    """angles (F, 18) rad and R_world_torso (F, 3, 3), NaN where unknown; source : where they come from, in words."""

    angles: np.ndarray
    R_world_torso: np.ndarray
    source: str


@dataclass(frozen=True, eq=False)
class AngleScores:
    """Errors of the joint angles over the tracked frames.

    rmse_rad : (18,) of wrapped differences (thesis eq. 7.2), over the frames in which the truth defines the angle.
    share_defined : (18,) share of the compared frames in which it does.
    torso_rmse_rad : of the torso's rotation angle to the truth (thesis eq. 7.1).
    """

    rmse_rad: np.ndarray
    share_defined: np.ndarray
    torso_rmse_rad: float
    source: str


def score_angles(angles: np.ndarray, points_world: np.ndarray, truth: AngleTruth) -> AngleScores:
    """Compare a track's angles (F, 18) rad and points (F, 15, 3) m, NaN where it has none, with the truth, by frame."""
    known = np.isfinite(truth.angles).all(1) & np.isfinite(angles).all(1)
    compared = known[:, None] & defined(truth.angles)
    turned = metrics.rotation_angle(torso_rotations(points_world), truth.R_world_torso)
    turned = turned[np.isfinite(turned)]
    return AngleScores(
        rmse_rad=metrics.rmse_angles(angles, np.where(compared, truth.angles, np.nan)),
        share_defined=compared.sum(0) / max(int(known.sum()), 1),
        torso_rmse_rad=float(np.sqrt(np.mean(turned**2))) if turned.size else float("nan"),
        source=truth.source,
    )


def angle_truth(truth: Truth) -> AngleTruth:
    """Return the truth's own angles, or else those of a stick figure fitted to its points."""
    points = truth.stick_figure_points()
    poses = fit_poses(points)
    if truth.angles is not None:
        return AngleTruth(truth.angles, _rotations(poses), f"the angles in {truth.source.name}")
    source = f"inverse kinematics of the points in {truth.source.name}"
    return AngleTruth(_continuous_angles(poses), _rotations(poses), source)


def fit_poses(points_world: np.ndarray) -> list[Pose | None]:
    """Poses fitted to reference points (F, 15, 3) m, limbs of median length; None where they are unknown or impossible.

    An angle that a straight limb leaves undetermined is carried over from the pose before.
    """
    whole = np.isfinite(points_world).all((1, 2))
    poses: list[Pose | None] = [None] * len(points_world)
    if not whole.any():
        return poses
    body, previous = Body.from_points(points_world[whole]), None
    for frame in np.flatnonzero(whole):
        with suppress(InputError):
            poses[frame] = previous = inverse(body, points_world[frame], previous)
    return poses


def defined(angles: np.ndarray) -> np.ndarray:
    """(F, 18) bool: the angles that a pose (F, 18) rad determines well.

    The third angle of a shoulder or hip is the twist of the upper limb, which shows only in a bent elbow or knee. First
    and third turn about the same axis where the second is a right angle (arm straight forward or back, thigh
    horizontal): neither is determined there.
    """
    out = np.isfinite(angles)
    closest = np.sin(STRAIGHT_RAD)
    for ball, (first, second, third) in enumerate(BALL_ANGLES):
        regular = np.abs(np.cos(angles[:, second])) > closest
        out[:, first] &= regular
        if ball:  # the neck has no third
            out[:, third] &= regular & (np.abs(np.sin(angles[:, HINGE_ANGLES[ball - 1]])) > closest)
    return out


def _continuous_angles(poses: list[Pose | None]) -> np.ndarray:
    angles, previous = np.full((len(poses), 18), np.nan), None
    for frame, pose in enumerate(poses):
        if pose is not None:
            angles[frame] = previous = pose.angles(previous)
    return angles


def torso_rotations(points_world: np.ndarray) -> np.ndarray:
    """R_world_torso (F, 3, 3) of the rigid fit to the torso's points."""
    return _rotations(fit_poses(points_world))


def _rotations(poses: list[Pose | None]) -> np.ndarray:
    unknown = np.full((3, 3), np.nan)
    return np.array([unknown if pose is None else pose.R_world_torso for pose in poses]).reshape(-1, 3, 3)
