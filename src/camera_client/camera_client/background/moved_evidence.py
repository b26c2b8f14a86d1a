"""Evidence that foreground is a thing and no person: nobody else sees it, or only the background has its outline.

:class:`SupportHistory` follows, block by block of a camera's image, for how long the other cameras have seen a body
there, or nobody (`mocap_packets.silhouette`). :func:`was_taken_away` reads one camera's own pictures: foreground that
a thing left that was taken away has the thing's outline in the background's picture and none in the camera's, since
what was behind the thing continues across it. A person, or a thing put down, has it the other way round.
"""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.stamps import NS
from mocap_packets.silhouette import BODY, NOBODY, OUTSIDE, UNJUDGED, ForegroundSupport

from ..frame_source import Image, Mask
from .kernels import BEYOND_NOISE

# Thresholds: APPLY_AFTER_S from the latency of the graph; else chosen with the rooms of test_camera_moved_things.py.
WHOLE = 0.8  # share of a thing's blocks that must keep still, and of its outline that must be gone: heads and hands
# move while a trunk does not; in the rest others may see something: rays of other things that cross
MAJORITY = 0.5  # of a thing that nobody else sees, of its outline that tells anything; of the picture is another room
APPLY_AFTER_S = 0.5  # a report counts for frames so much later, when it is there, live and in lockstep: twice the
# reports' period, and no report stands for more time
SILENT_S = 4 * APPLY_AFTER_S  # without a report for so long, nothing is known of the others

Blocks = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float32]


class SupportHistory:
    """Adds up what reports say, for frames from APPLY_AFTER_S after a report's stamp on.

    unseen_s, outside_s, body_s (blocks down, across) float32 : for how long the others have seen nobody in the volume,
    perhaps somebody outside it, a body; ``most_s`` at most, and counted down again.
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
            step_s = min(max((report.stamp_ns - self._report_ns) * NS, 0.0), APPLY_AFTER_S)
            self._report_ns = report.stamp_ns
            levels = self._cells.levels(report)
            self.unseen_s = counted(self.unseen_s, (levels == NOBODY) | (levels == OUTSIDE), step_s, self._most_s)
            self.outside_s = counted(self.outside_s, levels == OUTSIDE, step_s, self._most_s)
            self.body_s = counted(self.body_s, levels == BODY, step_s, self._most_s)
        if due_ns - self._report_ns > SILENT_S / NS:
            for seconds in (self.unseen_s, self.outside_s, self.body_s):
                seconds[:] = 0.0


def counted(seconds: Floats, holds: Blocks, step_s: float, most_s: float) -> Floats:
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


# --- the outline of what was taken away

ACROSS_PX = 3  # from the outline to both sides: beyond blur, and within a person's arm
SMOOTH_PX = 5  # side of the box in which the outline is made smooth, as the silhouette's median filter does
FAINTER = 0.5  # an edge of the picture is gone when it has less than this share of the background's
EDGE_SIGMAS = BEYOND_NOISE * 2**0.5 / 3  # of a pixel: by which two means of 3 x 3 pixels differ beyond noise
ROUGHER = 1.3  # inside, the picture has edges like around it, not more of them: nobody stands there
_THREE = np.ones((3, 3), np.uint8)
_WIDE = np.ones((2 * ACROSS_PX + 1,) * 2, np.uint8)


def was_taken_away(blob: Mask, foreground: Mask, image: Image, background: Image, noise: float, nobody: bool) -> bool:
    """Judge whether nothing stands where ``blob`` (h, w), 0 or 255, is.

    foreground (h, w) : all of it, other things beside the blob included: they hide a part of its outline. image,
    background (h, w[, 3]) : the same part of the picture and of the background in today's light, some pixels larger
    than the blob. noise : grey levels, standard deviation of a pixel. nobody : the other cameras see nobody there;
    without, the picture has to be as plain inside as around, as a bare wall or floor is: somebody who stands within the
    outline of a cupboard that was taken away does not show on that outline.
    """
    solid = _smooth(blob)
    others = cv2.subtract(_smooth(foreground), cv2.dilate(solid, _THREE))
    hidden = cv2.dilate(np.pad(others, 1, constant_values=255), _WIDE)[1:-1, 1:-1]
    outline = cv2.subtract(solid, cv2.erode(solid, _THREE, borderType=cv2.BORDER_CONSTANT, borderValue=0)) > 0
    seen = outline & (hidden == 0)
    if not outline.any() or seen.sum() < MAJORITY * outline.sum():
        return False
    slope = cv2.GaussianBlur(solid, (0, 0), ACROSS_PX).astype(np.float32)
    normal = np.stack([cv2.Sobel(slope, cv2.CV_32F, dx, 1 - dx)[seen] for dx in (1, 0)], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
    now, learned = (_step_along(picture, seen, normal) for picture in (image, background))
    least = EDGE_SIGMAS * noise
    says, kept = np.maximum(now, learned) > least, now > np.maximum(FAINTER * learned, least)
    if says.mean() < MAJORITY or kept.mean() > 1 - WHOLE:
        return False
    inner, around = (cv2.erode(solid, _WIDE) > 0), (cv2.dilate(solid, _WIDE, iterations=2) > 0) & (hidden == 0)
    around &= cv2.dilate(solid, _WIDE) == 0
    if nobody or not inner.any() or not around.any():
        return nobody
    means = cv2.morphologyEx(cv2.blur(image, (3, 3)), cv2.MORPH_GRADIENT, _WIDE)
    roughness = means if means.ndim == 2 else means.max(axis=2)
    return bool(np.percentile(roughness[inner], 98) <= ROUGHER * np.percentile(roughness[around], 90) + least)


def _smooth(mask: Mask) -> Mask:
    """Return a mask without noise, its cracks closed."""
    window = (SMOOTH_PX, SMOOTH_PX)
    solid = cv2.threshold(cv2.blur(mask, window), 127, 255, cv2.THRESH_BINARY)[1]
    return np.asarray(cv2.morphologyEx(solid, cv2.MORPH_CLOSE, np.ones(window, np.uint8)), np.uint8)


def _step_along(picture: Image | Floats, places: Blocks, normal: Floats) -> Floats:
    """Return by how many grey levels (n,) small means differ along the normals (n, 2) [right, down] at the n places of
    a mask (h, w), from ACROSS_PX on one side to the other, in the channel that does most."""
    means, kernel = cv2.blur(picture.astype(np.float32), (3, 3)), np.zeros((1, 2 * ACROSS_PX + 1), np.float32)
    kernel[0, 0], kernel[0, -1] = -1, 1
    right, down = (
        cv2.filter2D(means, cv2.CV_32F, each)[places].reshape(len(normal), -1) for each in (kernel, kernel.T)
    )
    return np.asarray(np.abs(normal[:, :1] * right + normal[:, 1:] * down).max(axis=1), np.float32)
