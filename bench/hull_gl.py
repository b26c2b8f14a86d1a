"""Times the OpenGL carve stage by stage, and streams of frame sets with and without double buffering.

    python bench/hull_gl.py              # hardware where there is some, software otherwise

Stage times are medians (and the least) in ms with glFinish behind every stage, which costs a little by itself; the
lists are what each kernel leaves to the next. The streams are ms per frame set, carve and slice, all of them: one
after the other; double-buffered (frame set n + 1 is submitted before n is collected); and with a thread that carves
while this one slices.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

from report import execute, parser

import numpy as np
from hull_baselines import VOLUME, Masks, scene

from hull_server.grid import VoxelGrid
from hull_server.opengl.gl_buffers import GL
from hull_server.opengl.gl_carver import GlCarver
from hull_server.slicing.skeletonisation import slice_hull
from hull_server.views import RigViews, min_seeing


class StageTimes:
    """Milliseconds of each stage, by name, with the device idle at every lap."""

    def __init__(self) -> None:
        self._laps: dict[str, list[float]] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str | None) -> None:
        """The end of a stage; None: of something that does not count."""
        GL.glFinish()
        now = time.perf_counter()
        if stage is not None:
            self._laps.setdefault(stage, []).append(1e3 * (now - self._last))
        self._last = now

    def __str__(self) -> str:
        return "  ".join(f"{stage} {np.median(laps):.2f} ({min(laps):.2f})" for stage, laps in self._laps.items())


def time_stages(carver: GlCarver, frames: list[Masks], rounds: int) -> str:
    """One line of stage times and one of list lengths."""
    times, buffers = StageTimes(), carver._sets[0]
    with carver._context.current():
        for number, masks in enumerate(frames * (rounds + 1)):
            watch = times if number >= len(frames) else StageTimes()  # the first round warms up
            watch.lap(None)
            words = carver._upload.fill(masks, carver.views.present(masks), min_seeing(len(masks)))
            watch.lap("fill")
            buffers.frame.write(words)
            watch.lap("upload")
            for kernel in carver._carve_step_by_step(buffers):
                watch.lap(kernel)
            buffers.queue_read_back()
            buffers.arrived()
            watch.lap("read-back")
        lists = zip(buffers.list_lengths(), ("coarse", "bricks", "blocks", "recheck"), strict=True)
    left = ", ".join(f"{length} {name}" for length, name in lists)
    return f"{times}\n{'':>14}lists: {left}; {words.nbytes >> 10} KB up"


def one_after_the_other(carver: GlCarver, frames: list[Masks]) -> None:
    for masks in frames:
        slice_hull(carver.carve(masks, min_seeing(len(masks))))


def double_buffered(carver: GlCarver, frames: list[Masks]) -> None:
    before = carver.submit(frames[0], min_seeing(len(frames[0])))
    for masks in frames[1:]:
        ticket = carver.submit(masks, min_seeing(len(masks)))
        slice_hull(carver.collect(before))
        before = ticket
    slice_hull(carver.collect(before))


def with_a_thread(carver: GlCarver, frames: list[Masks]) -> None:
    volumes: queue.Queue = queue.Queue(2)

    def carve() -> None:
        for masks in frames:
            volumes.put(carver.carve(masks, min_seeing(len(masks))))

    thread = threading.Thread(target=carve)
    thread.start()
    for _ in frames:
        slice_hull(volumes.get())
    thread.join()


STREAMS: tuple[Callable[[GlCarver, list[Masks]], None], ...] = (one_after_the_other, double_buffered, with_a_thread)


def time_streams(carver: GlCarver, frames: list[Masks], rounds: int) -> str:
    """The three ways in turns: medians per frame set, and the least."""
    times: dict[str, list[float]] = {stream.__name__: [] for stream in STREAMS}
    for _ in range(rounds):
        for stream in STREAMS:
            begin = time.perf_counter()
            stream(carver, frames)
            times[stream.__name__].append(1e3 * (time.perf_counter() - begin) / len(frames))
    return "  ".join(f"{name} {np.median(ms):.2f} ({min(ms):.2f})" for name, ms in times.items())


def main() -> None:
    given = parser(__doc__)
    given.add_argument("--rounds", type=int, default=10)
    rounds = given.parse_args().rounds
    for cameras, voxel_mm in ((5, 20), (8, 20), (5, 10), (8, 10)):
        rig, frames = scene(cameras, 6)
        carver = GlCarver(RigViews.from_rig(rig), VoxelGrid.covering(VOLUME, voxel_mm / 1e3))
        if (cameras, voxel_mm) == (5, 20):
            print(carver.device)
        print(f"{cameras} cameras {voxel_mm} mm  {time_stages(carver, frames, rounds)}")
        print(f"{'':>14}streams: {time_streams(carver, frames * 2, rounds)}", flush=True)
        carver.close()


if __name__ == "__main__":
    execute(main)
