"""Intrinsics of the studio's lenses: from corners with known noise, from rendered video, and from photographs.

Used by bench/calibration.py.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from report import Table

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.camera import CameraModel
from rig_calibration.boards.board import Checkerboard, TargetDetection
from rig_calibration.boards.specification import read_board
from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from rig_calibration.intrinsics.result import Intrinsics
from sagoma_tools.calibration.footage import open_footage_of_cameras
from sagoma_tools.calibration.intrinsics import watch_footage
from virtual_studio.recording.footage import INTRINSICS, FootagePlan, write_calibration_footage
from virtual_studio.rig import ring

BOARD = Checkerboard(9, 6, (0.04, 0.04))
VIEWS = 60
EDGE_PX = 4
TILT_DEG, ROLL_RAD = 50.0, 0.6
SIZES = (0.35, 0.75)  # the board's diagonal in the image's width


@dataclass(frozen=True)
class Row:
    """One calibration against the truth. focal: the worse of fx and fy; sds: the largest error in its own sd."""

    source: str
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
                yield row_of("corners", camera, noise_px, result, time.perf_counter() - begun)


def video_rows(cameras: int, brief: bool) -> Iterator[Row]:
    """Rendered video: the sensor's noise, blur, motion, compression; boards are found and views chosen as always."""
    rig = ring(4)
    with tempfile.TemporaryDirectory(prefix="sagoma_calibration_") as folder:
        filmed = replace(rig, cameras=rig.cameras[:cameras])
        plan = FootagePlan(brief=brief, moving_s=0.5)
        path = write_calibration_footage(Path(folder) / "setup", filmed, plan)
        for footage in open_footage_of_cameras([str(path / INTRINSICS)]).values():
            begun = time.perf_counter()
            watcher = watch_footage(footage, plan.hand_board, "plumb_bob")
            result = calibrate_intrinsics(watcher.collector.best(), plan.hand_board, name=footage.name)
            yield row_of("video", rig.camera(footage.name), np.nan, result, time.perf_counter() - begun)


def photograph_results(sources: list[str], board: str) -> dict[str, Intrinsics]:
    """Real photographs, for which there is no truth."""
    results = {}
    for footage in open_footage_of_cameras(sources).values():
        watcher = watch_footage(footage, read_board(board), "plumb_bob")
        results[footage.name] = calibrate_intrinsics(watcher.collector.best(), read_board(board), name=footage.name)
    return results


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


def row_of(source: str, camera: CameraModel, noise_px: float, result: Intrinsics, seconds: float) -> Row:
    """The errors of a result."""
    truth = np.array([*camera.K.diagonal()[:2], *camera.K[:2, 2], *camera.D])
    error = np.array(list(result.values.values())) - truth
    in_sds = error / np.array(list(result.sd.values()))
    return Row(
        source,
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
        "from:<8 | lens:<6 | noise px:>8 | runs:>4d | views:>5d | rms px:>6.3f | focal %:>7.3f | sd %:>6.3f | "
        "centre px:>9.2f | largest error sd:>16.1f | errors' rms sd:>14.2f | s:>5.1f |  verdicts:<1",
        "intrinsics: the worst of each lens's runs",
    )
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        noise = "" if np.isnan(row.noise_px) else f"{row.noise_px:g}"
        groups.setdefault((row.source, row.camera, noise), []).append(row)
    for (source, camera, noise), some in groups.items():
        table.row(
            source,
            camera,
            noise,
            len(some),
            some[0].views,
            max(row.rms_px for row in some),
            100 * max(row.focal_error for row in some),
            100 * max(row.sd_focal for row in some),
            max(row.centre_error_px for row in some),
            max(row.largest_sds for row in some),
            rms_sds(some),
            np.mean([row.seconds for row in some]),
            " " + ", ".join(sorted({row.verdict for row in some})),
        )


def rms_sds(rows: list[Row]) -> float:
    """Root mean square of all errors in their own standard deviations: 1 where they are right."""
    return float(np.sqrt(np.mean([row.squared_sds for row in rows])))


def figures_of(rows: list[Row]) -> dict[str, float]:
    """For the line of JSON."""
    figures: dict[str, float] = {}
    for source in ("corners", "video"):
        some = [row for row in rows if row.source == source]
        if some:
            figures |= {
                f"intrinsics_{source}_focal_percent": round(100 * max(row.focal_error for row in some), 4),
                f"intrinsics_{source}_centre_px": round(max(row.centre_error_px for row in some), 3),
                f"intrinsics_{source}_largest_sd": round(max(row.largest_sds for row in some), 2),
                f"intrinsics_{source}_rms_sd": round(rms_sds(some), 3),
            }
    noise = [row for row in rows if row.source == "corners"]
    if noise:
        figures["intrinsics_rms_over_noise"] = round(
            float(np.mean([row.rms_px / row.noise_px / np.sqrt(2) for row in noise])), 4
        )
    return figures
