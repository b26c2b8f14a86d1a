"""Joints that detectors of 2D poses find in the cameras' images, as they come in: from a topic, from a table.

A skeleton is one person in one image. Its joints have names, of COCO (`left_wrist`, `left_ankle`, ...; the face is
ignored) or of our 15 points (`left_hand`, `left_foot`, ...); `left_hip` of a skeleton with wrists or ankles is COCO's,
beside the joint's centre.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from capture_rig.rig import Rig
from stick_figure.least_squares.keypoint_factor import LANDMARK_NAMES, NO_KEYPOINTS, Keypoints

NUMBERS = ("x", "y", "cov_xx", "cov_xy", "cov_yy", "score")
"""Of each joint: px of the camera's image as it is, distorted; px^2; from 0 to 1. NaN x where it was not found."""
OF_COCO = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
COCO_PLACES = {
    **{f"{side}_hip": f"{side}_hip_of_image" for side in ("left", "right")},
    **{f"{side}_ankle": f"{side}_foot" for side in ("left", "right")},
}
"""Where in the figure joints of COCO are that have another name, or another place, than ours."""


@dataclass(frozen=True, eq=False)
class Detections:
    """What was found in one image: names (k,) of joints, and their NUMBERS, values (skeletons, k, 6)."""

    camera: str
    stamp_ns: int
    names: Sequence[str]
    values: np.ndarray

    @property
    def landmarks(self) -> np.ndarray:
        """(k,) the landmark of each joint, -1 of joints that the figure does not have."""
        places = COCO_PLACES if set(OF_COCO) & set(self.names) else {}
        found = [places.get(name, name) for name in self.names]
        return np.array([LANDMARK_NAMES.index(name) if name in LANDMARK_NAMES else -1 for name in found], int)


def keypoints_of(rig: Rig, images: Iterable[Detections]) -> Keypoints:
    """Return the detections in the images of one instant. Joints without a finite place, a positive definite covariance
    and a positive score are dropped."""
    parts, skeletons = list[Keypoints](), 0
    for image in images:
        camera, values = rig.camera(image.camera), np.asarray(image.values, float)
        xx, xy, yy, score = np.moveaxis(values[..., 2:], -1, 0)
        usable = np.isfinite(values).all(axis=-1) & (image.landmarks >= 0)
        usable[usable] &= ((xx > 0.0) & (xx * yy > xy * xy) & (score > 0.0))[usable]
        skeleton, joint = np.nonzero(usable)
        found, (fx, fy) = values[usable], camera.K.diagonal()[:2]
        number = np.full(len(found), rig.names.index(image.camera))
        parts.append(
            Keypoints(
                image.landmarks[joint],
                np.tile(camera.T_camera_world[:3], (len(found), 1, 1)),
                camera.ideal_points(found[:, :2]),
                found[:, 2:5] / [fx * fx, fx * fy, fy * fy],
                np.minimum(found[:, 5], 1.0),
                skeletons + skeleton,
                number,
            )
        )
        skeletons += len(values)
    if not parts:
        return NO_KEYPOINTS
    every = Keypoints(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    return every.chosen(np.isfinite(every.ideal).all(axis=1))  # beyond the reach of the lens's model
