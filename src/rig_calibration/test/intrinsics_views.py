"""Views of a board by a known lens, projected by the camera model, which OpenCV's own projection checks elsewhere."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.camera import CameraModel
from capture_rig.verdict import Finding
from rig_calibration.boards.board import Board, Checkerboard, TargetDetection
from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from rig_calibration.intrinsics.result import Intrinsics

BOARD = Checkerboard(9, 6, (0.025, 0.025))
FACING = np.diag([1.0, -1.0, -1.0])
EDGE_PX = 4


def lens(D=(-0.185, 0.084, 3e-4, -2e-4, 0.0), model="plumb_bob", focal=467.0):
    """A wide lens of 640 x 480 with its principal point off the middle."""
    K = np.array([[focal, 0, 324.5], [0, focal * 0.999, 245.4], [0, 0, 1]])
    return CameraModel("cam01", 640, 480, K, model, np.array(D), np.eye(4))


def shown(
    camera: CameraModel,
    count: int,
    noise_px: float,
    seed: int,
    *,
    board: Board = BOARD,
    tilt_deg: float = 45.0,
    reach: float = 1.0,
    sizes: tuple[float, float] = (0.35, 0.7),
    bow_m: float = 0.0,
    partial: bool = False,
) -> list[TargetDetection]:
    """``count`` views: places all over the image (``reach`` of it), tilts up to ``tilt_deg``, the board's diagonal
    ``sizes`` of the image's width; ``bow_m``: its middle stands out along its rows; ``partial``: it may leave the
    image."""
    rng = np.random.default_rng(seed)
    corners, views = board.corners_board, []
    centred = corners - corners.mean(axis=0)
    diagonal = np.linalg.norm(np.ptp(centred, axis=0))
    centred[:, 2] = bow_m * (1 - (centred[:, 0] / np.abs(centred[:, 0]).max()) ** 2)
    size = np.array([camera.width, camera.height])
    while len(views) < count:
        depth = camera.K[0, 0] * diagonal / (rng.uniform(*sizes) * camera.width)
        place = (size - 1) / 2 + (rng.random(2) - 0.5) * size * reach
        ray = camera.rays_world(place[None])[0]
        around = rng.uniform(0, 2 * np.pi)
        tilt = Rotation.from_rotvec(
            np.deg2rad(rng.uniform(0, tilt_deg)) * np.array([np.cos(around), np.sin(around), 0])
        )
        R = tilt.as_matrix() @ Rotation.from_euler("z", rng.uniform(-0.5, 0.5)).as_matrix() @ FACING
        pixels = camera.project(centred @ R.T + depth / ray[2] * ray)
        inside = (np.isfinite(pixels) & (pixels > EDGE_PX) & (pixels < size - 1 - EDGE_PX)).all(axis=1)
        if not (inside.all() or (partial and inside.sum() >= 12)):
            continue
        ids = np.flatnonzero(inside)
        seen = pixels[inside] + rng.normal(0, noise_px, (len(ids), 2)) if noise_px else pixels[inside]
        views.append(
            TargetDetection(camera.name, len(views), ids, seen, (camera.width, camera.height), "", noise_px or 0.1)
        )
    return views


def with_pixels(detection: TargetDetection, pixels: np.ndarray) -> TargetDetection:
    return replace(detection, pixels=pixels)


def folding_lens(D=(-0.4, 0.15, 0.0, 0.0, -0.03), focal=418.0):
    """644 x 486 pixels, about 100 degrees across, whose radial polynomial turns back before the image's corners."""
    K = np.array([[focal, 0, 326.8], [0, focal, 239.4], [0, 0, 1]])
    return CameraModel("cam01", 644, 486, K, "plumb_bob", np.array(D), np.eye(4))


def found(detections, board: Board = BOARD, model: str = "plumb_bob") -> Intrinsics:
    """The lens that the corners show."""
    return calibrate_intrinsics(detections, board, name="cam01", model=model)


def lens_errors(result: Intrinsics, camera: CameraModel) -> np.ndarray:
    """What was found less the truth: fx fy cx cy and the distortion coefficients."""
    truth = np.array([*camera.K.diagonal()[:2], *camera.K[:2, 2], *camera.D])
    return np.array(list(result.values.values())) - truth


def errors_in_sds(result: Intrinsics, camera: CameraModel) -> np.ndarray:
    """The same in the standard deviations that the result claims."""
    return lens_errors(result, camera) / np.array(list(result.sd.values()))


def said(result: Intrinsics, text: str) -> list[Finding]:
    """The verdict's findings with a text."""
    return [finding for finding in result.verdict.findings if text in finding.what]


def pixel_errors(found: CameraModel, truth, step_px: int = 6) -> np.ndarray:
    """(n,) px: how far from each pixel the lens found puts the ray that the true one has there, apart from a common
    turn of the camera; NaN where either has none."""
    x, y = np.meshgrid(*(np.arange(0.0, size, step_px) for size in (truth.width, truth.height)))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    true, ours = truth.rays_world(pixels), found.rays_world(pixels)
    known = np.isfinite(true).all(axis=1) & np.isfinite(ours).all(axis=1)
    turn = Rotation.align_vectors(ours[known], true[known])[0].as_matrix()
    return np.hypot(*(found.project(true @ turn.T) - pixels).T)
