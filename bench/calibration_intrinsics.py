"""Intrinsics of the studio's lenses from corners with known noise (of bench/calibration.py)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

from report import Table

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.camera import CameraModel
from rig_calibration.boards.board import Checkerboard, TargetDetection
from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from rig_calibration.intrinsics.result import Intrinsics
from virtual_studio.rig import ring

BOARD = Checkerboard(9, 6, (0.04, 0.04))
VIEWS = 60
EDGE_PX = 4
TILT_DEG, ROLL_RAD = 50.0, 0.6
SHOWN = {"rms_px": 1, "focal_error": 100, "sd_focal": 100, "centre_error_px": 1, "largest_sds": 1}  # and what times
SIZES = (0.35, 0.75)  # the board's diagonal in the image's width


@dataclass(frozen=True)
class Row:
    """One calibration against the truth. focal: the worse of fx and fy; sds: the largest error in its own sd."""

    camera: str
    noise_px: float
    views: int
    rms_px: float
    focal_error: float
    centre_error_px: float
    largest_sds: float
    squared_sds: tuple[float, ...]
    sd_focal: float
    verdict: str
    seconds: float


def corner_rows(noises_px: tuple[float, ...], repetitions: int) -> Iterator[Row]:
    """Every lens of the studio's ring of four and its ceiling, from corners with white noise."""
    for lens, camera in enumerate(ring(4).cameras):
        for noise_px in noises_px:
            for seed in range(repetitions):
                detections = waved(camera, BOARD, VIEWS, noise_px, 100 * lens + seed)
                begun = time.perf_counter()
                result = calibrate_intrinsics(detections, BOARD, name=camera.name)
                yield row_of(camera, noise_px, result, time.perf_counter() - begun)


def waved(camera: CameraModel, board: Checkerboard, count: int, noise_px: float, seed: int) -> list[TargetDetection]:
    """A board all over the image, near and far, tilted to all sides: its exact corners and white noise."""
    rng = np.random.default_rng(seed)
    eye = replace(camera, T_camera_world=np.eye(4))
    corners = board.corners_board - board.corners_board.mean(axis=0)
    diagonal = np.linalg.norm(np.ptp(corners, axis=0))
    size, views = np.array([camera.width, camera.height]), []
    while len(views) < count:
        depth = camera.K[0, 0] * diagonal / (rng.uniform(*SIZES) * camera.width)
        ray = eye.rays_world(rng.random((1, 2)) * (size - 1))[0]
        around, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(0, TILT_DEG))
        R = Rotation.from_rotvec(tilt * np.array([np.cos(around), np.sin(around), 0])).as_matrix()
        R = R @ Rotation.from_euler("z", rng.uniform(-ROLL_RAD, ROLL_RAD)).as_matrix() @ np.diag([1.0, -1.0, -1.0])
        pixels = eye.project(corners @ R.T + depth / ray[2] * ray)
        if not ((pixels > EDGE_PX) & (pixels < size - 1 - EDGE_PX)).all():  # NaN, too
            continue
        seen = pixels + rng.normal(0, noise_px, pixels.shape)
        views.append(
            TargetDetection(camera.name, len(views), np.arange(len(corners)), seen, tuple(size.tolist()), "", noise_px)
        )
    return views


def row_of(camera: CameraModel, noise_px: float, result: Intrinsics, seconds: float) -> Row:
    """The errors of a result."""
    truth = np.array([*camera.K.diagonal()[:2], *camera.K[:2, 2], *camera.D])
    error = np.array(list(result.values.values())) - truth
    in_sds = error / np.array(list(result.sd.values()))
    return Row(
        camera.name,
        noise_px,
        len(result.views),
        result.rms_px,
        float(np.abs(error[:2] / truth[:2]).max()),
        float(np.hypot(*error[2:4])),
        float(np.abs(in_sds).max()),
        tuple(in_sds**2),
        max(result.sd["fx"], result.sd["fy"]) / truth[0],
        result.verdict.grade,
        seconds,
    )


def print_rows(rows: list[Row]) -> None:
    """A table of the worst of each lens's repetitions."""
    table = Table(
        "lens:<6 | noise px:>8.1f | runs:>4d | views:>5d | rms px:>6.3f | focal %:>7.3f | sd %:>6.3f | "
        "centre px:>9.2f | largest error sd:>16.1f | errors' rms sd:>14.2f | s:>5.1f |  verdicts:<1",
        "intrinsics: the worst of each lens's runs",
    )
    groups: dict[tuple[str, float], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.camera, row.noise_px), []).append(row)
    for (camera, noise), some in groups.items():
        table.row(
            camera,
            noise,
            len(some),
            some[0].views,
            *(by * max(getattr(row, key) for row in some) for key, by in SHOWN.items()),
            rms_sds(some),
            np.mean([row.seconds for row in some]),
            " " + ", ".join(sorted({row.verdict for row in some})),
        )


def rms_sds(rows: list[Row]) -> float:
    """Root mean square of all errors in their own standard deviations: 1 where they are right."""
    return float(np.sqrt(np.mean([row.squared_sds for row in rows])))


def figures_of(rows: list[Row]) -> dict[str, float]:
    """For the line of JSON."""
    return {
        "intrinsics_corners_focal_percent": round(100 * max(row.focal_error for row in rows), 4),
        "intrinsics_corners_centre_px": round(max(row.centre_error_px for row in rows), 3),
        "intrinsics_corners_largest_sd": round(max(row.largest_sds for row in rows), 2),
        "intrinsics_corners_rms_sd": round(rms_sds(rows), 3),
        "intrinsics_rms_over_noise": round(float(np.mean([r.rms_px / r.noise_px / np.sqrt(2) for r in rows])), 4),
    }
