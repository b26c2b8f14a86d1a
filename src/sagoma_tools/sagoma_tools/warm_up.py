"""Compiles every numerical kernel into the cache by running the whole pipeline once on a tiny synthetic session.

Run by the set-up: without it the first start of each node would take a minute.
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
from pathlib import Path

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.session import load_session
from ekf_tracker.filter import warm_up
from mocap_pipeline.configuration import Configuration
from rig_calibration.boards.board import Checkerboard, TargetDetection
from rig_calibration.boards.detector import find_board
from rig_calibration.boards.drawing import draw_board
from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from stick_figure.body import Body
from stick_figure.rotations import rotation_matrix
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

from .evaluation.in_process import track_session

FRAMES, FPS = 8, 10.0


def main() -> int:
    """Calibrate and filter in one process, capture in another: they share no kernels until the first has finished."""
    beside = multiprocessing.get_context("spawn").Process(target=calibrate_and_filter)
    beside.start()
    capture()
    beside.join()
    return beside.exitcode or 0


def calibrate_and_filter() -> None:
    """Compile the kernels of calibration and filter, which the capture does not need at once."""
    calibrate(ring(1, False).cameras[0])
    warm_up()


def calibrate(camera: CameraModel) -> None:
    """Detect a board, and calibrate a lens from five synthetic views."""
    board = Checkerboard(9, 6, (0.025, 0.025))
    find_board(draw_board(board, pixels_per_m=1500.0).image, board)
    corners = board.corners_board - board.corners_board.mean(axis=0)
    detections = []
    for frame_index, tilt in enumerate(([3.1, 0, 0], [2.7, 0.2, 0], [3.5, 0.3, 0], [3.1, 0.5, 0], [3.1, -0.5, 0.3])):
        in_camera = corners @ rotation_matrix(np.array(tilt, float)).T + [0.0, 0.0, 0.4]
        pixels = camera.project((in_camera - camera.t_camera_world) @ camera.R_camera_world)
        detections.append(
            TargetDetection(camera.name, frame_index, np.arange(54), pixels, (camera.width, camera.height))
        )
    calibrate_intrinsics(detections, board, name=camera.name)


def capture() -> None:
    """Track a person through a tiny session."""
    with tempfile.TemporaryDirectory(prefix="sagoma_warm_up_") as folder:
        path = write_session(
            Path(folder) / "session", ring(4, True), Body.from_stature(1.75), "t_pose_only", FPS, FRAMES / FPS
        )
        session = load_session(path)
        for method in ("hierarchical", "articulated"):
            # from the T-pose, so that a person is measured and the sizes refined as well
            track_session(session, Configuration.of({"hull_server.backend": "cpu", "icp_tracker.method": method}))


if __name__ == "__main__":
    sys.exit(main())
