"""The trunk's bend: axial rotation, lateral bending and flexion of the spine, and movement of the shoulder girdle.

The stick figure's torso is rigid; a person's is not. A pelvis turns and tilts against the chest, collar bones carry the
shoulder joints up and down, forward and back, and a back grows round. The torso's axis is the line from the middle of
the hips to the neck; against it seven numbers remain: yaw and roll of the line between the hips, each shoulder's place
ahead and up, and the spine's flexion (the pelvis' tilt backwards). A body holds them (`Body.bend`), zero at rest.
Starts of arms and thighs and the trunk's surface move with them; all to first order.

Ranges: chest against pelvis turns by 7 degrees to either side in walking and 35 at most, and leans by 5 and 25 (White &
Panjabi, Clinical Biomechanics of the Spine); half of it is between the hips and the line to the neck. A collar bone of
15 cm rises by 30 degrees with the arm (Inman, Saunders & Abbott 1944) and moves forward and back by 15. From standing
to a full bow the lumbar spine flexes by 50 to 60 degrees (White & Panjabi), half of it at either end of the line; its
joints lie some 5 cm behind the line, so flexion shortens it, and the trunk between the line's ends moves back like an
arc of that curvature.

Joint centres of shoulders, hips and neck move with the pose, too: a figure whose surface fits the outlines has its
joints at their places in the mean pose, but flesh slides over the bones as limbs move. As others regress centres on
markers of the skin (Bell, Pedersen & Brand 1990 for hips, Meskers et al. 1998 for shoulders), here they are regressed
on the figure's pose: displacements, over the stature, linear in the directions of upper arms, thighs and head against
the torso and in the trunk's bend; none in the mean pose. The table ``joint_centres.csv`` is made by
``models/joint_centres.py`` from tracked rendered people (MakeHuman's mesh, CC0) whose joints are known.
"""

from __future__ import annotations

import csv
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .body import BEND_NUMBERS, Body
from .body_surface import PARTS, BodySurface
from .pose import Pose
from .rotations import Array
from .skeleton import HEAD, L_THIGH, L_UPPER_ARM, POINT_NAMES, R_THIGH, R_UPPER_ARM, TORSO

PELVIS_YAW, PELVIS_ROLL, LEFT_X, LEFT_Z, RIGHT_X, RIGHT_Z, FLEXION = range(BEND_NUMBERS)
# Thresholds: ranges of spine and collar bone (White & Panjabi; Inman et al. 1944), of three sizes the one that was
# best on the mesh_fit_ sets (python bench/people.py).
REST_SD = np.array([0.15, 0.12, 0.03, 0.04, 0.03, 0.04, 0.15])
"""Standard deviations from rest in daily movement: rad, rad, m, m, m, m, rad."""
RATE_SD = np.array([0.8, 0.65, 0.16, 0.2, 0.16, 0.2, 0.8])
"""Standard deviations of a random walk: rad and m over the square root of a second."""
WITH_THE_CHEST = 0.5
"""Share of the shoulders' movement that the chest makes; the rest is the collar bones'."""
SHORTER, SHOULDERS_BACK, UPPER_BACK, LOWER_BACK = 0.13, 0.09, 0.2, 0.1
"""Over the torso's length, for each rad of flexion: shortening of the line from hips to neck, and backward movement of
shoulders and of the trunk's capsules. An arc whose chest turns 0.6 rad for each rad of the pelvis has .09 at the
shoulders, .18 and .08 at the line; measured on 20 rendered people in the clips of the `mesh_fit_` sets: .09, .24 and
.14; shortening .13 (correlation .94)."""
_PART_OF_CAPSULE = tuple(part for part, own in PARTS.items() for _ in own)


# Thresholds: made by python models/joint_centres.py, fitted to tracked rendered people (models/random_people.py --clips
# fit, 42 of them, and the mesh_fit_ sets).
TABLE = Path(__file__).with_name("joint_centres.csv")
CENTRES = ("shoulder", "hip", "neck")
DIRECTIONS = ("arm", "other_arm", "thigh", "other_thigh")
FEATURES: tuple[str, ...] = (
    *(f"{limb}_{axis}" for limb in DIRECTIONS for axis in "xyz"),
    *("head_x", "flexion", "head_y", "pelvis_yaw", "pelvis_roll"),
)
"""Regressors of the left side: unit vectors in the torso's frame, the trunk's bend over REST_SD. Those of the right
side are taken from the mirrored pose."""
_LIMBS, _ODD = 3 * len(DIRECTIONS), 3  # the first ones are the limbs', the last ones change sign in the mirror
_MIRROR = np.array([1.0, -1.0, 1.0])
_TORSO, _NECK, _HIPS = (POINT_NAMES.index(name) for name in ("torso", "neck", "left_hip"))
_SHOULDERS = POINT_NAMES.index("left_shoulder")


class BendDerivatives(NamedTuple):
    """Derivatives, m, torso frame, by the bend: of sticks' starts (10, 3, 7), of capsules' starts and ends (k, 3, 7);
    zero but on the torso."""

    origins: np.ndarray
    starts: np.ndarray
    ends: np.ndarray


@lru_cache(maxsize=8)
def bend_derivatives(body: Body) -> BendDerivatives:
    """Return the derivatives of a body at rest."""
    surface, hip, half = BodySurface.of(body), body.hip_width_ratio * body.half_shoulder_width, body.half_shoulder_width
    origins = np.zeros((10, 3, BEND_NUMBERS))
    starts, ends = (np.zeros((len(surface.stick), 3, BEND_NUMBERS)) for _ in range(2))
    origins[L_UPPER_ARM, 0, LEFT_X] = origins[L_UPPER_ARM, 2, LEFT_Z] = 1.0
    origins[R_UPPER_ARM, 0, RIGHT_X] = origins[R_UPPER_ARM, 2, RIGHT_Z] = 1.0
    for stick, y in ((L_THIGH, hip), (R_THIGH, -hip)):
        origins[stick] = _with_pelvis(y)
    length = body.lengths[TORSO]
    chest, hips = -0.5 * SHORTER * length, 0.5 * SHORTER * length
    origins[[HEAD, L_UPPER_ARM, R_UPPER_ARM], 2, FLEXION] = chest
    origins[[L_THIGH, R_THIGH], 2, FLEXION] = hips
    origins[[L_UPPER_ARM, R_UPPER_ARM], 0, FLEXION] = -SHOULDERS_BACK * length
    for k, part in enumerate(_PART_OF_CAPSULE):
        if part in ("side", "spine"):
            starts[k, [0, 2], FLEXION] = -UPPER_BACK * length, chest
            ends[k, [0, 2], FLEXION] = -LOWER_BACK * length, hips
        elif part == "girdle":
            starts[k, [0, 2], FLEXION] = ends[k, [0, 2], FLEXION] = -SHOULDERS_BACK * length, chest
        if part == "side":
            starts[k] += WITH_THE_CHEST * _with_shoulders(surface.start[k, 1] / half)
            ends[k] += _with_pelvis(surface.end[k, 1])
        elif part == "girdle":
            ends[k] += _with_shoulders(surface.end[k, 1] / half)
    return BendDerivatives(origins, starts, ends)


def _with_pelvis(y: float) -> np.ndarray:
    """Return the derivative (3, 7) of a point at y to the left between the hips."""
    moved = np.zeros((3, BEND_NUMBERS))
    moved[0, PELVIS_YAW], moved[2, PELVIS_ROLL] = -y, y
    return moved


def _with_shoulders(share: float) -> np.ndarray:
    """Return the derivative (3, 7) of a point at ``share`` of the way out to the left shoulder, -1 at the right one."""
    moved = np.zeros((3, BEND_NUMBERS))
    left, right = (share, 0.0) if share > 0.0 else (0.0, -share)
    moved[0, [LEFT_X, RIGHT_X]] = left, right
    moved[2, [LEFT_Z, RIGHT_Z]] = left, right
    return moved


@lru_cache(maxsize=8)
def bend_columns(body: Body) -> np.ndarray:
    """Return the derivatives (5, 3, 13) of neck, shoulders and hips in the torso's frame by its translation (3) and
    rotation (3), and by the bend (7)."""
    base, columns = body.torso_points[1:], np.zeros((5, 3, 6 + BEND_NUMBERS))
    columns[:, :, :3] = np.eye(3)
    for axis in range(3):
        columns[:, :, 3 + axis] = np.cross(np.eye(3)[axis], base)
    columns[:, :, 6:] = bend_derivatives(body).origins[1:6]
    return columns


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
    """Return the FEATURES (2, n) of the left and the right side of a body with its bend."""
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
