"""A calibration that was found, against the truth of what was filmed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.rig import Rig

from .board_caster import Array


@dataclass(frozen=True)
class CameraErrors:
    """Of one camera: focal length (the worse one), principal point (the worse coordinate), optical centre, and the
    angle of the rotation between found and true orientation."""

    name: str
    focal_percent: float
    principal_px: float
    centre_mm: float
    rotation_deg: float


def camera_errors(found: Rig, truth: Rig, T_world_floor: Array) -> list[CameraErrors]:
    """Every camera's errors. Nothing is aligned: the world that was found lies in the middle of the floor board, and
    ``T_world_floor`` (4, 4) says where that was."""
    return [_errors_of(camera, truth.camera(camera.name), T_world_floor) for camera in found.cameras]


def _errors_of(found: CameraModel, true: CameraModel, T_world_floor: Array) -> CameraErrors:
    focal = np.abs(found.K.diagonal()[:2] / true.K.diagonal()[:2] - 1.0).max()
    principal = np.abs(found.K[:2, 2] - true.K[:2, 2]).max()
    R = true.R_camera_world @ T_world_floor[:3, :3] @ found.R_camera_world.T
    turned = np.arctan2(np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]), np.trace(R) - 1.0)
    centre_world = T_world_floor[:3, :3] @ found.centre_world + T_world_floor[:3, 3]
    away_mm = 1e3 * float(np.linalg.norm(centre_world - true.centre_world))
    return CameraErrors(found.name, 100.0 * float(focal), float(principal), away_mm, float(np.rad2deg(turned)))
