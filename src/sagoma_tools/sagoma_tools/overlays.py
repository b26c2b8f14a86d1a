"""People drawn over the pictures of cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from capture_rig.camera import CameraModel

# (start, end) reference points of each drawn line: spine, head, shoulders, hips, arms, legs
BONES = np.array(
    [(2, 0), (2, 1), (3, 4), (5, 6), (0, 5), (0, 6), (3, 7),
     (7, 11), (4, 8), (8, 12), (5, 9), (9, 13), (6, 10), (10, 14)]
)  # fmt: skip
LEFT_BGR, RIGHT_BGR, MIDDLE_BGR, TRUTH_BGR = (255, 160, 40), (60, 90, 255), (60, 230, 60), (255, 255, 255)
JOINT_BGR = (40, 40, 40)
COLOURS = (*[MIDDLE_BGR] * 4, LEFT_BGR, RIGHT_BGR, *[*[LEFT_BGR] * 2, *[RIGHT_BGR] * 2] * 2)  # of the lines
MARGIN, SMALLEST_WINDOW_PX = 0.15, 60.0


@dataclass(frozen=True)
class Window:
    """A picture (width, height) of a part of a camera's image: its pixel p lies at (p - origin_px) scale."""

    origin_px: tuple[float, float]
    scale: float
    size_px: tuple[int, int]

    @classmethod
    def whole(cls, camera: CameraModel, scale: float = 1.0) -> Window:
        """Return all of the image."""
        return cls((0.0, 0.0), scale, (round(camera.width * scale), round(camera.height * scale)))

    @classmethod
    def around(cls, camera: CameraModel, points_world: np.ndarray, side_px: int) -> Window:
        """Return a square around the visible points of (n, 3), with a margin; the whole image if none is visible."""
        pixels = camera.project(points_world)
        limit = np.array([camera.width, camera.height], float)
        seen = np.isfinite(pixels).all(1) & (pixels >= 0.0).all(1) & (pixels < limit).all(1)
        low, high = (pixels[seen].min(0), pixels[seen].max(0)) if seen.any() else (np.zeros(2), limit)
        side = max(float((high - low).max()) * (1.0 + 2.0 * MARGIN), SMALLEST_WINDOW_PX)
        x, y = (0.5 * (low + high) - 0.5 * side).tolist()
        return cls((x, y), side_px / side, (side_px, side_px))

    def cut(self, image: np.ndarray) -> np.ndarray:
        """Return the picture; black beyond the image."""
        (x, y), s = self.origin_px, self.scale
        if (x, y, s) == (0.0, 0.0, 1.0):
            return image
        return cv2.warpAffine(image, np.array([[s, 0.0, -s * x], [0.0, s, -s * y]]), self.size_px)


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
    drawable = np.asarray(np.isfinite(pixels).all(axis=1) & (np.abs(np.nan_to_num(pixels)) < 1e4).all(axis=1))
    thick = max(2, round(image.shape[0] / 240))
    width = max(1, thick // 3) if colour else thick
    for (a, b), own in zip(BONES.tolist(), COLOURS, strict=True):
        if drawable[[a, b]].all():
            cv2.line(image, _rounded(pixels[a]), _rounded(pixels[b]), colour or own, width, cv2.LINE_AA)
    for pixel in pixels[drawable] if colour is None else ():
        cv2.circle(image, _rounded(pixel), thick, JOINT_BGR, -1, cv2.LINE_AA)


def _rounded(pixel: np.ndarray) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))


def overlay(
    camera: CameraModel,
    image: np.ndarray,
    points_world: np.ndarray,
    truth_world: np.ndarray | None,
    window: Window | None = None,
) -> np.ndarray:
    """Draw one camera's picture: footage, skeleton in colour, truth in white."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    if window is not None:
        picture = window.cut(picture)
    draw_skeleton(picture, camera, points_world, window=window)
    if truth_world is not None:
        draw_skeleton(picture, camera, truth_world, TRUTH_BGR, window)
    return write_name(picture, camera.name)


def write_name(picture: np.ndarray, name: str, place: tuple[int, int] = (8, 22)) -> np.ndarray:
    """Write a camera's or a person's name into a picture, by default at its upper left; returns the picture."""
    font = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(picture, name, place, font, 0.6, (0, 0, 0), 4, cv2.LINE_AA)  # so that it can be read on white
    return cv2.putText(picture, name, place, font, 0.6, (255, 255, 255), 2, cv2.LINE_AA)


def montage(pictures: Sequence[np.ndarray], columns: int, max_width: int = 1800) -> np.ndarray:
    """Tile pictures, ``columns`` a row, each padded to the largest one's size."""
    height = max(picture.shape[0] for picture in pictures)
    width = max(picture.shape[1] for picture in pictures)
    cells = [
        cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, width - p.shape[1], cv2.BORDER_CONSTANT) for p in pictures
    ]
    cells += [np.zeros((height, width, 3), np.uint8)] * (-len(cells) % columns)
    sheet = np.vstack([np.hstack(cells[row : row + columns]) for row in range(0, len(cells), columns)])
    scale = min(1.0, max_width / sheet.shape[1])
    return cv2.resize(sheet, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


GOOD_BGR, UNSURE_BGR, GREY_BGR = (110, 220, 110), (60, 190, 250), (170, 170, 170)
MAX_WIDTH_PX, MAX_HEIGHT_PX, BAR_PX = 1920, 1080, 40


def captioned(sheet: np.ndarray, text: str, sure: bool | None) -> np.ndarray:
    """Return a sheet under a bar with a line of text, made smaller where it would not fit; sides are even, as codecs
    need it. sure : whether the drawn person is tracked, which colours the text; None without a person."""
    width, font = sheet.shape[1], cv2.FONT_HERSHEY_SIMPLEX
    colour = GREY_BGR if sure is None else GOOD_BGR if sure else UNSURE_BGR
    needed = cv2.getTextSize(text, font, 0.8, 2)[0][0]
    scale = min(0.8, 0.8 * (width - 20) / max(needed, 1))
    bar = np.zeros((BAR_PX, width, 3), np.uint8)
    thick = 1 if scale < 0.6 else 2  # strokes two pixels wide run together in small text
    cv2.putText(bar, text, (10, 28), font, scale, colour, thick, cv2.LINE_AA)
    picture = np.vstack([bar, sheet])
    return np.ascontiguousarray(picture[: picture.shape[0] // 2 * 2, : width // 2 * 2])


def tiling(widths: Sequence[int], heights: Sequence[int]) -> tuple[int, float]:
    """Return the number of cameras a row, and the scale, that fill the video best."""
    count, width, height = len(widths), max(widths), max(heights)
    room = MAX_HEIGHT_PX - BAR_PX

    def scale(columns: int) -> float:
        return min(1.0, MAX_WIDTH_PX / (columns * width), room / (-(-count // columns) * height))

    columns = max(range(1, count + 1), key=scale)
    return columns, scale(columns)
