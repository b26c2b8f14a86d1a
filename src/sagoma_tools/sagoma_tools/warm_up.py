"""Compiles into the cache every numerical kernel of a live capture, by the nodes' own warm-up.

Run by the set-up: without it the first start of each node would take half a minute. Other kernels (calibration, the
thesis's method, exports, simulated cameras) are compiled when they are first used.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mocap_pipeline.configuration import Configuration


def main() -> int:
    """Compile the parts in as many processes as there are cores, the longest first."""
    os.environ["NUMBA_OPT"] = "2"  # the kernels are no slower than with 3, and compile in four fifths of the time
    import_module("capture_rig.kernel")  # numba: once, for all processes
    parts = (compile_fit, compile_hull, compile_cameras, compile_filter)
    processes = min(len(parts), len(os.sched_getaffinity(0)))
    # without the collector, which would visit the compiler's objects again and again: a fifth of the time
    with ProcessPoolExecutor(processes, multiprocessing.get_context("fork"), gc.disable) as pool:
        for part in [pool.submit(part) for part in parts]:
            part.result()
    return 0


def settings() -> Configuration:
    from mocap_pipeline.configuration import Configuration

    return Configuration.of({"hull_server.backend": "cpu"})


def compile_fit() -> None:
    """Compile the fit, its search for other poses, and the refinement of the body."""
    from capture_rig.visibility import RigVisibility
    from icp_tracker.tracker import warm_up
    from virtual_studio.rig import ring

    warm_up(settings().icp, RigVisibility(ring(4, True)))


def compile_filter() -> None:
    """Compile the filter."""
    from capture_rig.rigid import quaternion_of
    from ekf_tracker.filter import warm_up

    warm_up()
    quaternion_of(np.eye(3))


def compile_hull() -> None:
    """Compile carving, slicing and contour rays."""
    from hull_server.hull_pipeline import HullPipeline
    from virtual_studio.rig import ring

    pipeline = HullPipeline(ring(4, True), settings().hull)
    pipeline.warm_up()
    pipeline.close()


def compile_cameras() -> None:
    """Compile segmentation of mono images, and PNG; the client of a colour camera compiles its own at its start."""
    from camera_client.frame_processor import warm_up_silhouettes
    from sagoma_ros import mask_png

    warm_up_silhouettes(colour=False)
    mask_png.warm_up()


if __name__ == "__main__":
    sys.exit(main())
