"""A sensor_msgs/CameraInfo as the calibration of one of our cameras."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import CameraInfo

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import with_intrinsics


def camera_from_message(info: CameraInfo, camera: CameraModel) -> CameraModel:
    """``camera`` with the intrinsics of ``info``; its pose stays. Raises InputError naming the field and the value."""
    K, R = np.reshape(info.k, (3, 3)), np.reshape(info.r, (3, 3))
    if not R.any():  # a message that nobody filled in leaves it at zero
        R = np.eye(3)
    return with_intrinsics(
        camera, info.width, info.height, K.tolist(), info.distortion_model, list(info.d), R.tolist(), "set_camera_info"
    )
