"""The stick figure as a tree of joints, as animation formats describe it: offsets in the T-pose, local rotations.

A joint turns the bone that begins there. The trunk is one rigid bone: Hips carries Spine (its centre, p1), neck,
shoulders and hips. All 15 reference points are joints or ends of bones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stick_figure.skeleton import POINT_NAMES, STICK_NAMES

from .motion import R_ANIMATION_WORLD, T_POSE_STICKS, Motion, fill_linearly, fill_rotations, in_frames, rotated

Array = np.ndarray
RIGID_M = 1e-3
"""Bones that change by less have one length for the whole take: a millimetre is below what exports must keep."""


@dataclass(frozen=True)
class Joint:
    """A joint by the name that animation programs expect; its parent, its reference point, the stick that it turns
    with.

    point : None for the root, which lies in the middle between the hips.
    """

    name: str
    parent: str | None
    point: str | None
    stick: str


JOINTS = (
    Joint("Hips", None, None, "torso"),
    Joint("Spine", "Hips", "torso", "torso"),
    Joint("Neck", "Spine", "neck", "head"),
    Joint("Head", "Neck", "head", "head"),
    Joint("LeftArm", "Spine", "left_shoulder", "left_upper_arm"),
    Joint("LeftForeArm", "LeftArm", "left_elbow", "left_forearm"),
    Joint("LeftHand", "LeftForeArm", "left_hand", "left_forearm"),
    Joint("RightArm", "Spine", "right_shoulder", "right_upper_arm"),
    Joint("RightForeArm", "RightArm", "right_elbow", "right_forearm"),
    Joint("RightHand", "RightForeArm", "right_hand", "right_forearm"),
    Joint("LeftUpLeg", "Hips", "left_hip", "left_thigh"),
    Joint("LeftLeg", "LeftUpLeg", "left_knee", "left_calf"),
    Joint("LeftFoot", "LeftLeg", "left_foot", "left_calf"),
    Joint("RightUpLeg", "Hips", "right_hip", "right_thigh"),
    Joint("RightLeg", "RightUpLeg", "right_knee", "right_calf"),
    Joint("RightFoot", "RightLeg", "right_foot", "right_calf"),
)
"""Parents before children, each limb to its end. The last joint of a limb (and the head) is the end of the stick."""
PARENTS = tuple(next((i for i, p in enumerate(JOINTS) if p.name == joint.parent), -1) for joint in JOINTS)


def local_transforms(points_world: Array, R_world_sticks: Array) -> tuple[Array, Array]:
    """Return the translations (F, J, 3) m and rotations (F, J, 3, 3) of the joints in their parents, animation axes.

    points_world : (F, 15, 3) m; R_world_sticks : (F, 10, 3, 3). The root's are in the world; in the T-pose of a torso
    along the world's axes all rotations are the identity.
    """
    number = {name: i for i, name in enumerate(POINT_NAMES)}
    points = points_world @ R_ANIMATION_WORLD.T
    middle = 0.5 * (points[:, number["left_hip"]] + points[:, number["right_hip"]])
    places = np.stack([middle if j.point is None else points[:, number[j.point]] for j in JOINTS], axis=1)
    turned = rotated(R_world_sticks @ T_POSE_STICKS.transpose(0, 2, 1), R_ANIMATION_WORLD)  # since the T-pose
    world = np.stack([turned[:, STICK_NAMES.index(joint.stick)] for joint in JOINTS], axis=1)
    translations, rotations = places.copy(), world.copy()
    for j, parent in enumerate(PARENTS):
        if parent >= 0:
            R_parent_world = world[:, parent].transpose(0, 2, 1)
            translations[:, j] = np.einsum("fij,fj->fi", R_parent_world, places[:, j] - places[:, parent])
            rotations[:, j] = R_parent_world @ world[:, j]
    return translations, rotations


@dataclass(frozen=True, eq=False)
class JointTree:
    """A motion as a tree of joints in animation axes (y up), metres.

    translations : (F, J, 3) of each joint in its parent; the root's in the world. rotations : (F, J, 3, 3) local. Gaps
    are filled: joints turn the short way, places move along straight lines.
    offsets : (J, 3) medians of the translations over the take, 0 for the root. rigid : whether the offsets replace the
    translations, as all bones keep their lengths.
    """

    translations: Array
    rotations: Array
    offsets: Array
    rigid: bool

    @classmethod
    def of_motion(cls, motion: Motion) -> JointTree:
        """Build the tree of a motion."""
        tracked = motion.tracked
        translations, rotations = local_transforms(motion.points_world[tracked], motion.R_world_sticks[tracked])
        offsets = np.median(translations, axis=0)
        offsets[0] = 0.0
        rigid = bool(np.abs(translations - offsets)[:, 1:].max() < RIGID_M)
        filled = fill_linearly(in_frames(translations, tracked), tracked)
        turns = [fill_rotations(in_frames(R, tracked), tracked) for R in rotations.swapaxes(0, 1)]
        return cls(filled, np.stack(turns, axis=1), offsets, rigid)
