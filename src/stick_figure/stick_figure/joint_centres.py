"""Centres of shoulders, hips and neck in a posed body, by regression on the pose of the figure fitted to its surface.

A figure whose surface suits the outlines has its joints where they are in the mean pose: flesh slides over the bones as
limbs move. A shoulder's centre rises and falls by more than the outline about it, a hip's follows the pelvis, a neck's
the head. As centres are regressed on markers of the skin (Bell, Pedersen & Brand 1990 for hips, Meskers et al. 1998 for
shoulders), they are here on the figure's pose: displacements, over the stature, that are linear in the directions of
upper arms, thighs and head against the torso and in the trunk's bend. In the mean pose there is none.

The table ``joint_centres.csv`` is made by ``models/joint_centres.py`` from tracked rendered people (MakeHuman's mesh,
CC0) whose joints are known.
"""

from __future__ import annotations

import csv
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .body import Body
from .pose import Pose
from .rotations import Array
from .skeleton import POINT_NAMES
from .trunk_bend import FLEXION, PELVIS_ROLL, PELVIS_YAW, REST_SD

# Thresholds: made by python models/joint_centres.py, fitted to tracked rendered people (models/random_people.py --clips
# fit, 42 of them, and the mesh_fit_ sets).
TABLE = Path(__file__).with_name("joint_centres.csv")
CENTRES = ("shoulder", "hip", "neck")
DIRECTIONS = ("arm", "other_arm", "thigh", "other_thigh")
FEATURES: tuple[str, ...] = (
    *(f"{limb}_{axis}" for limb in DIRECTIONS for axis in "xyz"),
    *("head_x", "flexion", "head_y", "pelvis_yaw", "pelvis_roll"),
)
"""What is regressed on, of the left side: unit vectors in the torso's frame, the trunk's bend over its spread. Of the
right side they are those of the mirrored pose."""
_LIMBS, _ODD = 3 * len(DIRECTIONS), 3  # the first ones are the limbs', the last ones change sign in the mirror
_MIRROR = np.array([1.0, -1.0, 1.0])
_TORSO, _NECK, _HIPS = (POINT_NAMES.index(name) for name in ("torso", "neck", "left_hip"))
_SHOULDERS = POINT_NAMES.index("left_shoulder")


class JointCentres(NamedTuple):
    """The table: mean (n,) of the FEATURES, and per_feature (3, 3, n): of each centre x, y, z over the stature."""

    mean: np.ndarray
    per_feature: np.ndarray


@lru_cache(maxsize=1)
def joint_centres() -> JointCentres:
    """Read the table."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        header, mean, *rows = list(csv.reader(file))
    names = [[centre, axis] for centre in CENTRES for axis in "xyz"]
    if header[2:] != list(FEATURES) or [row[:2] for row in rows] != names:
        raise ValueError(f"{TABLE} does not have the rows {CENTRES} times x, y, z and the columns {FEATURES}")
    values = np.array([row[2:] for row in rows], float).reshape(len(CENTRES), 3, len(FEATURES))
    return JointCentres(np.array(mean[2:], float), values)


def pose_features(body: Body, pose: Pose) -> np.ndarray:
    """Return the FEATURES (2, n) of the left and the right side of a body as its trunk is bent."""
    R, bend, features = pose.R_joints, body.bend / REST_SD, np.empty((2, len(FEATURES)))
    limbs = np.concatenate([R[1:3, :, 1], -R[3:5, :, 2]])  # left and right arm, left and right thigh
    limbs[1::2] *= _MIRROR
    features[0, :_LIMBS], features[1, :_LIMBS] = limbs.ravel(), limbs[[1, 0, 3, 2]].ravel()
    features[:, _LIMBS:-_ODD] = R[0, 0, 2], bend[FLEXION]
    features[0, -_ODD:] = R[0, 1, 2], bend[PELVIS_YAW], bend[PELVIS_ROLL]
    features[1, -_ODD:] = -features[0, -_ODD:]
    return features


def with_joint_centres(body: Body, pose: Pose, points_world: Array) -> Array:
    """Return the reference points (15, 3), m, of a figure in a pose, with shoulders, hips and neck at a person's joint
    centres, and the torso's centre between them (thesis p1)."""
    table = joint_centres()
    moved = np.einsum("caf,sf->sca", table.per_feature, pose_features(body, pose) - table.mean)
    moved[1] *= _MIRROR
    neck = moved[:, 2].mean(axis=0)
    torso = np.zeros((len(POINT_NAMES), 3))
    torso[_SHOULDERS : _SHOULDERS + 2], torso[_HIPS : _HIPS + 2], torso[_NECK] = moved[:, 0], moved[:, 1], neck
    torso[_TORSO] = 0.5 * (neck + moved[:, 1].mean(axis=0))
    return points_world + body.stature * torso @ pose.R_world_torso.T
