"""Calibration of wide lenses, 644 x 486 pixels: designed ones, and polynomials that fold inside the image.

    python bench/wide_lenses.py [--quick]

Each is calibrated as plumb_bob and with --model auto, from 30 views with 0.1 px of noise: of a checkerboard (seen
whole, so that it does not get into the image's corners), or of a ChArUco board that leaves the image. Off is how far
the lens found sees the true ray of a pixel from it, apart from a common turn; not used is the share of the pixels for
which it has no ray. The last line is JSON.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from report import Table, execute, finish, parser

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.camera import CameraModel
from rig_calibration.boards.board import Board, CharucoBoard, Checkerboard, TargetDetection
from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from virtual_studio.wide_lenses import PROJECTIONS, DesignedLens

CHECKERBOARD = Checkerboard(9, 6, (0.025, 0.025))
CHARUCO = CharucoBoard(11, 8, 0.03, 0.022, "DICT_5X5_100")
SIZES = {CHECKERBOARD: (0.35, 0.75), CHARUCO: (0.5, 1.1)}  # the board's diagonal in the image's width
VIEWS, NOISE_PX, SEED = 30, 0.1, 7
FEWEST, EDGE_PX = 12, 4
TILT_DEG, ROLL_RAD = 50.0, 0.6
STEP_PX = 6
POLYNOMIALS = {"k1 -0.4 k2 0.15 k3 -0.03": (-0.4, 0.15, -0.03), "k1 -0.3 k2 0.03": (-0.3, 0.03, 0.0)}
POLYNOMIALS["k1 -0.35 k2 0.08 (does not fold)"] = (-0.35, 0.08, 0.0)


class Lens(Protocol):
    """What views are taken with: a camera model, or a designed lens."""

    name: str
    width: int
    height: int
    K: np.ndarray

    def project(self, points: np.ndarray) -> np.ndarray: ...

    def rays_world(self, pixels: np.ndarray) -> np.ndarray: ...


def lenses(quick: bool) -> Iterator[tuple[str, float, Lens]]:
    """Name, degrees across, lens."""
    for across in (105.0,) if quick else (95.0, 105.0, 112.0):
        for name, radius_of in PROJECTIONS.items():
            yield name, across, DesignedLens(radius_of, across)
    for name, (k1, k2, k3) in POLYNOMIALS.items():
        for focal in (430.0,) if quick else (460.0, 430.0, 400.0):
            K = np.array([[focal, 0.0, 326.8], [0.0, focal, 239.4], [0.0, 0.0, 1.0]])
            camera = CameraModel("cam01", 644, 486, K, "plumb_bob", np.array([k1, k2, 0.0, 0.0, k3]), np.eye(4))
            sides = camera.rays_world([[0.0, 239.4], [643.0, 239.4]])
            yield name, float(np.rad2deg(np.arccos(sides[0] @ sides[1]))), camera


def waved(lens: Lens, board: Board) -> list[TargetDetection]:
    """The board all over the image, near and far, tilted to all sides: its exact corners and white noise."""
    rng, views = np.random.default_rng(SEED), []
    corners = board.corners_board - board.corners_board.mean(axis=0)
    diagonal, size = np.linalg.norm(np.ptp(corners, axis=0)), np.array([lens.width, lens.height])
    while len(views) < VIEWS:
        ray = lens.rays_world(rng.random((1, 2)) * (size - 1))[0]
        around, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(0, TILT_DEG))
        R = Rotation.from_rotvec(tilt * np.array([np.cos(around), np.sin(around), 0])).as_matrix()
        R = R @ Rotation.from_euler("z", rng.uniform(-ROLL_RAD, ROLL_RAD)).as_matrix() @ np.diag([1.0, -1.0, -1.0])
        points = corners @ R.T + lens.K[0, 0] * diagonal / (rng.uniform(*SIZES[board]) * lens.width) * ray
        if not (points[:, 2] > 0).all():  # NaN, too: a pixel without a ray
            continue
        pixels = lens.project(points)
        inside = ((pixels > EDGE_PX) & (pixels < size - 1 - EDGE_PX)).all(axis=1)
        if inside.all() or (board is CHARUCO and inside.sum() >= FEWEST):
            ids = np.flatnonzero(inside)
            seen = pixels[ids] + rng.normal(0, NOISE_PX, (len(ids), 2))
            views.append(TargetDetection("cam01", len(views), ids, seen, (lens.width, lens.height), "", NOISE_PX))
    return views


def pixels_off(found: CameraModel, truth: Lens) -> np.ndarray:
    """(n,) px, of the pixels for which both have a ray."""
    x, y = np.meshgrid(*(np.arange(0.0, size, STEP_PX) for size in (truth.width, truth.height)))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    true, ours = truth.rays_world(pixels), found.rays_world(pixels)
    known = np.isfinite(true).all(axis=1) & np.isfinite(ours).all(axis=1)
    turn = Rotation.align_vectors(ours[known], true[known])[0].as_matrix()
    off = np.hypot(*(found.project(true[known] @ turn.T) - pixels[known]).T)
    return off[np.isfinite(off)]


def main() -> None:
    """Print the table and the line of JSON."""
    quick = parser(__doc__, quick="one width of each lens").parse_args().quick
    table = Table(
        "lens:<36 | across:>6.0f | board:<12 | asked:<9 | taken:<19 | focal %:>7.2f | off px median:>13.2f | "
        "95 %:>6.2f | most:>6.1f | not used %:>10.1f | verdict:<7",
        "wide lenses",
    )
    figures: dict[str, list[float]] = {}
    for name, across, lens in lenses(quick):
        for board, called in ((CHECKERBOARD, "checkerboard"), (CHARUCO, "charuco")):
            views = waved(lens, board)
            for model in ("plumb_bob", "auto"):
                result = calibrate_intrinsics(views, board, name="cam01", model=model)
                off, camera = pixels_off(result.camera, lens), result.camera
                focal = 100 * abs(result.values["fx"] / lens.K[0, 0] - 1)
                numbers = (focal, *np.percentile(off, (50, 95, 100)), 100 * camera.unused_share)
                table.row(name, across, called, model, camera.distortion_model, *numbers, result.verdict.grade)
                figures.setdefault(f"{called}_{model}", []).append(float(numbers[2]))
    finish({f"wide_lenses_{key}_off_95_px_median": round(float(np.median(some)), 3) for key, some in figures.items()})


if __name__ == "__main__":
    execute(main)
