"""Joint angles by the recommendations of the International Society of Biomechanics (Wu et al. 2002 and 2005), degrees.

Segment frames: x forward, y up along the segment, z to the right. Left limbs are mirrored at the sagittal plane first,
so that the same movement of both sides has the same sign (Wu et al. 2005, 2.3.5). Angles that a stick figure does not
have are left out: the pelvis apart from the thorax, the clavicle, the forearm's pronation, the ankle.
docs/reference/points.md
defines each angle.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy.spatial.transform import Rotation

from stick_figure.skeleton import STICK_NAMES

from .motion import R_BIOMECHANICS_WORLD, Motion, in_frames

Array = np.ndarray

TRUNK_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Columns: a segment's x, y, z in the axes of our torso, head and leg sticks (x forward, y left, z up)."""
ARM_AXES = np.diag([1.0, -1.0, -1.0])
"""The same in the axes of our arm sticks, which lie along their y, towards the hand, and bend about their -z."""
MIRROR = np.diag([1.0, 1.0, -1.0])
SIDES = ("right", "left")


def isb_angles(motion: Motion) -> dict[str, Array]:
    """Return each angle (F,) of :func:`angles_of_sticks` by name, degrees, continuous over time; NaN in gaps."""
    known = motion.tracked
    return {name: _over_time(values, known) for name, values in angles_of_sticks(motion.R_world_sticks[known]).items()}


def angles_of_sticks(R_world_sticks: Array) -> dict[str, Array]:
    """Return each angle (F,) by name, degrees, of the sticks' frames (F, 10, 3, 3); each within a turn and a half of
    zero, alone.

    Cardan sequence z, x, y for trunk, neck, hips and knees (Grood & Suntay 1983: flexion, adduction, axial rotation);
    y, x, y for the shoulders (plane of elevation, elevation, axial rotation; Wu et al. 2005, 2.4.7).
    """
    R = {name: R_world_sticks[:, stick] for stick, name in enumerate(STICK_NAMES)}
    trunk = R["torso"] @ TRUNK_AXES
    upright = R_BIOMECHANICS_WORLD.T  # columns: x forward, y up, z right of the world
    joints = {"thorax": _relative(upright, trunk), "neck": _relative(trunk, R["head"] @ TRUNK_AXES)}
    shoulders = {}
    for side in SIDES:
        upper, lower = R[f"{side}_upper_arm"] @ ARM_AXES, R[f"{side}_forearm"] @ ARM_AXES
        shoulders[side] = _relative(trunk, upper, side)
        joints[f"{side}_elbow"] = _relative(upper, lower, side)
    for side in SIDES:
        thigh, calf = R[f"{side}_thigh"] @ TRUNK_AXES, R[f"{side}_calf"] @ TRUNK_AXES
        joints |= {f"{side}_hip": _relative(trunk, thigh, side), f"{side}_knee": _relative(thigh, calf, side)}
    cardan, of_shoulder = _degrees(joints, "ZXY"), _degrees(shoulders, "YXY")
    angles = dict(
        zip(("thorax_tilt", "thorax_lateral_flexion", "thorax_axial_rotation"), cardan["thorax"], strict=True)
    )
    angles |= {"neck_flexion": -cardan["neck"][0], "neck_lateral_flexion": cardan["neck"][1]}
    for side in SIDES:
        plane, elevation, axial = of_shoulder[side]
        raised = elevation > 0.0  # the same rotation with the elevation of Wu et al.'s sign: negative
        angles |= {
            f"{side}_shoulder_plane_of_elevation": plane + 180.0 * raised,
            f"{side}_shoulder_elevation": -np.abs(elevation),
            f"{side}_shoulder_axial_rotation": axial - 180.0 * raised,
            f"{side}_elbow_flexion": cardan[f"{side}_elbow"][0],
        }
    for side in SIDES:
        flexion, adduction, axial = cardan[f"{side}_hip"]
        angles |= {f"{side}_hip_flexion": flexion, f"{side}_hip_adduction": adduction}
        angles |= {f"{side}_hip_internal_rotation": axial, f"{side}_knee_flexion": -cardan[f"{side}_knee"][0]}
    return angles


def _relative(R_proximal: Array, R_distal: Array, side: str = "right") -> Array:
    """Rotations (F, 3, 3) of the distal frame in the proximal one; of a left limb mirrored to the right."""
    relative = np.swapaxes(R_proximal, -1, -2) @ R_distal
    return MIRROR @ relative @ MIRROR if side == "left" else relative


def _degrees(R: dict[str, Array], sequence: str) -> dict[str, Array]:
    """Return body-fixed angles (3, F) of rotations (F, 3, 3); where two axes coincide the first gets all of their
    turn."""
    stacked = np.concatenate(list(R.values()))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock", UserWarning)
        angles = Rotation.from_matrix(stacked).as_euler(sequence, degrees=True)
    return {name: own.T for name, own in zip(R, np.split(angles, len(R)), strict=True)}


def _over_time(values: Array, known: Array) -> Array:
    """(F,) continuous angles, NaN in gaps, the first one within half a turn of zero."""
    continuous = np.unwrap(values, period=360.0)
    return in_frames(continuous - 360.0 * np.round(continuous[:1] / 360.0), known)
