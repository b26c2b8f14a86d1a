"""Compiles into the cache every numerical kernel of a live capture by what its nodes do before their first frame.

Run by the set-up: without it the first start of each node would take half a minute. What else has kernels (calibration,
the thesis's method, exports) compiles them when it is first used.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import ekf_tracker.filter
import icp_tracker.tracker
from camera_client.silhouettes.warm_up import warm_up_silhouettes
from capture_rig.session import load_session
from hull_server.hull_pipeline import HullPipeline
from mocap_pipeline.configuration import Configuration
from sagoma_ros import mask_png
from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

from .evaluation.in_process import track_session

SETTINGS = Configuration.of({"hull_server.backend": "cpu"})
FPS, S = 10.0, 0.8


def main() -> int:
    """Compile the parts, which share no kernels, in as many processes as there are cores."""
    os.environ["NUMBA_OPT"] = "2"  # the kernels are no slower than with 3, and compile in four fifths of the time
    parts, cores = (compile_fit, compile_filter, compile_hull, compile_cameras), len(os.sched_getaffinity(0))
    # without the collector, which looks through all that the compiler holds, again and again: a fifth of the time
    with ProcessPoolExecutor(min(len(parts), cores), multiprocessing.get_context("spawn"), gc.disable) as pool:
        for part in [pool.submit(part) for part in parts]:
            part.result()
    track()
    return 0


def compile_fit() -> None:
    """Compile the fit, its search for other poses, and the refinement of the body."""
    icp_tracker.tracker.warm_up(SETTINGS.icp)


def compile_hull() -> None:
    """Compile carving, slicing and contour rays."""
    pipeline = HullPipeline(ring(4, True), SETTINGS.hull)
    pipeline.warm_up()
    pipeline.close()


def compile_filter() -> None:
    """Compile the filter."""
    ekf_tracker.filter.warm_up()


def compile_cameras() -> None:
    """Compile segmentation, PNG, and the cameras that the demo simulates."""
    for colour in (False, True):
        warm_up_silhouettes(colour)
    mask_png.warm_up()


def track() -> None:
    """Track somebody through a tiny session of simulated cameras: compiles what no stage alone runs."""
    with tempfile.TemporaryDirectory(prefix="sagoma_warm_up_") as folder:
        session = write_session(Path(folder) / "session", ring(4, True), Body.from_stature(1.75), "t_pose_only", FPS, S)
        track_session(load_session(session), SETTINGS)


if __name__ == "__main__":
    sys.exit(main())
