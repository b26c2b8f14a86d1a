"""What the demo shows of a live run: its scores and its pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from capture_rig.truth import Truth
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES

from .evaluation.pictures import plot_angles, plot_point_errors, session_overlay
from .evaluation.scores import Scores, score
from .evaluation.silhouettes import image_masks
from .live_run import LiveRun

OVERLAY_FRAMES = 3


def draw(run: LiveRun, output: Path, scores: Scores | None) -> list[Path]:
    """Write the overlay, the angles' and the errors' plots; returns their paths."""
    session, track = run.session, run.track
    frames = [int(f) for f in track.frames[np.linspace(0, len(track.frames) - 1, OVERLAY_FRAMES + 2).astype(int)[1:-1]]]
    masks = image_masks(run.bag, session.rig.cameras, frames, run.play.frame_of)
    paths = [output / name for name in ("overlay.png", "angles.png", "point_errors.png")]
    cv2.imwrite(str(paths[0]), session_overlay(session, frames, track.at(np.array(frames)).points_world, masks))
    truth = truth_seen(run)
    truth_seconds = None if truth is None or truth.angles is None else truth.frames / session.fps
    truth_angles = None if truth is None else truth.angles
    plot_angles(paths[1], ANGLE_NAMES, track.frames / session.fps, track.angles, truth_seconds, truth_angles)
    if scores is None or truth is None:
        return paths[:2]
    plot_point_errors(paths[2], POINT_NAMES, truth.frames / session.fps, scores.errors_mm)
    return paths


def judged(run: LiveRun) -> Scores | None:
    """The run's scores, None where the session has no truth."""
    truth = truth_seen(run)
    return None if truth is None else score(run.track, truth)


def truth_seen(run: LiveRun) -> Truth | None:
    """The truth of the frames that a camera looked at: all of footage, fewer where cameras were slower than it."""
    return None if run.session.truth is None else run.session.truth.of_frames(run.seen)
