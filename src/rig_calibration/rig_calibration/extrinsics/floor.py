"""The pose of one camera from a board on the floor, which is mostly seen at a grazing angle (thesis 6.1).

A plane has two poses that fit its picture nearly as well (Schweighofer & Pinz 2006): both are looked at, and kept
unless the corners rule one out. EPnP is not used: it fails by metres on a plane seen at a grazing angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from ..boards.sighting import Sighting
from ..bundle.rigid import inverse, transform
from ..bundle.sighting_poses import sighting_poses
from ..bundle.target_shape import target_shape

Array = npt.NDArray[np.float64]

FEWEST_CORNERS = 4
SAME_POSE = np.deg2rad(0.5)
"""Solutions whose planes differ by less are one."""
RULED_OUT_CHI2 = 25.0
"""The second solution is ruled out when it explains the corners so much worse (5 standard deviations)."""


@dataclass(frozen=True, eq=False)
class FloorView:
    """How one camera sees the board on the floor.

    T_camera_board : (4, 4). rms_px : of the corners' coordinates. other : the second solution (4, 4), None when the
    corners rule it out. distance_m and angle (rad, from the board's normal) : of the camera, from the board's middle.
    sd_centre_m, sd_rotation (rad) : expected from the corners' noise, in the direction in which it is largest.
    """

    camera: str
    T_camera_board: Array
    rms_px: float
    corners: int
    other: Array | None
    distance_m: float
    angle: float
    sd_centre_m: float
    sd_rotation: float

    @property
    def centre_board(self) -> Array:
        """(3,) the camera's centre in the board frame."""
        return inverse(self.T_camera_board)[:3, 3]


def see_floor(sighting: Sighting, corners_board: Array, camera: CameraModel) -> FloorView:
    """The camera's pose before the board that ``sighting`` shows. Only the intrinsics of ``camera`` are used.

    ``corners_board`` (n, 3) metres. Raises InputError for too few corners, and for a board seen from below.
    """
    if len(sighting) < FEWEST_CORNERS:
        raise InputError(
            f"only {len(sighting)} corners of the board are seen",
            where=sighting.camera,
            remedy=f"Show it whole, or give its {FEWEST_CORNERS} outer corners (--corners).",
        )
    points = corners_board[sighting.ids]
    solutions = _solutions(sighting, corners_board, camera)
    if not solutions:
        raise InputError(
            "the corners fit no pose of the board",
            where=sighting.camera,
            remedy="Check its corners in the picture, or give its outer corners (--corners).",
        )
    above = [(rms, T) for rms, T in solutions if inverse(T)[2, 3] > 0]
    if not above:
        raise InputError(
            "the corners' order is that of a board seen from below or in a mirror",
            where=sighting.camera,
            remedy="Lay the print upwards, switch off the camera's mirroring, and give outer corners "
            "in reading order: the first row's two ends, then the last row's last and first.",
        )
    rms, T = above[0]
    sigma = max(sighting.sigma_px, rms)
    sd_rotation, sd_centre = _standard_deviations(points, camera, T, sigma)
    to_camera = inverse(T)[:3, 3] - points.mean(axis=0)
    distance = float(np.linalg.norm(to_camera))
    return FloorView(
        camera=sighting.camera,
        T_camera_board=T,
        rms_px=rms,
        corners=len(sighting),
        other=_not_ruled_out(above, len(sighting), sigma),
        distance_m=distance,
        angle=float(np.arccos(np.clip(to_camera[2] / distance, -1.0, 1.0))),
        sd_centre_m=sd_centre,
        sd_rotation=sd_rotation,
    )


def _solutions(sighting: Sighting, corners_board: Array, camera: CameraModel) -> list[tuple[float, Array]]:
    """Poses that fit, the best first: (rms of the raw pixels' coordinates, T_camera_board)."""
    shape = target_shape(sighting.target, corners_board)
    poses = sighting_poses(sighting, camera, shape)
    if poses is None:
        return []
    found = [transform(R, t - R @ shape.centroid) for R, t in zip(poses.R, poses.t, strict=True)]
    points = corners_board[sighting.ids]
    misses = [_project(points, camera, T) - sighting.pixels for T in found]
    return sorted(
        ((float(np.sqrt((miss**2).mean())), T) for miss, T in zip(misses, found, strict=True)), key=lambda pair: pair[0]
    )


def _project(points: Array, camera: CameraModel, T: Array) -> Array:
    pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], camera.K, camera.D)
    return np.asarray(pixels, float).reshape(-1, 2)


def _not_ruled_out(solutions: list[tuple[float, Array]], corners: int, sigma: float) -> Array | None:
    """The next best solution with another plane, when its residual is not clearly worse."""
    best_rms, best = solutions[0]
    for rms, T in solutions[1:]:
        apart = np.arccos(np.clip(best[:3, 2] @ T[:3, 2], -1.0, 1.0))
        if apart > SAME_POSE and 2 * corners * (rms**2 - best_rms**2) < RULED_OUT_CHI2 * sigma**2:
            return T
    return None


def _standard_deviations(points: Array, camera: CameraModel, T: Array, sigma: float) -> tuple[float, float]:
    """Of rotation (rad) and centre (m), each in its worst direction: (J^T J / sigma^2)^-1 of a pinhole.

    With x' = x + w x x + v in the camera frame, the rotation errs by w and the centre by -R^T v.
    """
    x, y, z = T[:3, :3] @ points.T + T[:3, 3:]
    zero, one = np.zeros_like(x), np.ones_like(x)
    by_point = np.stack([np.stack([one / z, zero, -x / z**2]), np.stack([zero, one / z, -y / z**2])])  # (2, 3, n)
    by_point *= camera.K.diagonal()[:2, None, None]
    by_turn = np.stack([np.stack([zero, z, -y]), np.stack([-z, zero, x]), np.stack([y, -x, zero])])  # (3, 3, n)
    J = np.concatenate([np.einsum("ijn,jkn->nik", by_point, by_turn), by_point.transpose(2, 0, 1)], axis=2)
    J = J.reshape(-1, 6)
    covariance = sigma**2 * np.linalg.pinv(J.T @ J)
    worst = [float(np.sqrt(np.linalg.eigvalsh(block)[-1])) for block in (covariance[:3, :3], covariance[3:, 3:])]
    return worst[0], worst[1]
