"""The track drawn over all cameras' footage: a few frames as pictures, all of them as a video."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from capture_rig.errors import InputError
from stick_figure.skeleton import POINT_NAMES

from .judgement import TRACKING, Judgement
from .pictures import Window, montage, overlay, read_frames, truth_at

STILLS = 3
MAX_WIDTH_PX, MAX_HEIGHT_PX, BAR_PX = 1920, 1080, 40
CLOSE_UP_WIDTH_PX, CLOSE_UPS_A_ROW = 1800, 6
CODEC = "mp4v"  # which every OpenCV wheel can write
GOOD_BGR, DOUBT_BGR, GREY_BGR = (110, 220, 110), (60, 190, 250), (170, 170, 170)


def draw_stills(folder: Path, judged: Judgement) -> list[Path]:
    """overlay.png: frames from all over the track; worst.png, with a truth: the frame with the largest mean error.

    A row a frame, a column a camera, cut out around the body.
    """
    folder.mkdir(parents=True, exist_ok=True)
    track = judged.track
    spread = track.frames[np.linspace(0, len(track) - 1, STILLS + 2).astype(int)[1:-1]] if len(track) else track.frames
    wanted = {"overlay.png": np.unique(spread)}
    if judged.scores is not None and judged.session.truth is not None:
        mean_mm = np.nan_to_num(judged.scores.errors_mm).mean(1)
        wanted["worst.png"] = judged.session.truth.frames[[np.argmax(mean_mm)]]
    paths = []
    for name, frames in wanted.items():
        if len(frames):
            paths.append(folder / name)
            cv2.imwrite(str(paths[-1]), np.vstack(list(_close_ups(judged, frames.tolist()))))
    return paths


def _close_ups(judged: Judgement, frames: list[int]) -> Iterator[np.ndarray]:
    """Each frame's caption and what the cameras see of the body."""
    for frame, cameras, images, points, truth in _pictures(judged, frames):
        shown = points if truth is None else np.vstack([points, truth])
        side = CLOSE_UP_WIDTH_PX // min(len(cameras), CLOSE_UPS_A_ROW)
        windows = [Window.around(camera, shown, side) for camera in cameras]
        cells = [
            overlay(camera, image, None, points, truth, window)
            for camera, image, window in zip(cameras, images, windows, strict=True)
        ]
        sheet = montage(cells, min(len(cells), CLOSE_UPS_A_ROW), MAX_WIDTH_PX)
        yield np.vstack([_bar(judged, frame, sheet.shape[1]), sheet])


def _pictures(judged: Judgement, frames: Sequence[int]) -> Iterator[tuple]:
    """Frame, cameras, their images, the track's points (15, 3) and the truth's, where it has them."""
    session, cameras = judged.session, judged.session.rig.cameras
    points, truth = judged.track.at(np.array(frames)).points_world, truth_at(session.truth, frames)
    footage = zip(*(read_frames(session.videos[camera.name], frames) for camera in cameras), strict=True)
    with suppress(EOFError):  # a container may promise a frame more than it holds
        for index, images in enumerate(footage):
            yield frames[index], cameras, images, points[index], truth[index]


def write_overlay(path: Path, judged: Judgement, progress: Callable[[int], None] = lambda frame: None) -> Path:
    """An mp4 of every frame, cameras side by side: truth white, left limbs blue, right limbs red; state and error."""
    session = judged.session
    path.parent.mkdir(parents=True, exist_ok=True)
    writer: cv2.VideoWriter | None = None
    try:
        for frame, sheet in enumerate(sheets(judged)):
            progress(frame)
            if writer is None:
                size = sheet.shape[1], sheet.shape[0]
                writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*CODEC), session.fps, size)
                if not writer.isOpened():
                    raise InputError(
                        f"a video with codec {CODEC} cannot be written",
                        where=str(path),
                        remedy="Install an OpenCV with FFmpeg, or name another folder.",
                    )
            writer.write(sheet)
    finally:
        if writer is not None:
            writer.release()
    return path


def sheets(judged: Judgement) -> Iterator[np.ndarray]:
    """The video's pictures, BGR, all of one even size."""
    rig = judged.session.rig.cameras
    columns, scale = _tiling([camera.width for camera in rig], [camera.height for camera in rig])
    windows = [Window.whole(camera, scale) for camera in rig]
    for frame, cameras, images, points, truth in _pictures(judged, range(judged.frames)):
        cells = [
            overlay(camera, image, None, points, truth, window)
            for camera, image, window in zip(cameras, images, windows, strict=True)
        ]
        sheet = montage(cells, columns, MAX_WIDTH_PX)
        yield _even(np.vstack([_bar(judged, frame, sheet.shape[1]), sheet]))


def caption(judged: Judgement, frame: int) -> str:
    """Frame, time, what the tracker says, and how far off it is."""
    row = np.flatnonzero(judged.track.frames == frame)
    state = str(judged.track.states[row[0]]) if len(row) else "no body"
    text = f"{judged.session.folder.name}   frame {frame}   {frame / judged.session.fps:.2f} s   {state}"
    errors = _errors_at(judged, frame)
    if errors is None or not np.isfinite(errors).any():
        return text
    worst = int(np.nanargmax(errors))
    name = POINT_NAMES[worst].replace("_", " ")
    return f"{text}   mean {np.nanmean(errors):.0f} mm   worst: {name} {errors[worst]:.0f} mm"


def _errors_at(judged: Judgement, frame: int) -> np.ndarray | None:
    if judged.scores is None or judged.session.truth is None:
        return None
    row = np.flatnonzero(judged.session.truth.frames == frame)
    return judged.scores.errors_mm[row[0]] if len(row) else None


def _bar(judged: Judgement, frame: int, width: int) -> np.ndarray:
    """The caption in the colour of the tracker's state, as wide as the pictures."""
    row = np.flatnonzero(judged.track.frames == frame)
    sure = len(row) and judged.track.states[row[0]] == TRACKING
    colour = GREY_BGR if not len(row) else GOOD_BGR if sure else DOUBT_BGR
    text, font = caption(judged, frame), cv2.FONT_HERSHEY_SIMPLEX
    needed = cv2.getTextSize(text, font, 0.8, 2)[0][0]
    scale = min(0.8, 0.8 * (width - 20) / needed)
    bar = np.zeros((BAR_PX, width, 3), np.uint8)
    return cv2.putText(bar, text, (10, 28), font, scale, colour, 1 if scale < 0.6 else 2, cv2.LINE_AA)


def _tiling(widths: Sequence[int], heights: Sequence[int]) -> tuple[int, float]:
    """How many cameras a row, and the scale, that fill the video best."""
    count, width, height = len(widths), max(widths), max(heights)
    room = MAX_HEIGHT_PX - BAR_PX

    def scale(columns: int) -> float:
        return min(1.0, MAX_WIDTH_PX / (columns * width), room / (-(-count // columns) * height))

    columns = max(range(1, count + 1), key=scale)
    return columns, scale(columns)


def _even(picture: np.ndarray) -> np.ndarray:
    """Codecs want even sides."""
    height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
    return np.ascontiguousarray(picture[:height, :width])
