"""Draws a track over its footage, frames as pictures and all as a video; plots angles and errors of points.

To be imported where it is used: matplotlib takes a second to load.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from capture_rig.video import Video, VideoFile
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES

from ..overlays import MAX_WIDTH_PX, Window, captioned, montage, overlay, tiling
from .scores import LARGE_ERROR_MM, Scores, angle_truth, defined
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


def draw(folder: Path, evaluated: TrackEvaluation) -> list[Path]:
    """Write plots, and stills where there is footage, into the folder; returns the paths."""
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
            cv2.imwrite(str(paths[-1]), np.vstack(list(sheets(evaluated, frames.tolist(), close_up=True))))
    return paths


def write_overlay(path: Path, evaluated: TrackEvaluation, progress: Callable[[int], None] = lambda frame: None) -> Path:
    """Write an mp4 of every frame, cameras side by side: truth white, left limbs blue, right limbs red; caption."""
    with VideoFile(path, evaluated.session.fps) as video:
        for frame, sheet in enumerate(sheets(evaluated, range(evaluated.frames))):
            progress(frame)
            video.write(sheet)
    return path


def sheets(evaluated: TrackEvaluation, frames: Sequence[int], close_up: bool = False) -> Iterator[np.ndarray]:
    """Yield each frame's picture, BGR: track and truth over all cameras' images, under the caption; whole images, all
    pictures of one even size, or cut out around the body."""
    session, cameras = evaluated.session, evaluated.session.rig.cameras
    columns, scale = tiling([camera.width for camera in cameras], [camera.height for camera in cameras])
    columns = min(len(cameras), CLOSE_UPS_A_ROW) if close_up else columns
    points = evaluated.track.at(np.array(frames)).points_world
    truth = None if session.truth is None else session.truth.points_at(frames)
    footage = zip(*(read_frames(session.videos[camera.name], frames) for camera in cameras), strict=True)
    with suppress(EOFError):  # a container may promise a frame more than it holds
        for index, images in enumerate(footage):
            drawn = points[index], None if truth is None else truth[index]
            shown = np.vstack([each for each in drawn if each is not None])
            cells = []
            for camera, image in zip(cameras, images, strict=True):
                near = Window.around(camera, shown, CLOSE_UP_WIDTH_PX // columns) if close_up else None
                cells.append(overlay(camera, image, *drawn, near or Window.whole(camera, scale)))
            yield captioned(montage(cells, columns, MAX_WIDTH_PX), *caption(evaluated, frames[index]))


def caption(evaluated: TrackEvaluation, frame: int) -> tuple[str, bool | None]:
    """Frame, time, the tracker's state, and the errors; and whether it tracks, None where there is no body."""
    row = np.flatnonzero(evaluated.track.frames == frame)
    state = str(evaluated.track.states[row[0]]) if len(row) else "no body"
    sure = state == TRACKING if len(row) else None
    text = f"{evaluated.session.folder.name}   frame {frame}   {frame / evaluated.session.fps:.2f} s   {state}"
    truth, scores = evaluated.session.truth, evaluated.scores
    if scores is None or truth is None or not np.isfinite(scores.errors_mm[truth.frames == frame]).any():
        return text, sure
    (errors,) = scores.errors_mm[truth.frames == frame]
    worst = int(np.nanargmax(errors))
    return f"{text}   mean {np.nanmean(errors):.0f} mm   worst: {TITLES[worst]} {errors[worst]:.0f} mm", sure


# plots ----------------------------------------------------------------------------------------------------------------


OURS, TRUTH, THESIS, UNSURE, LIMIT = "#1769aa", "0.55", "#d9772b", "#f2c744", "#b22222"
TITLES = [name.replace("_", " ") for name in POINT_NAMES]
POINT_ORDER = (0, 1, 2, 3, 7, 11, 4, 8, 12, 5, 9, 13, 6, 10, 14)
"""The points as plots list them, three a row: the trunk, then limb by limb from the body outwards."""


def draw_plots(folder: Path, evaluated: TrackEvaluation) -> list[Path]:
    """Write all plots into the folder; returns their paths. Without a truth, the angles alone."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {"angles": _angles(evaluated)}
    if evaluated.scores is not None:
        figures["point_errors"] = _point_errors(evaluated, evaluated.scores)
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=100)
    return [folder / f"{name}.png" for name in figures]


def _angles(evaluated: TrackEvaluation) -> Figure:
    """Angles over time against the truth (as thesis fig. 7.4 to 7.7)."""
    track, truth = evaluated.track, evaluated.session.truth
    frames = np.arange(evaluated.frames)  # NaN where there is nothing: no line bridges it
    curves = [("ours", OURS, 1.3, frames, track.at(frames).angles)]  # label, colour, width, frames, angles (F, 18) rad
    if truth is not None:
        curves.insert(0, ("truth", TRUTH, 3.5, truth.frames, angle_truth(truth).angles))
    figure = Figure(figsize=(12, 22), layout="constrained")
    for slot, axis in enumerate(np.ravel(figure.subplots(9, 2, sharex=True))):
        for label, colour, width, frames, angles in curves:
            seconds, degrees = frames / evaluated.session.fps, np.rad2deg(angles[:, slot])
            axis.plot(seconds, degrees, ":", color=colour, linewidth=0.4 * width + 0.5)
            sure = np.where(defined(angles)[:, slot], degrees, np.nan)
            axis.plot(seconds, sure, color=colour, linewidth=width, label=label)
        title = ANGLE_NAMES[slot].replace("_", " ")
        if evaluated.scores is not None:
            title += f": RMSE {np.rad2deg(evaluated.scores.angles.rmse_rad[slot]):.1f} deg"
        axis.set_title(title, fontsize=10)
    _finish(figure, evaluated, "angles", "angle [deg], dotted where the pose does not determine it")
    return figure


def _point_errors(evaluated: TrackEvaluation, scores: Scores) -> Figure:
    """Error of each point over time (as thesis fig. 7.9 to 7.13), ours over the thesis's method."""
    figure = Figure(figsize=(13, 12), layout="constrained")
    axes = figure.subplots(5, 3, sharex=True, sharey=True)
    assert evaluated.session.truth is not None
    seconds, track = evaluated.session.truth.frames / evaluated.session.fps, evaluated.track
    unsure = track.states != TRACKING
    for axis, point in zip(axes.flat, POINT_ORDER, strict=True):
        if evaluated.thesis is not None:
            errors, label = evaluated.thesis.errors_mm[:, point], "thesis's method"
            axis.plot(seconds, errors, color=THESIS, linewidth=0.8, alpha=0.7, label=label)
        axis.plot(seconds, scores.errors_mm[:, point], color=OURS, linewidth=1.3, label="ours")
        axis.axhline(LARGE_ERROR_MM, color=LIMIT, linewidth=0.8, linestyle="--", label="lost: 200 mm")
        if unsure.any():
            there, whole = axis.get_xaxis_transform(), (track.frames / evaluated.session.fps, 0, 1, unsure)
            axis.fill_between(*whole, step="mid", color=UNSURE, alpha=0.3, transform=there, label="not tracking")
        axis.set_title(f"{TITLES[point]}: mean {scores.points.mean_mm[point]:.0f} mm", fontsize=10)
    top = np.nanpercentile(scores.errors_mm, 99.5)
    axes.flat[0].set_ylim(0.0, max(220.0, 1.1 * top))
    _finish(figure, evaluated, "point errors", "error [mm]")
    return figure


def _finish(figure: Figure, evaluated: TrackEvaluation, what: str, unit: str) -> None:
    """Title, units, grid and one legend for all panels."""
    entries: dict[str, Artist] = {}
    for axis in figure.axes:
        axis.grid(alpha=0.3)
        entries |= {label: handle for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    mean = "" if evaluated.scores is None else f" (mean error {evaluated.scores.mean_mm:.1f} mm)"
    figure.suptitle(f"{evaluated.session.folder.name}: {what}{mean}", x=0.01, ha="left")
    figure.supxlabel("time [s]", fontsize=10)
    figure.supylabel(unit, fontsize=10)
    figure.legend(list(entries.values()), list(entries), loc="outside upper right", ncols=len(entries), fontsize=9)
