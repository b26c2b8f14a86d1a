"""Times the hull server's core, silhouettes in to centerline points out, against plain NumPy and the thesis's sweep.

    python bench/hull.py --quick      # under a minute
    python bench/hull.py              # all backends, 8 poses

All times are medians in ms of one run on one machine; the ratios compare methods that ran in the same process, in
turns. The scene is the virtual studio's: a body in several poses, exact silhouettes, 640 x 480 cameras with lens
distortion, a volume of 2.5 x 2.5 x 2.2 m. The last line is JSON:

numpy_ratio : plain NumPy carving (every voxel, every camera, no slicing) over silhouettes -> points, 5 cameras, 20 mm.
sweep_ratio : the thesis's method (a textured quad a slice, read back, three sweeps, OpenCV components) over
    silhouettes -> points, 5 cameras, 20 mm; null where there is no OpenGL.
points_20mm_8cam_ms, points_10mm_5cam_ms : silhouettes -> filtered centerline points with the backend that auto takes.
voxel_disagreement : share of the occupied voxels on which the worst backend differs from NumPy in float64.
rss_10mm_mb : resident memory of a fresh process that carves at 10 mm with 8 cameras.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np

from capture_rig import FrameSet, InputError, Rig, Volume
from hull_server.backends import CarveBackend, make_backend
from hull_server.centerline import find_centerline
from hull_server.grid import VoxelGrid
from hull_server.pipeline import HullPipeline
from hull_server.settings import BlobSettings, HullSettings
from hull_server.slicer import slice_blobs
from hull_server.sweep_gl import SweepCarver
from hull_server.views import Masks, RigViews, min_seeing
from stick_figure.body import Body
from virtual_studio.body import VolumetricBody
from virtual_studio.motion import tour
from virtual_studio.render import VirtualCamera
from virtual_studio.rig import ring

VOLUME = Volume(np.array([-1.25, -1.25, 0.0]), np.array([1.25, 1.25, 2.2]))
STATURE_M, TOUR_S, TOUR_FPS = 1.75, 12.0, 10.0
MEMORY_OPTION = "--memory-of-one-process"


@cache
def scene(cameras: int, poses: int) -> tuple[Rig, list[dict[str, np.ndarray]]]:
    """A ring of cameras and one above, and the canvas silhouettes of a moving body."""
    rig = Rig(ring(cameras - 1).cameras, VOLUME)
    eyes = {camera.name: VirtualCamera(camera) for camera in rig.cameras}
    body = Body.from_stature(STATURE_M)
    motion = tour(body, TOUR_S, TOUR_FPS)
    frames = []
    for index in np.linspace(0, len(motion.poses) - 1, poses).astype(int):
        capsules = VolumetricBody(body).place(motion.poses[index])
        seen = {name: eye.see(capsules, None)[1] for name, eye in eyes.items()}
        frames.append({c.name: c.undistorted_view().undistort_mask(seen[c.name]) for c in rig.cameras})
    return rig, frames


def points(backend: CarveBackend, grid: VoxelGrid, masks: Masks) -> int:
    """What is timed: silhouettes to filtered centerline points."""
    volume = backend.carve(masks, min_seeing(len(masks)))
    return len(find_centerline(slice_blobs(volume), grid, BlobSettings()))


def plain_numpy(views: RigViews, grid: VoxelGrid, masks: Masks) -> np.ndarray:
    """The rule as one would first write it: every voxel centre, camera by camera, in float64. (nx, ny, nz) bool."""
    centres = grid.centres_world(np.indices(grid.shape).reshape(3, -1).T)
    occupied, seeing = np.ones(len(centres), bool), np.zeros(len(centres), np.uint8)
    for index, name in enumerate(views.names):
        P, (width, height) = views.P[index], views.sizes[index]
        homogeneous = centres @ P[:, :3].T + P[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = np.floor(homogeneous[:, :2] / homogeneous[:, 2:] + 0.5).T
        inside = np.flatnonzero((homogeneous[:, 2] > 0) & (u >= 0) & (v >= 0) & (u < width) & (v < height))
        row, column = v[inside].astype(int), u[inside].astype(int)
        seen = views.seen[index, row, column] > 0
        seeing[inside] += seen
        occupied[inside] &= ~seen | (masks[name][row, column] > 0)
    return (occupied & (seeing >= min_seeing(len(masks)))).reshape(grid.shape)


def thesis_sweep(sweep: SweepCarver, masks: Masks) -> int:
    """The thesis's whole method (3.1.3, 3.2): three sweeps, each slice read back and searched for components."""
    found = 0
    for axis in range(3):
        for image in sweep.sweep(masks, min_seeing(len(masks)), axis):
            if cv2.countNonZero(image):
                found += cv2.connectedComponentsWithStats(image, connectivity=8)[0] - 1
    return found


def median_ms(work: Callable[[Masks], object], frames: list, rounds: int) -> float:
    """Median over all frames and rounds, after one frame that is not counted."""
    work(frames[0])
    times = []
    for masks in frames * rounds:
        begin = time.perf_counter()
        work(masks)
        times.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(times))


def available(kinds: tuple[str, ...], views: RigViews, grid: VoxelGrid) -> dict[str, CarveBackend]:
    """The backends that this machine offers, by name; those that it does not are named on the way."""
    backends = {}
    for kind in kinds:
        try:
            backends[kind] = make_backend(kind, views, grid).backend
        except InputError as error:
            print(f"  {kind}: {error}")
    return backends


def time_points(quick: bool) -> dict[str, float]:
    """Print the table of silhouettes -> points; return the figures of the backend that auto takes."""
    figures = {}
    print(f"{'cameras':>7} {'voxel':>6} {'backend':>8} {'ms':>9}  device")
    for cameras, voxel_mm in ((5, 20), (8, 20), (5, 10), (8, 10)):
        rig, frames = scene(cameras, 4 if quick else 8)
        views, grid = RigViews.from_rig(rig), VoxelGrid.covering(VOLUME, voxel_mm / 1e3)
        kinds = ("auto", "gl") if quick else ("auto", "gl", "sweep")
        for kind, backend in available(kinds, views, grid).items():
            rounds = {"cpu": 25, "gl": 5, "sweep": 1}[backend.name]
            ms = median_ms(lambda masks, b=backend, g=grid: points(b, g, masks), frames, rounds)  # type: ignore[misc]
            print(f"{cameras:>7} {voxel_mm:>3} mm {backend.name:>8} {ms:>9.2f}  {backend.device}")
            if kind == "auto":
                figures[f"points_{voxel_mm}mm_{cameras}cam_ms"] = round(ms, 3)
            backend.close()
    return figures


def compare(quick: bool) -> dict[str, float | None]:
    """Ratios to plain NumPy and to the thesis's sweep, and the disagreement, all on 5 cameras at 20 mm."""
    rig, frames = scene(5, 4 if quick else 8)
    views, grid = RigViews.from_rig(rig), VoxelGrid.covering(VOLUME, 0.02)
    backends = available(("auto", "cpu", "gl", "sweep"), views, grid)
    auto, sweep = backends["auto"], backends.get("sweep")
    before = median_ms(lambda masks: points(auto, grid, masks), frames, 20)
    numpy_ms = median_ms(lambda masks: plain_numpy(views, grid, masks), frames[:2], 1)
    ours = (before + median_ms(lambda masks: points(auto, grid, masks), frames, 20)) / 2
    ratios: dict[str, float | None] = {"numpy_ratio": round(numpy_ms / ours, 1), "sweep_ratio": None}
    print(f"plain NumPy {numpy_ms:.0f} ms, ours {ours:.2f} ms")
    if isinstance(sweep, SweepCarver):
        sweep_ms = median_ms(lambda masks: thesis_sweep(sweep, masks), frames[:2], 2)
        print(f"the thesis's sweep, three axes, {sweep_ms:.0f} ms on {sweep.device}")
        ratios["sweep_ratio"] = round(sweep_ms / ours, 1)
    worst = 0.0
    for masks in frames[:2] if quick else frames:
        expected = plain_numpy(views, grid, masks)
        for kind, backend in backends.items():
            wrong = float((backend.carve(masks, min_seeing(5)).to_dense() != expected).sum() / expected.sum())
            print(f"{kind} differs from float64 on {wrong:.1e} of {expected.sum()} voxels")
            worst = max(worst, wrong)
    return ratios | {"voxel_disagreement": worst}


def memory_of_one_process() -> None:
    """Carve at 10 mm with 8 cameras and print the resident memory in MB: run in a process of its own."""
    rig, frames = scene(8, 2)
    pipeline = HullPipeline(rig, HullSettings(voxel_size_m=0.01))
    for masks in frames:
        pipeline.run(FrameSet(0, masks, dict.fromkeys(masks, 0), ()))
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    print(pages * os.sysconf("SC_PAGE_SIZE") / 1e6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer poses, without the sweep's own rows")
    parser.add_argument(MEMORY_OPTION, action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    if arguments.memory_of_one_process:
        memory_of_one_process()
        return
    figures = time_points(arguments.quick) | compare(arguments.quick)
    output = subprocess.run([sys.executable, __file__, MEMORY_OPTION], check=True, capture_output=True, text=True)
    figures["rss_10mm_mb"] = round(float(output.stdout.split()[-1]), 1)
    print(f"resident memory at 10 mm with 8 cameras: {figures['rss_10mm_mb']} MB")
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
