"""Times the hull server's core, silhouettes in to centerline points out, against other ways to carve.

    python bench/hull.py --quick                 # under a minute
    python bench/hull.py                         # 5 and 8 cameras, 40 to 5 mm, all methods (more: live.py --scaling)

All methods take turns on the same frames in one process; a cell is the median of its times in ms, "x" its ratio to
ours on the CPU. A method that would take longer than --limit seconds a frame is left out of the finer grids. The scene
is the virtual studio's: a body in several poses, exact silhouettes, 640 x 480 cameras with lens distortion, a volume of
2.5 x 2.5 x 2.2 m. Ours goes all the way to filtered points; the others stop at occupied voxels.

It needs neither ROS nor a window: numpy, scipy, opencv-python-headless, PyYAML and numba; PyOpenGL for OpenGL, open3d
for its row. The last line is JSON:

numpy_ratio, open3d_ratio, sweep_ratio : time of the method over ours, 5 cameras, 20 mm; null where it cannot run.
points_20mm_8cam_ms, points_10mm_5cam_ms : silhouettes -> filtered points with the backend that auto takes, one set
    after another as in the server. (In the table the others evict ours from the caches each turn: half as long again.)
gl_10mm_5cam_ms : the same with OpenGL compute, on whatever device there is; null without OpenGL 4.3.
voxel_disagreement : share of the occupied voxels on which the worst backend differs from NumPy in float64.
exponent (not with --quick): time grows as (1 / voxel size) to this power, 20 to 5 mm; 2 is surface, 3 is volume.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from report import Table, execute, finish, machine_line, parser

import cv2
import numpy as np
from hull_baselines import BASELINES, VOLUME, Masks, PlainNumpy, scene

from capture_rig import InputError
from hull_server.carving import CarveBackend, make_backend
from hull_server.grid import VoxelGrid
from hull_server.settings import BlobSettings
from hull_server.slicing.skeletonisation import find_centerline, slice_hull
from hull_server.views import RigViews, min_seeing

OURS = {"ours, cpu": "cpu", "ours, OpenGL": "gl"}
BASE = "ours, cpu"
COST_OF_FINER = 3.0  # a method's time grows at most with the number of voxels


@dataclass
class Entry:
    """One method on one configuration: its times so far, seconds."""

    work: Callable[[Masks], int]
    close: Callable[[], None] = lambda: None
    times_s: list[float] = field(default_factory=list)

    @property
    def median_ms(self) -> float:
        return 1e3 * float(np.median(self.times_s))


def points_of(backend: CarveBackend, grid: VoxelGrid) -> Callable[[Masks], int]:
    """What is timed of ours: silhouettes to filtered centerline points."""

    def work(masks: Masks) -> int:
        volume = backend.carve(masks, min_seeing(len(masks)))
        return len(find_centerline(slice_hull(volume)[0], grid, BlobSettings()))

    return work


def entries(views: RigViews, grid: VoxelGrid, wanted: list[str]) -> Iterator[tuple[str, Entry]]:
    """The wanted methods that this machine offers; those that it does not are named on the way."""
    for name in wanted:
        try:
            if name in OURS:
                backend = make_backend(OURS[name], views, grid)[0]
                yield name, Entry(points_of(backend, grid), backend.close)
            else:
                yield name, Entry(BASELINES[name](views, grid))
        except (InputError, ImportError, AttributeError) as error:
            print(f"  without {name}: {error}")


def take_turns(methods: dict[str, Entry], frames: list[Masks], budget_s: float) -> None:
    """Run the methods in turns, frame by frame, each for about ``budget_s`` but at least twice, ours 200 times."""
    for entry in methods.values():
        entry.work(frames[0])
    for turn in range(200):
        for name, entry in methods.items():
            if len(methods) > 1 and name != BASE and len(entry.times_s) >= 2 and sum(entry.times_s) > budget_s:
                continue
            begin = time.perf_counter()
            entry.work(frames[turn % len(frames)])
            entry.times_s.append(time.perf_counter() - begin)


def measure(cameras: int, voxel_mm: int, wanted: list[str], poses: int, budget_s: float) -> dict[str, float]:
    """Median ms of each method on one configuration."""
    rig, frames = scene(cameras, poses)
    views, grid = RigViews.from_rig(rig), VoxelGrid.covering(VOLUME, voxel_mm / 1e3)
    methods = dict(entries(views, grid, wanted))
    take_turns(methods, frames, budget_s)
    for entry in methods.values():
        entry.close()
    return {name: entry.median_ms for name, entry in methods.items()}


def table(configurations: list[tuple[int, int]], poses: int, budget_s: float, limit_s: float) -> dict:
    """Print the table; return {(cameras, voxel_mm): {method: median ms}}."""
    names, found = [*OURS, *BASELINES], {}
    shown = Table({"cameras": ">7d", "voxel mm": ">8d", **dict.fromkeys(names, ">24")})
    last: dict[int, tuple[int, dict[str, float]]] = {}
    for cameras, voxel_mm in configurations:
        coarser_mm, coarser = last.get(cameras, (voxel_mm, {}))
        growth = (coarser_mm / voxel_mm) ** COST_OF_FINER
        wanted = [n for n in names if n in OURS or coarser.get(n, 0.0 if not coarser else 1e9) * growth < 1e3 * limit_s]
        row = found[cameras, voxel_mm] = measure(cameras, voxel_mm, wanted, poses, budget_s)
        cells = [f"{row[n]:.2f} {row[n] / row[BASE]:9.1f} x" if n in row else None for n in names]
        shown.row(cameras, voxel_mm, *cells)
        last[cameras] = voxel_mm, row
    return found


def disagreement(poses: int) -> float:
    """The worst backend's share of wrong voxels against float64, 5 cameras, 20 mm; each is printed."""
    rig, frames = scene(5, poses)
    views, grid = RigViews.from_rig(rig), VoxelGrid.covering(VOLUME, 0.02)
    reference, wrong = PlainNumpy(views, grid), dict.fromkeys(("cpu", "gl", "sweep"), 0)
    occupied, backends = 0, {}
    for kind in wrong:
        try:
            backends[kind] = make_backend(kind, views, grid)[0]
        except InputError as error:
            print(f"  without {kind}: {error}")
    for masks in frames:
        expected = reference.carve(masks)
        occupied += int(expected.sum())
        for kind, backend in backends.items():
            wrong[kind] += int((backend.carve(masks, min_seeing(5)).to_dense() != expected).sum())
    for kind in backends:
        print(f"{kind} differs from float64 in {wrong[kind]} of {occupied} occupied voxels")
    return max(wrong.values()) / occupied


def exponent(found: dict) -> float:
    """How time of ours on the CPU grows with 1 / voxel size, 5 cameras, 20 mm and finer; the number of voxels has 3."""
    sizes_mm = [mm for cameras, mm in found if cameras == 5 and mm <= 20]
    ms = [found[5, mm][BASE] for mm in sizes_mm]
    return round(-float(np.polyfit(np.log(sizes_mm), np.log(ms), 1)[0]), 2)


def opened(kind: str) -> CarveBackend:
    """A backend, opened and closed again. Raises InputError where this machine has none of the kind."""
    backend = make_backend(kind, RigViews.from_rig(scene(5, 2)[0]), VoxelGrid.covering(VOLUME, 0.1))[0]
    backend.close()
    return backend


def device() -> str:
    """The OpenGL device, for people."""
    try:
        return str(opened("gl").device)
    except InputError as error:
        return f"none ({error})"


def figures_of(found: dict, auto: str) -> dict[str, float | None]:
    """The figures of the last line that come from the table."""
    row = found[5, 20]
    names = "plain NumPy", "Open3D carve_silhouette", "the thesis's sweep"
    ratios = dict(zip(("numpy_ratio", "open3d_ratio", "sweep_ratio"), names, strict=True))
    figures: dict[str, float | None] = {
        key: round(row[name] / row[auto], 1) if name in row else None for key, name in ratios.items()
    }
    gl_ms = found[5, 10].get("ours, OpenGL")
    figures["gl_10mm_5cam_ms"] = None if gl_ms is None else round(gl_ms, 3)
    for cameras, voxel_mm in ((8, 20), (5, 10)):
        alone_ms = measure(cameras, voxel_mm, [auto], 8, 1.0)[auto]
        print(f"{auto}, alone: {cameras} cameras, {voxel_mm} mm: {alone_ms:.2f} ms")
        figures[f"points_{voxel_mm}mm_{cameras}cam_ms"] = round(alone_ms, 3)
    return figures


def main() -> None:
    given = parser(__doc__, quick="three configurations and the exactness, nothing else")
    given.add_argument("--limit", type=float, default=20.0, help="seconds a frame that a method may take")
    arguments = given.parse_args()
    versions = ", ".join(f"{module.__name__} {module.__version__}" for module in (np, cv2))
    print(f"{machine_line()}; {versions}\nOpenGL: {device()}")
    if arguments.quick:
        found = table([(5, 20), (5, 10), (8, 20)], poses=4, budget_s=1.5, limit_s=2.0)
    else:
        sizes_mm = (40, 25, 20, 15, 10, 5)
        found = table([(n, mm) for n in (5, 8) for mm in sizes_mm], poses=8, budget_s=6.0, limit_s=arguments.limit)
    auto = "ours, OpenGL" if opened("auto").name == "gl" else BASE  # only on hardware
    figures = figures_of(found, auto) | {"voxel_disagreement": disagreement(2 if arguments.quick else 8)}
    if not arguments.quick:
        figures["exponent"] = exponent(found)
    finish(figures)


if __name__ == "__main__":
    execute(main)
