"""Extrinsic calibration against rigs that are known (of bench/calibration.py).

Corners of a board on the floor (15 frames averaged) and of one carried about are projected through the studio's rigs
with noise, and the cameras are placed from them. Errors are those of the cameras in the floor board's frame; "in sd"
is the root of the squared Mahalanobis distance over its 6 degrees of freedom (1 where the covariance is right).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, astuple, dataclass

from report import Table

import cv2
import numpy as np
from scenes import SHARED

from capture_rig.camera import CameraModel
from capture_rig.rig import Rig, load_rig
from capture_rig.rigid import inverse
from rig_calibration.boards.board import Board, Checkerboard, TargetDetection
from rig_calibration.extrinsics.board_frames import average_still_board
from rig_calibration.extrinsics.calibrate import FLOOR, MOVING, RigCalibration, Target, calibrate_rig
from rig_calibration.extrinsics.world import WorldChoice
from virtual_studio.rig import ring

NOISE_PX = 0.2
FLOOR_BOARD, CARRIED_BOARD = Checkerboard(7, 4, (0.12, 0.12)), Checkerboard(9, 6, (0.08, 0.08))
FLOOR_FRAMES, FRAMES, QUICK_FRAMES = 15, 150, 60
MARGIN_PX = 3.0
REAL_RIG = SHARED / "real_4cam" / "rig.yaml"


@dataclass(frozen=True)
class ExtrinsicRow:
    """How well one rig was calibrated: the worst camera's errors, and the mean of the errors in standard deviations."""

    rig: str
    boards: str
    cameras: int
    rms_px: float
    noise_px: float
    worst_mm: float
    worst_deg: float
    worst_in_sd: float
    mean_in_sd: float
    verdict: str


def synthetic_rows(quick: bool) -> Iterator[ExtrinsicRow]:
    """The studio's rings, and a real rig of portrait cameras where its file is at hand."""
    rigs = {f"ring of {n}{', ceiling' if top else ''}": ring(n, top) for n in range(3, 9) for top in (False, True)}
    if quick:
        rigs = {name: rigs[name] for name in ("ring of 3", "ring of 5, ceiling")}
    if REAL_RIG.is_file():
        rigs["real, 4 portrait cameras"] = load_rig(REAL_RIG)
    for seed, (name, rig) in enumerate(rigs.items()):
        floor, carried = floor_detections(rig, seed), carried_detections(rig, QUICK_FRAMES if quick else FRAMES, seed)
        cameras = {camera.name: camera for camera in rig.cameras}
        targets = {FLOOR: Target.of(FLOOR_BOARD, WorldChoice()), MOVING: Target.of(CARRIED_BOARD)}
        both = calibrate_rig(cameras, floor + carried, targets)
        yield row(name, "floor, carried", rig, both, floor_of(rig), NOISE_PX)
        seen = {detection.camera: cameras[detection.camera] for detection in floor}
        yield row(
            name, "floor alone", rig, calibrate_rig(seen, floor, {FLOOR: targets[FLOOR]}), floor_of(rig), NOISE_PX
        )


def row(
    name: str, boards: str, rig: Rig, found: RigCalibration, T_world_floor: np.ndarray, noise_px: float
) -> ExtrinsicRow:
    """The errors of every camera in the frame of the floor board's middle."""
    errors = np.array([_errors(camera, rig.camera(camera.name), T_world_floor) for camera in found.rig.cameras])
    covariances = [found.solution.covariance[camera.name] for camera in found.rig.cameras]
    in_sd = [np.sqrt(e @ np.linalg.solve(P, e) / 6) for e, P in zip(errors, covariances, strict=True)]
    return ExtrinsicRow(
        rig=name,
        boards=boards,
        cameras=len(errors),
        rms_px=round(found.rms_px / np.sqrt(2), 4),
        noise_px=noise_px,
        worst_mm=round(1e3 * np.linalg.norm(errors[:, 3:], axis=1).max(), 3),
        worst_deg=round(float(np.rad2deg(np.linalg.norm(errors[:, :3], axis=1).max())), 4),
        worst_in_sd=round(float(max(in_sd)), 2),
        mean_in_sd=round(float(np.sqrt(np.mean(np.square(in_sd)))), 2),
        verdict=found.verdict.grade,
    )


def floor_of(rig: Rig) -> np.ndarray:
    """T_world_floor (4, 4): the floor board lies in the middle of the rig's volume."""
    T = np.eye(4)
    T[:2, 3] = (rig.volume.low + rig.volume.high)[:2] / 2
    return T


def floor_detections(rig: Rig, seed: int) -> list[TargetDetection]:
    """What each camera that sees the floor board whole sees of it, averaged over some frames."""
    rng = np.random.default_rng([seed, 1])
    T_world_board = floor_of(rig) @ _centred(FLOOR_BOARD)
    found = []
    for camera in rig.cameras:
        frames = [project(camera, FLOOR_BOARD, T_world_board, FLOOR, m, rng) for m in range(FLOOR_FRAMES)]
        seen = [detection for detection in frames if detection is not None]
        if seen:
            found.append(average_still_board(seen, FLOOR_BOARD))
    return found


def carried_detections(rig: Rig, frames: int, seed: int) -> list[TargetDetection]:
    """What the cameras see of a board that a person carries: mostly upright, leaning, 0.5 to 1.8 m high."""
    rng = np.random.default_rng([seed, 2])
    found = []
    for frame_index in range(frames):
        upright = cv2.Rodrigues(np.array([np.pi / 2, 0.0, 0.0]))[0]
        facing = cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]))[0]
        T = np.eye(4)
        T[:3, :3] = cv2.Rodrigues(rng.normal(0.0, 0.5, 3))[0] @ facing @ upright
        T[:3, 3] = [*rng.uniform(-1.0, 1.0, 2), rng.uniform(0.5, 1.8)]
        T_world_board = floor_of(rig) @ T @ _centred(CARRIED_BOARD)
        found += [project(camera, CARRIED_BOARD, T_world_board, MOVING, frame_index, rng) for camera in rig.cameras]
    return [detection for detection in found if detection is not None]


def project(
    camera: CameraModel, board: Board, T_world_board: np.ndarray, target: str, frame: int, rng: np.random.Generator
) -> TargetDetection | None:
    """The corners with noise; None unless the camera sees the print's front and all of it."""
    points = board.corners_board @ T_world_board[:3, :3].T + T_world_board[:3, 3]
    pixels = camera.project(points)
    facing = (camera.centre_world - points.mean(axis=0)) @ T_world_board[:3, 2] > 0.15
    inside = np.isfinite(pixels).all() and (pixels > MARGIN_PX).all()
    if not facing or not inside or (pixels > np.array([camera.width, camera.height]) - MARGIN_PX).any():
        return None
    pixels = pixels + NOISE_PX * rng.standard_normal(pixels.shape)
    ids, size = np.arange(len(points)), (camera.width, camera.height)
    return TargetDetection(camera.name, frame, ids, pixels, size, target, NOISE_PX)


def print_rows(rows: list[ExtrinsicRow]) -> None:
    """As a table."""
    table = Table(
        "rig:<28 | boards:<15 | cameras:>7d | noise px:>8.2f | residual px:>11.3f | place mm:>8.2f | "
        "turn deg:>8.3f | worst in sd:>11.2f | mean in sd:>10.2f | verdict:>8",
        "extrinsics: the worst camera of each rig",
    )
    for r in rows:
        table.row(r.rig, r.boards, r.cameras, r.noise_px, r.rms_px, *astuple(r)[5:])


def figures(rows: list[ExtrinsicRow]) -> dict[str, object]:
    """For the line of JSON: over all rigs that saw a carried board, and every row."""
    carried = [r for r in rows if r.boards != "floor alone"]
    return {
        "extrinsics_worst_mm": max(r.worst_mm for r in carried),
        "extrinsics_worst_deg": max(r.worst_deg for r in carried),
        "extrinsics_mean_in_sd": round(float(np.sqrt(np.mean([r.mean_in_sd**2 for r in carried]))), 2),
        "extrinsics": [asdict(r) for r in rows],
    }


def _errors(found: CameraModel, truth: CameraModel, T_world_floor: np.ndarray) -> np.ndarray:
    """(6,) rotation vector in the camera's frame, rad, and centre, m; the truth moved into the floor's frame."""
    T_camera_floor = truth.T_camera_world @ T_world_floor
    turn = cv2.Rodrigues(found.R_camera_world @ T_camera_floor[:3, :3].T)[0].ravel()
    return np.concatenate([turn, found.centre_world - inverse(T_camera_floor)[:3, 3]])


def _centred(board: Board) -> np.ndarray:
    """The board's middle to the origin."""
    T = np.eye(4)
    T[:3, 3] = -board.corners_board.mean(axis=0)
    return T
