"""Draws a track over its footage: single frames as pictures, all frames as a video."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from capture_rig.session import Truth
from capture_rig.video import Video
from stick_figure.skeleton import POINT_NAMES

from ..overlays import MAX_WIDTH_PX, VideoFile, Window, captioned, montage, overlay, tiling
from .track_evaluation import TRACKING, TrackEvaluation

STILLS = 3
CLOSE_UP_WIDTH_PX, CLOSE_UPS_A_ROW = 1800, 6


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


def truth_at(truth: Truth | None, frames: Sequence[int]) -> list[np.ndarray | None]:
    """Return the truth's points (15, 3) of each frame; None where it has none."""
    if truth is None:
        return [None] * len(frames)
    return [points if f in truth.frames else None for f, points in zip(frames, truth.points_at(frames), strict=True)]


def draw(folder: Path, evaluated: TrackEvaluation) -> list[Path]:
    """Write plots, and stills where there is footage, into the folder; returns the paths."""
    from .plots import draw_plots  # matplotlib takes a second to load

    paths = draw_plots(folder, evaluated)
    return [*paths, *draw_stills(folder, evaluated)] if evaluated.session.videos else paths


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
            overlay(camera, image, points, truth, window)
            for camera, image, window in zip(cameras, images, windows, strict=True)
        ]
        sheet = montage(cells, min(len(cells), CLOSE_UPS_A_ROW), MAX_WIDTH_PX)
        yield captioned(sheet, *caption(evaluated, frame))


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
    with VideoFile(path, evaluated.session.fps) as video:
        for frame, sheet in enumerate(sheets(evaluated)):
            progress(frame)
            video.write(sheet)
    return path


def sheets(evaluated: TrackEvaluation) -> Iterator[np.ndarray]:
    """Yield the video's pictures, BGR, all of one even size."""
    rig = evaluated.session.rig.cameras
    columns, scale = tiling([camera.width for camera in rig], [camera.height for camera in rig])
    windows = [Window.whole(camera, scale) for camera in rig]
    for frame, cameras, images, points, truth in _pictures(evaluated, range(evaluated.frames)):
        cells = [
            overlay(camera, image, points, truth, window)
            for camera, image, window in zip(cameras, images, windows, strict=True)
        ]
        sheet = montage(cells, columns, MAX_WIDTH_PX)
        yield captioned(sheet, *caption(evaluated, frame))


def caption(evaluated: TrackEvaluation, frame: int) -> tuple[str, bool | None]:
    """Frame, time, the tracker's state, and the errors; and whether it tracks, None where there is no body."""
    row = np.flatnonzero(evaluated.track.frames == frame)
    state = str(evaluated.track.states[row[0]]) if len(row) else "no body"
    sure = state == TRACKING if len(row) else None
    text = f"{evaluated.session.folder.name}   frame {frame}   {frame / evaluated.session.fps:.2f} s   {state}"
    errors = _errors_at(evaluated, frame)
    if errors is None or not np.isfinite(errors).any():
        return text, sure
    worst = int(np.nanargmax(errors))
    name = POINT_NAMES[worst].replace("_", " ")
    return f"{text}   mean {np.nanmean(errors):.0f} mm   worst: {name} {errors[worst]:.0f} mm", sure


def _errors_at(evaluated: TrackEvaluation, frame: int) -> np.ndarray | None:
    if evaluated.scores is None or evaluated.session.truth is None:
        return None
    row = np.flatnonzero(evaluated.session.truth.frames == frame)
    return evaluated.scores.errors_mm[row[0]] if len(row) else None
