"""Compiles into the cache every numerical kernel of a live capture by what its nodes do before their first frame.

Run by the set-up: without it the first start of each node would take half a minute. What else has kernels (calibration,
the thesis's method, exports) compiles them when it is first used.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor

import ekf_tracker.filter
import icp_tracker.tracker
from camera_client.silhouettes.warm_up import warm_up_silhouettes
from hull_server.hull_pipeline import HullPipeline
from mocap_pipeline.configuration import Configuration
from sagoma_ros import mask_png
from virtual_studio.rig import ring

SETTINGS = Configuration.of({"hull_server.backend": "cpu"})


def main() -> int:
    """Compile the parts, which share no kernels, in as many processes as there are cores."""
    parts, cores = (compile_fit, compile_hull, compile_filter, compile_cameras), len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(
        min(len(parts), cores), multiprocessing.get_context("spawn"), gc.disable, max_tasks_per_child=1
    ) as pool:  # the collector looks through all that the compiler holds, again and again: a fifth of the time
        for part in [pool.submit(part) for part in parts]:
            part.result()
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
    """Compile segmentation and PNG."""
    warm_up_silhouettes(False)
    warm_up_silhouettes(True)
    mask_png.warm_up()


if __name__ == "__main__":
    sys.exit(main())
