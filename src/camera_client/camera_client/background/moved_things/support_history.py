"""Follows, block by block of a camera's image, for how long the other cameras have seen a body there, or nobody."""

from __future__ import annotations

from collections import deque

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.stamps import NS
from mocap_packets.silhouette import BODY, NOBODY, OUTSIDE, UNJUDGED, ForegroundSupport

# Thresholds: APPLY_AFTER_S from the latency of the graph, NOISE_SIGMAS from the normal distribution; else chosen with
# the rooms of test_camera_moved_things.py.
APPLY_AFTER_S = 0.5  # a report counts for frames so much later, when it is there, live and in lockstep
SILENT_S = 2.0  # without a report for so long, nothing is known of the others
LONGEST_STEP_S = 0.5  # a report stands for no more time than this: twice the reports' period

Seconds = npt.NDArray[np.float32]
Blocks = npt.NDArray[np.bool_]


class SupportHistory:
    """Adds up what reports say, for frames from APPLY_AFTER_S after a report's stamp on.

    unseen_s, outside_s, body_s (blocks down, across) float32 : for how long the others have seen nobody in the volume,
    perhaps somebody outside it, a body; ``most_s`` at most, and counted down again. sees_body : by the newest report.
    """

    def __init__(self, camera: CameraModel, block_px: int, most_s: float) -> None:
        self._cells, self._most_s = CanvasCells(camera, block_px), most_s
        self.blocks = self._cells.blocks
        """Blocks down and across the image."""
        self._reports: deque[ForegroundSupport] = deque()
        self.restart()

    def restart(self) -> None:
        """Forget all times; reports that wait for their frames stay."""
        self.unseen_s, self.outside_s, self.body_s = (np.zeros(self.blocks, np.float32) for _ in range(3))
        self.sees_body: Blocks = np.zeros(self.blocks, bool)
        self._report_ns = 0

    def forget_reports(self) -> None:
        """Drop the reports that wait for their frames: stamps begin anew."""
        self._reports.clear()

    def add(self, report: ForegroundSupport) -> None:
        """Take a report, from any thread."""
        self._reports.append(report)

    def update(self, stamp_ns: int) -> None:
        """Apply the reports that count for frames of ``stamp_ns``."""
        due_ns = stamp_ns - round(APPLY_AFTER_S / NS)
        while self._reports and self._reports[0].stamp_ns <= due_ns:
            report = self._reports.popleft()
            step_s = min(max((report.stamp_ns - self._report_ns) * NS, 0.0), LONGEST_STEP_S)
            self._report_ns = report.stamp_ns
            levels = self._cells.levels(report)
            self.unseen_s = counted(self.unseen_s, (levels == NOBODY) | (levels == OUTSIDE), step_s, self._most_s)
            self.outside_s = counted(self.outside_s, levels == OUTSIDE, step_s, self._most_s)
            self.body_s = counted(self.body_s, levels == BODY, step_s, self._most_s)
            self.sees_body = levels == BODY
        if due_ns - self._report_ns > SILENT_S / NS:
            for seconds in (self.unseen_s, self.outside_s, self.body_s):
                seconds[:] = 0.0
            self.sees_body = np.zeros(self.blocks, bool)


def counted(seconds: Seconds, holds: Blocks, step_s: float, most_s: float) -> Seconds:
    """Count the seconds for which something holds up, to ``most_s``, and the others down, to 0."""
    step = np.where(holds, np.float32(step_s), np.float32(-step_s))
    return np.clip(seconds + step, 0.0, most_s).astype(np.float32)


class CanvasCells:
    """Where the image's blocks lie on the undistorted canvas, of which the reports speak."""

    def __init__(self, camera: CameraModel, block_px: int) -> None:
        self.blocks = (-(-camera.height // block_px), -(-camera.width // block_px))
        canvas = camera.undistorted_view().camera
        rows, columns = np.indices(self.blocks).reshape(2, -1) * block_px + (block_px - 1) / 2
        points = camera.ideal_points(np.stack([columns, rows], axis=1)) * canvas.K.diagonal()[:2] + canvas.K[:2, 2]
        inside = np.all((points >= -0.5) & (points < [canvas.width - 0.5, canvas.height - 0.5]), axis=1)
        self._inside = inside.reshape(self.blocks)  # False beyond the lens's reach, too
        self._pixels = np.rint(np.where(inside[:, None], points, 0.0)).astype(np.intp).reshape(*self.blocks, 2)

    def levels(self, report: ForegroundSupport) -> npt.NDArray[np.uint8]:
        """Return the report's level of each block of the image; UNJUDGED where the canvas does not show it."""
        cells = self._pixels // report.cell_px
        last = np.array(report.cells.shape[::-1]) - 1
        columns, rows = np.moveaxis(np.minimum(cells, last), 2, 0)
        return np.where(self._inside, report.cells[rows, columns], np.uint8(UNJUDGED))
