"""The bundle adjuster on synthetic rigs: accuracy, coverage of its covariance, delays between cameras, time.

    python bench/calibration_bundle.py [--quick]

Prints a table and, last, one line of JSON.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from report import Table, execute, finish, parser

import numpy as np
from bundle_studio import T_WORLD_FLOOR, TARGETS, carried, carried_and_floor, detections_of, errors, ring, truth

from capture_rig.camera import CameraModel
from rig_calibration.boards.board import Checkerboard, TargetDetection
from rig_calibration.bundle.solve import solve_rig

CAMERAS = ring(4)
LENS_SD = np.array([1.0, 1.0, 1.5, 1.5, 0.002, 0.004, 2e-4, 2e-4, 0.0])
LENSES = {"intrinsics_covariance": dict.fromkeys(CAMERAS, LENS_SD)}
FRAMES, DELAY_S, SPEED_M_S = 60, 0.005, 0.5


def with_wrong_lenses(rng: np.random.Generator) -> dict[str, CameraModel]:
    """Intrinsics that are wrong by LENS_SD (px and distortion)."""
    found = {}
    for name, camera in CAMERAS.items():
        e = rng.normal(size=9) * LENS_SD
        K = camera.K + np.array([[e[0], 0, e[2]], [0, e[1], e[3]], [0, 0, 0]])
        found[name] = replace(camera, K=K, D=camera.D + e[4:])
    return found


def delayed(rng: np.random.Generator) -> list[TargetDetection]:
    """A board carried in changing directions; cameras expose up to DELAY_S apart."""
    poses = carried(rng, FRAMES)
    ways = {frame_index: rng.normal(size=3) for frame_index in poses}
    found = detections_of(CAMERAS, {0: T_WORLD_FLOOR}, "floor", rng, max_tilt_deg=85)
    for delay, (name, camera) in zip((0.0, 1.0, 0.3, 0.6), CAMERAS.items(), strict=True):
        moved = {frame_index: T.copy() for frame_index, T in poses.items()}
        for frame_index, T in moved.items():
            T[:3, 3] += ways[frame_index] / np.linalg.norm(ways[frame_index]) * SPEED_M_S * DELAY_S * delay
        found += detections_of({name: camera}, moved, "moving", rng)
    return found


def accuracy(
    runs: int, see: Callable[[np.random.Generator], list[TargetDetection]], options: Mapping[str, object] | None = None
) -> dict[str, float]:
    """Errors of all cameras of many rigs, relative to the floor board; with ``options``, of wrong lenses."""
    found, normalised = [], []
    for run in range(runs):
        rng = np.random.default_rng(run)
        detections = see(rng)
        cameras = CAMERAS if options is None else with_wrong_lenses(rng)
        solution = solve_rig(cameras, detections, TARGETS, reference="floor", **(options or {}))  # type: ignore[arg-type]
        for name, error in errors(solution, truth(CAMERAS)).items():
            found.append(error)
            normalised.append(error / np.sqrt(np.diag(solution.covariance[name])))
    e, z = np.array(found), np.array(normalised)
    return {
        "centre_rms_mm": 1000 * float(np.sqrt((e[:, 3:] ** 2).sum(1).mean())),
        "centre_worst_mm": 1000 * float(np.sqrt((e[:, 3:] ** 2).sum(1).max())),
        "rotation_worst_deg": float(np.degrees(np.sqrt((e[:, :3] ** 2).sum(1).max()))),
        "error_over_sd": float(np.sqrt((z**2).mean())),
        "within_3_sd": float((np.abs(z) < 3).mean()),
    }


def seconds(cameras: int, frames: int) -> tuple[int, float]:
    """Corners of a 9 x 6 board and the processor time of the whole solution."""
    rng, rig, board = np.random.default_rng(0), ring(cameras), Checkerboard(9, 6, (0.06, 0.06)).corners_board
    detections = detections_of(rig, carried(rng, frames), "moving", rng, points=board)
    start = time.process_time()
    solve_rig(rig, detections, {"moving": board})
    return sum(map(len, detections)), time.process_time() - start


def main() -> None:
    quick = parser(__doc__, quick="fewer rigs: under a minute").parse_args().quick
    runs = 6 if quick else 40

    def plain(rng: np.random.Generator) -> list[TargetDetection]:
        return carried_and_floor(CAMERAS, rng, FRAMES)

    cases = {
        "noise of 0.2 px": accuracy(runs, plain),
        "and 5 ms of delay at 0.5 m/s": accuracy(runs, delayed),
        "uncertain lenses": accuracy(runs, plain, LENSES),
        "uncertain lenses, refined": accuracy(runs, plain, {**LENSES, "refine_intrinsics": True}),
    }
    keys = list(cases["noise of 0.2 px"])
    title = f"4 cameras of 640 x 480, {FRAMES} frames of a carried board, one floor board (the gauge); {runs} rigs"
    table = Table({"case": "<30", **dict.fromkeys(keys, ">19.3f")}, title)
    for name, figures in cases.items():
        table.row(name, *(figures[key] for key in keys))
    corners, used_s = seconds(*((4, 100) if quick else (8, 300)))
    print(f"whole solution, {corners} corners: {used_s:.1f} s of one core")
    finish({"bundle": {**cases, "corners": corners, "solve_s": used_s}})


if __name__ == "__main__":
    execute(main)
