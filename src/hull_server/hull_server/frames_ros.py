"""The rig's cameras on /tf_static: map -> CAM (x forward, z up), CAM -> CAM_optical (z forward, y down; REP-103)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from geometry_msgs.msg import TransformStamped
from scipy.spatial.transform import Rotation

from capture_rig import Rig
from sagoma_ros.frames import frame

OPTICAL_TO_BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: the optical frame's x (right), y (down), z (forward) in the camera's x forward, y left, z up."""


def camera_frames(rig: Rig, frame_id: str, stamp_ns: int, tf_prefix: str = "") -> Iterator[TransformStamped]:
    """Yield the two frames of every camera."""
    for camera in rig.cameras:
        R_world_optical = camera.T_camera_world[:3, :3].T
        turned = Rotation.from_matrix(R_world_optical @ OPTICAL_TO_BODY.T).as_quat().tolist()
        name = tf_prefix + camera.name
        yield frame(frame_id, name, stamp_ns, camera.centre_world.tolist(), turned)
        optical = Rotation.from_matrix(OPTICAL_TO_BODY).as_quat().tolist()
        yield frame(name, f"{name}_optical", stamp_ns, (0.0, 0.0, 0.0), optical)
