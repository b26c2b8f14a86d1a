"""Draws a track over footage and silhouettes: single frames as pictures, all frames as a video."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.session import Session, Truth
from capture_rig.video import Video
from stick_figure.skeleton import POINT_NAMES

from .track_evaluation import TRACKING, TrackEvaluation

# (start, end) reference points of each drawn line: spine, head, shoulders, hips, arms, legs
BONES = np.array(
    [(2, 0), (2, 1), (3, 4), (5, 6), (0, 5), (0, 6), (3, 7),
     (7, 11), (4, 8), (8, 12), (5, 9), (9, 13), (6, 10), (10, 14)]
)  # fmt: skip
LEFT, RIGHT = {3, 5, 7, 9, 11, 13}, {4, 6, 8, 10, 12, 14}
LEFT_BGR, RIGHT_BGR, MIDDLE_BGR, TRUTH_BGR = (255, 160, 40), (60, 90, 255), (60, 230, 60), (255, 255, 255)
JOINT_BGR = (40, 40, 40)
FAR_PX = 1e4  # beyond which nothing is drawn
MARGIN, SMALLEST_WINDOW_PX = 0.15, 60.0
SILHOUETTE_TINT_BGR = np.array([60.0, 190.0, 60.0])
GOOD_BGR, UNSURE_BGR, GREY_BGR = (110, 220, 110), (60, 190, 250), (170, 170, 170)
STILLS = 3
MAX_WIDTH_PX, MAX_HEIGHT_PX, BAR_PX = 1920, 1080, 40
CLOSE_UP_WIDTH_PX, CLOSE_UPS_A_ROW = 1800, 6
CODEC = "mp4v"  # which every OpenCV wheel can write


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


def read_frames(video: Path, wanted: Sequence[int]) -> Iterator[np.ndarray]:
    """Yield the wanted frames (ascending, 0-based) of a video, BGR."""
    with Video(video) as footage:
        position = 0
        for frame in wanted:
            position += footage.skip(frame - position) + 1
            image = footage.read()
            if image is None:
                raise EOFError(f"{video} has no frame {frame}")
            yield image


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
    for a, b in BONES.tolist():
        if drawable[[a, b]].all():
            ends, line = (_rounded(pixels[a]), _rounded(pixels[b])), max(1, thick // 3) if colour else thick
            cv2.line(image, *ends, colour or _side_colour(a, b), line, cv2.LINE_AA)
    for pixel in pixels[drawable] if colour is None else ():
        cv2.circle(image, _rounded(pixel), thick, JOINT_BGR, -1, cv2.LINE_AA)


def _rounded(pixel: np.ndarray) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))


def _side_colour(a: int, b: int) -> tuple[int, int, int]:
    left, right = {a, b} & LEFT, {a, b} & RIGHT
    return MIDDLE_BGR if bool(left) == bool(right) else LEFT_BGR if left else RIGHT_BGR


def tint(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the image, its silhouette (H, W) tinted green and its outline drawn, the rest darkened."""
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
    """Draw one camera's picture: footage, silhouette (in image pixels), skeleton in colour, truth in white."""
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
    """Return the truth's points (15, 3) of each frame; None where it has none."""
    if truth is None:
        return [None] * len(frames)
    row_of = {int(frame): row for row, frame in enumerate(truth.frames)}
    return [truth.points_world[row_of[f]] if f in row_of else None for f in frames]


def draw_stills(folder: Path, evaluated: TrackEvaluation) -> list[Path]:
    """Write overlay.png, frames from all over the track, and with a truth worst.png, the frame of largest mean error.

    A row a frame, a column a camera, cut out around the body.
    """
    folder.mkdir(parents=True, exist_ok=True)
    track = evaluated.track
    spread = track.frames[np.linspace(0, len(track) - 1, STILLS + 2).astype(int)[1:-1]] if len(track) else track.frames
    wanted = {"overlay.png": np.unique(spread)}
    if evaluated.scores is not None and evaluated.session.truth is not None:
        mean_mm = np.nan_to_num(evaluated.scores.errors_mm).mean(1)
        wanted["worst.png"] = evaluated.session.truth.frames[[np.argmax(mean_mm)]]
    paths = []
    for name, frames in wanted.items():
        if len(frames):
            paths.append(folder / name)
            cv2.imwrite(str(paths[-1]), np.vstack(list(_close_ups(evaluated, frames.tolist()))))
    return paths


def _close_ups(evaluated: TrackEvaluation, frames: list[int]) -> Iterator[np.ndarray]:
    """Yield one sheet a frame: its caption, and every camera's image cut out around the body."""
    for frame, cameras, images, points, truth in _pictures(evaluated, frames):
        shown = points if truth is None else np.vstack([points, truth])
        side = CLOSE_UP_WIDTH_PX // min(len(cameras), CLOSE_UPS_A_ROW)
        windows = [Window.around(camera, shown, side) for camera in cameras]
        cells = [
            overlay(camera, image, None, points, truth, window)
            for camera, image, window in zip(cameras, images, windows, strict=True)
        ]
        sheet = montage(cells, min(len(cells), CLOSE_UPS_A_ROW), MAX_WIDTH_PX)
        yield np.vstack([_bar(evaluated, frame, sheet.shape[1]), sheet])


def _pictures(evaluated: TrackEvaluation, frames: Sequence[int]) -> Iterator[tuple]:
    """Frame, cameras, their images, the track's points (15, 3) and the truth's, where it has them."""
    session, cameras = evaluated.session, evaluated.session.rig.cameras
    points, truth = evaluated.track.at(np.array(frames)).points_world, truth_at(session.truth, frames)
    footage = zip(*(read_frames(session.videos[camera.name], frames) for camera in cameras), strict=True)
    with suppress(EOFError):  # a container may promise a frame more than it holds
        for index, images in enumerate(footage):
            yield frames[index], cameras, images, points[index], truth[index]


def write_overlay(path: Path, evaluated: TrackEvaluation, progress: Callable[[int], None] = lambda frame: None) -> Path:
    """Write an mp4 of every frame, cameras side by side: truth white, left limbs blue, right limbs red; caption."""
    session = evaluated.session
    path.parent.mkdir(parents=True, exist_ok=True)
    writer: cv2.VideoWriter | None = None
    try:
        for frame, sheet in enumerate(sheets(evaluated)):
            progress(frame)
            if writer is None:
                size = sheet.shape[1], sheet.shape[0]
                writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*CODEC), session.fps, size)
                if not writer.isOpened():
                    remedy = "Install an OpenCV with FFmpeg, or name another folder."
                    raise InputError(f"a video with codec {CODEC} cannot be written", where=str(path), remedy=remedy)
            writer.write(sheet)
    finally:
        if writer is not None:
            writer.release()
    return path


def sheets(evaluated: TrackEvaluation) -> Iterator[np.ndarray]:
    """Yield the video's pictures, BGR, all of one even size."""
    rig = evaluated.session.rig.cameras
    columns, scale = _tiling([camera.width for camera in rig], [camera.height for camera in rig])
    windows = [Window.whole(camera, scale) for camera in rig]
    for frame, cameras, images, points, truth in _pictures(evaluated, range(evaluated.frames)):
        cells = [
            overlay(camera, image, None, points, truth, window)
            for camera, image, window in zip(cameras, images, windows, strict=True)
        ]
        sheet = montage(cells, columns, MAX_WIDTH_PX)
        yield _even(np.vstack([_bar(evaluated, frame, sheet.shape[1]), sheet]))


def caption(evaluated: TrackEvaluation, frame: int) -> str:
    """Frame, time, the tracker's state, and the errors."""
    row = np.flatnonzero(evaluated.track.frames == frame)
    state = str(evaluated.track.states[row[0]]) if len(row) else "no body"
    text = f"{evaluated.session.folder.name}   frame {frame}   {frame / evaluated.session.fps:.2f} s   {state}"
    errors = _errors_at(evaluated, frame)
    if errors is None or not np.isfinite(errors).any():
        return text
    worst = int(np.nanargmax(errors))
    name = POINT_NAMES[worst].replace("_", " ")
    return f"{text}   mean {np.nanmean(errors):.0f} mm   worst: {name} {errors[worst]:.0f} mm"


def _errors_at(evaluated: TrackEvaluation, frame: int) -> np.ndarray | None:
    if evaluated.scores is None or evaluated.session.truth is None:
        return None
    row = np.flatnonzero(evaluated.session.truth.frames == frame)
    return evaluated.scores.errors_mm[row[0]] if len(row) else None


def _bar(evaluated: TrackEvaluation, frame: int, width: int) -> np.ndarray:
    """Return the caption in the colour of the tracker's state, as wide as the pictures."""
    row = np.flatnonzero(evaluated.track.frames == frame)
    sure = len(row) and evaluated.track.states[row[0]] == TRACKING
    colour = GREY_BGR if not len(row) else GOOD_BGR if sure else UNSURE_BGR
    text, font = caption(evaluated, frame), cv2.FONT_HERSHEY_SIMPLEX
    needed = cv2.getTextSize(text, font, 0.8, 2)[0][0]
    scale = min(0.8, 0.8 * (width - 20) / needed)
    bar = np.zeros((BAR_PX, width, 3), np.uint8)
    return cv2.putText(bar, text, (10, 28), font, scale, colour, 1 if scale < 0.6 else 2, cv2.LINE_AA)


def _tiling(widths: Sequence[int], heights: Sequence[int]) -> tuple[int, float]:
    """Return the number of cameras a row, and the scale, that fill the video best."""
    count, width, height = len(widths), max(widths), max(heights)
    room = MAX_HEIGHT_PX - BAR_PX

    def scale(columns: int) -> float:
        return min(1.0, MAX_WIDTH_PX / (columns * width), room / (-(-count // columns) * height))

    columns = max(range(1, count + 1), key=scale)
    return columns, scale(columns)


def _even(picture: np.ndarray) -> np.ndarray:
    """Return the picture with even sides, which codecs need."""
    height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
    return np.ascontiguousarray(picture[:height, :width])
