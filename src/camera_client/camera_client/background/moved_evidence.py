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
from mocap_packets.silhouette import BODY, NOBODY, OUTSIDE, SUPPORT_PERIOD_S, UNJUDGED, ForegroundSupport

from ..frame_source import Image, Mask

# Thresholds: judgement: no measurement beside the built rooms of test_camera_moved_things.py, in which they hold.
WHOLE = 0.8  # share of a thing's blocks that must keep still: heads and hands move while a trunk does not; in the rest
# others may see something: rays of other things that cross
MAJORITY = 0.5  # of a thing that nobody else sees; of its outline that is visible, and has an edge in one of the two
# pictures; more of the picture is another room
APPLY_AFTER_S = 2 * SUPPORT_PERIOD_S  # a report counts for frames so much later, when it is there, live and in
# lockstep, and none stands for more time
SILENT_S = 4 * APPLY_AFTER_S  # without a report after which the others' views are unknown

Blocks = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float32]


class SupportHistory:
    """Adds up what reports say, for frames from APPLY_AFTER_S after a report's stamp on.

    unseen_s, outside_s, body_s (blocks down, across) float32 : for how long the others have seen nobody in the volume,
    perhaps somebody outside it, a body; ``most_s`` at most, and counted down again. sees_body : by the newest report.
    """

    def __init__(self, camera: CameraModel, block_px: int, most_s: float) -> None:
        self._most_s = most_s
        self.blocks = (-(-camera.height // block_px), -(-camera.width // block_px))
        """Blocks down and across the image."""
        canvas = camera.undistorted_view().camera
        rows, columns = np.indices(self.blocks).reshape(2, -1) * block_px + (block_px - 1) / 2
        points = camera.ideal_points(np.stack([columns, rows], axis=1)) * canvas.K.diagonal()[:2] + canvas.K[:2, 2]
        inside = np.all((points >= -0.5) & (points < [canvas.width - 0.5, canvas.height - 0.5]), axis=1)
        self._inside = inside.reshape(self.blocks)  # False beyond the lens's reach, too
        self._pixels = np.rint(np.where(inside[:, None], points, 0.0)).astype(np.intp).reshape(*self.blocks, 2)
        self._reports: deque[ForegroundSupport] = deque()
        self.restart()

    def restart(self) -> None:
        """Forget all times, and the reports that wait for their frames."""
        self._reports.clear()
        self.unseen_s, self.outside_s, self.body_s = (np.zeros(self.blocks, np.float32) for _ in range(3))
        self.sees_body: Blocks = np.zeros(self.blocks, bool)
        self._report_ns = 0

    def add(self, report: ForegroundSupport) -> None:
        """Take a report, from any thread."""
        self._reports.append(report)

    def levels(self, report: ForegroundSupport) -> npt.NDArray[np.uint8]:
        """Return the report's level, of the canvas, for each block; UNJUDGED where the canvas does not show it."""
        last = np.array(report.cells.shape[::-1]) - 1
        columns, rows = np.moveaxis(np.minimum(self._pixels // report.cell_px, last), 2, 0)
        return np.where(self._inside, report.cells[rows, columns], np.uint8(UNJUDGED))

    def update(self, stamp_ns: int) -> None:
        """Apply the reports that count for frames of ``stamp_ns``."""
        due_ns = stamp_ns - round(APPLY_AFTER_S / NS)
        while self._reports and self._reports[0].stamp_ns <= due_ns:
            report = self._reports.popleft()
            step_s = min(max((report.stamp_ns - self._report_ns) * NS, 0.0), APPLY_AFTER_S)
            self._report_ns = report.stamp_ns
            levels = self.levels(report)
            self.unseen_s = counted(self.unseen_s, (levels == NOBODY) | (levels == OUTSIDE), step_s, self._most_s)
            self.outside_s = counted(self.outside_s, levels == OUTSIDE, step_s, self._most_s)
            self.body_s = counted(self.body_s, levels == BODY, step_s, self._most_s)
            self.sees_body = levels == BODY
        if due_ns - self._report_ns > SILENT_S / NS:
            for seconds in (self.unseen_s, self.outside_s, self.body_s):
                seconds[:] = 0.0
            self.sees_body = np.zeros(self.blocks, bool)


def counted(seconds: Floats, holds: Blocks, step_s: float, most_s: float) -> Floats:
    """Count the seconds for which something holds up, to ``most_s``, and the others down, to 0."""
    step = np.where(holds, np.float32(step_s), np.float32(-step_s))
    return np.clip(seconds + step, 0.0, most_s).astype(np.float32)


# --- the outline of what was taken away

ACROSS_PX = 3.0  # from the outline to both sides: beyond blur, and within a person's arm
SMOOTH_PX = 5  # side of the box in which the outline is made smooth, as the silhouette's median filter does
FAINTER = 0.5  # an edge of the picture is gone when it has less than this share of the background's
MOST_KEPT = 0.15  # share of the outline at which the picture may have an edge all the same: textures, codecs
EDGE_SIGMAS = 2.0  # of a pixel: four of the difference of two means of 3 x 3 pixels
ROUGHER = 1.3  # inside, the picture has edges like around it, not more of them: nobody stands there

Pixels = npt.NDArray[np.intp]


def was_taken_away(blob: Mask, foreground: Mask, image: Image, background: Image, noise: float) -> bool:
    """Judge whether nothing stands where ``blob`` (h, w), 0 or 255, is: by its outline alone.

    foreground (h, w) : all of it, other things beside the blob included: they hide a part of its outline. image,
    background (h, w[, 3]) : the same part of the picture and of the background in today's light, some pixels larger
    than the blob. noise : grey levels, standard deviation of a pixel.
    """
    inside, outside, visible = _both_sides(blob, foreground)
    if visible < MAJORITY:
        return False
    now, learned = (_edge(picture, inside, outside) for picture in (image, background))
    least = EDGE_SIGMAS * noise
    says = np.maximum(now, learned) > least
    kept = now > np.maximum(FAINTER * learned, least)
    return bool(says.mean() >= MAJORITY and kept.mean() <= MOST_KEPT)


def is_calm_inside(blob: Mask, image: Image, noise: float) -> bool:
    """Judge whether the picture has no more edges inside ``blob`` than around it, as a bare wall or floor has.

    Somebody who stands within the outline of a cupboard that was taken away does not show on that outline.
    """
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    steepness = cv2.morphologyEx(cv2.blur(grey, (3, 3)), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    wide = np.ones((2 * int(ACROSS_PX) + 1,) * 2, np.uint8)
    inner = cv2.erode(blob, wide, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    around = (cv2.dilate(blob, np.ones((4 * int(ACROSS_PX) + 1,) * 2, np.uint8)) > 0) & (cv2.dilate(blob, wide) == 0)
    if not inner.any() or not around.any():
        return False
    limit = ROUGHER * np.percentile(steepness[around], 90) + EDGE_SIGMAS * noise
    return bool(np.percentile(steepness[inner], 98) <= limit)


def _both_sides(blob: Mask, foreground: Mask) -> tuple[Pixels, Pixels, float]:
    """Return pixels (n, 2) [row, column] inside and outside the outline, facing each other across it, and the share of
    the outline that they are: the rest lies at the border, or next to other foreground."""
    smooth, other = (_smooth(mask) for mask in (blob, foreground))
    outlines, _ = cv2.findContours(smooth, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return np.empty((0, 2), np.intp), np.empty((0, 2), np.intp), 0.0
    columns, rows = np.concatenate(outlines).reshape(-1, 2).T
    slope = cv2.GaussianBlur(smooth, (0, 0), ACROSS_PX).astype(np.float32)
    down, right = (cv2.Sobel(slope, cv2.CV_32F, dx, 1 - dx)[rows, columns] for dx in (0, 1))
    normal = np.stack([down, right], axis=1)  # into the blob
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
    points = np.stack([rows, columns], axis=1)
    inside, outside = (np.rint(points + side * ACROSS_PX * normal).astype(np.intp) for side in (1, -1))
    fits = np.all((outside >= 0) & (outside < blob.shape) & (inside >= 0) & (inside < blob.shape), axis=1)
    fits[fits] &= (smooth[tuple(inside[fits].T)] > 0) & (other[tuple(outside[fits].T)] == 0)
    return inside[fits], outside[fits], float(fits.mean())


def _smooth(mask: Mask) -> Mask:
    """Return a mask without noise, its cracks closed."""
    window = (SMOOTH_PX, SMOOTH_PX)
    solid = cv2.threshold(cv2.blur(mask, window), 127, 255, cv2.THRESH_BINARY)[1]
    return np.asarray(cv2.morphologyEx(solid, cv2.MORPH_CLOSE, np.ones(window, np.uint8)), np.uint8)


def _edge(picture: Image, inside: npt.NDArray[np.intp], outside: npt.NDArray[np.intp]) -> Floats:
    """Return by how many grey levels (n,) small means on both sides differ, in the channel that does most."""
    mean = cv2.blur(picture.astype(np.float32), (3, 3))
    difference = np.abs(mean[tuple(inside.T)] - mean[tuple(outside.T)])
    return difference if difference.ndim == 1 else difference.max(axis=1)
