"""sensor_msgs/CameraInfo: as the calibration of one of our cameras, and of one that has none yet."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import CameraInfo

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import with_intrinsics
from sagoma_ros.stamps import to_stamp


def camera_from_message(info: CameraInfo, camera: CameraModel) -> CameraModel:
    """``camera`` with the intrinsics of ``info``; its pose stays. Raises InputError naming the field and the value."""
    K, R = np.reshape(info.k, (3, 3)), np.reshape(info.r, (3, 3))
    if not R.any():  # a message that nobody filled in leaves it at zero
        R = np.eye(3)
    return with_intrinsics(
        camera, info.width, info.height, K.tolist(), info.distortion_model, list(info.d), R.tolist(), "set_camera_info"
    )


def uncalibrated_message(shape: tuple[int, ...], stamp_ns: int, frame_id: str) -> CameraInfo:
    """The camera_info of raw images of ``shape`` (H, W[, 3]) whose lens is unknown: K[0] = 0 says so (REP-104)."""
    info = CameraInfo(height=shape[0], width=shape[1])
    info.header.stamp, info.header.frame_id = to_stamp(stamp_ns), frame_id
    return info
