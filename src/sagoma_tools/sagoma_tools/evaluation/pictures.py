"""Pictures of a track: the skeleton over footage and silhouettes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.session import Session
from capture_rig.truth import Truth

# (start, end) reference points of each drawn line: spine, head, shoulders, hips, arms, legs
BONES = (
    (2, 0),
    (2, 1),
    (3, 4),
    (5, 6),
    (0, 5),
    (0, 6),
    (3, 7),
    (7, 11),
    (4, 8),
    (8, 12),
    (5, 9),
    (9, 13),
    (6, 10),
    (10, 14),
)
LEFT, RIGHT = {3, 5, 7, 9, 11, 13}, {4, 6, 8, 10, 12, 14}
LEFT_BGR, RIGHT_BGR, MIDDLE_BGR, TRUTH_BGR = (255, 160, 40), (60, 90, 255), (60, 230, 60), (255, 255, 255)
JOINT_BGR = (40, 40, 40)
FAR_PX = 1e4  # beyond which nothing is drawn
MARGIN, SMALLEST_WINDOW_PX = 0.15, 60.0
SILHOUETTE_TINT_BGR = np.array([60.0, 190.0, 60.0])


@dataclass(frozen=True)
class Window:
    """A picture (width, height) of a part of a camera's image: its pixel p lies at (p - origin_px) scale."""

    origin_px: tuple[float, float]
    scale: float
    size_px: tuple[int, int]

    @classmethod
    def whole(cls, camera: CameraModel, scale: float = 1.0) -> Window:
        """All of the image."""
        return cls((0.0, 0.0), scale, (round(camera.width * scale), round(camera.height * scale)))

    @classmethod
    def around(cls, camera: CameraModel, points_world: np.ndarray, side_px: int) -> Window:
        """A square around what the camera sees of the points (n, 3), with a margin; the whole image if it sees none."""
        pixels = camera.project(points_world)
        limit = np.array([camera.width, camera.height], float)
        seen = np.isfinite(pixels).all(1) & (pixels >= 0.0).all(1) & (pixels < limit).all(1)
        low, high = (pixels[seen].min(0), pixels[seen].max(0)) if seen.any() else (np.zeros(2), limit)
        side = max(float((high - low).max()) * (1.0 + 2.0 * MARGIN), SMALLEST_WINDOW_PX)
        x, y = (0.5 * (low + high) - 0.5 * side).tolist()
        return cls((x, y), side_px / side, (side_px, side_px))

    def cut(self, image: np.ndarray) -> np.ndarray:
        """The picture; black beyond the image."""
        (x, y), s = self.origin_px, self.scale
        if (x, y, s) == (0.0, 0.0, 1.0):
            return image
        return cv2.warpAffine(image, np.array([[s, 0.0, -s * x], [0.0, s, -s * y]]), self.size_px)


def read_frames(video: Path, wanted: Sequence[int]) -> Iterator[np.ndarray]:
    """The wanted frames (ascending, 0-based) of a video, BGR."""
    capture = cv2.VideoCapture(str(video))
    try:
        position = 0
        for frame in wanted:
            while position < frame and capture.grab():
                position += 1
            ok, image = capture.read()
            if not ok:
                raise EOFError(f"{video} has no frame {frame}")
            position += 1
            yield image
    finally:
        capture.release()


def draw_skeleton(
    image: np.ndarray,
    camera: CameraModel,
    points_world: np.ndarray,
    colour: tuple | None = None,
    window: Window | None = None,
) -> None:
    """Draw the 15 points (15, 3) into a (distorted) BGR image, or a window of it.

    Left limbs blue, right limbs red, joints dark; or thin lines of one ``colour``.
    """
    view = window or Window.whole(camera)
    pixels = (camera.project(points_world) - view.origin_px) * view.scale
    drawable = np.asarray(np.isfinite(pixels).all(axis=1) & (np.abs(np.nan_to_num(pixels)) < FAR_PX).all(axis=1))
    thick = max(2, round(image.shape[0] / 240))
    for a, b in BONES:
        if drawable[[a, b]].all():
            cv2.line(
                image,
                _rounded(pixels[a]),
                _rounded(pixels[b]),
                colour or _side_colour(a, b),
                max(1, thick // 3) if colour else thick,
                cv2.LINE_AA,
            )
    for pixel in pixels[drawable] if colour is None else ():
        cv2.circle(image, _rounded(pixel), thick, JOINT_BGR, -1, cv2.LINE_AA)


def _rounded(pixel: np.ndarray) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))


def _side_colour(a: int, b: int) -> tuple[int, int, int]:
    left, right = {a, b} & LEFT, {a, b} & RIGHT
    return MIDDLE_BGR if bool(left) == bool(right) else LEFT_BGR if left else RIGHT_BGR


def tint(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The image, its silhouette (H, W) tinted green and its outline drawn, the rest darkened."""
    inside = mask > 0
    out = image * np.float32(0.55)
    out[inside] = 0.6 * image[inside] + 0.4 * SILHOUETTE_TINT_BGR
    out = out.astype(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(out, contours, -1, (0, 255, 255), 1)


def overlay(
    camera: CameraModel,
    image: np.ndarray,
    mask: np.ndarray | None,
    points_world: np.ndarray,
    truth_world: np.ndarray | None,
    window: Window | None = None,
) -> np.ndarray:
    """One camera's picture: footage, silhouette (in the image's own pixels), skeleton in colour, truth in white."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    if mask is not None:
        picture = tint(picture, mask)
    if window is not None:
        picture = window.cut(picture)
    draw_skeleton(picture, camera, points_world, window=window)
    if truth_world is not None:
        draw_skeleton(picture, camera, truth_world, TRUTH_BGR, window)
    cv2.putText(picture, camera.name, (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 2, cv2.LINE_AA)
    return picture


def montage(pictures: Sequence[np.ndarray], columns: int, max_width: int = 1800) -> np.ndarray:
    """Pictures of possibly different sizes side by side, ``columns`` a row, scaled to one height."""
    height = max(picture.shape[0] for picture in pictures)
    width = max(picture.shape[1] for picture in pictures)
    cells = [
        cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, width - p.shape[1], cv2.BORDER_CONSTANT) for p in pictures
    ]
    cells += [np.zeros((height, width, 3), np.uint8)] * (-len(cells) % columns)
    sheet = np.vstack([np.hstack(cells[row : row + columns]) for row in range(0, len(cells), columns)])
    scale = min(1.0, max_width / sheet.shape[1])
    return cv2.resize(sheet, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def session_overlay(
    session: Session, frames: Sequence[int], points_world: np.ndarray, masks: dict[str, list[np.ndarray]] | None = None
) -> np.ndarray:
    """Rows of frames, columns of cameras: the track (len(frames), 15, 3) over the session's footage.

    masks : silhouettes of each camera at those frames, in image pixels.
    """
    truth = truth_at(session.truth, frames)
    rows: list[list[np.ndarray]] = [[] for _ in frames]
    for camera in session.rig.cameras:
        for index, image in enumerate(read_frames(session.videos[camera.name], frames)):
            mask = masks[camera.name][index] if masks else None
            rows[index].append(overlay(camera, image, mask, points_world[index], truth[index]))
    return montage([picture for row in rows for picture in row], columns=len(session.rig.cameras))


def truth_at(truth: Truth | None, frames: Sequence[int]) -> list[np.ndarray | None]:
    """The truth's points (15, 3) of each frame; None where it has none."""
    if truth is None:
        return [None] * len(frames)
    row_of = {int(frame): row for row, frame in enumerate(truth.frames)}
    return [truth.points_world[row_of[f]] if f in row_of else None for f in frames]
