"""What the demo shows of a live run: its scores and its pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from .evaluation.judgement import Judgement, judge
from .evaluation.pictures import session_overlay
from .evaluation.silhouettes import image_masks
from .live_run import LiveRun

OVERLAY_FRAMES = 3


def draw(run: LiveRun, output: Path, judged: Judgement) -> list[Path]:
    """Write the overlay, the angles' and the errors' plots; returns their paths."""
    from .evaluation.plots import draw_plots  # matplotlib takes a second to load

    session, track = run.session, run.track
    frames = [int(f) for f in track.frames[np.linspace(0, len(track.frames) - 1, OVERLAY_FRAMES + 2).astype(int)[1:-1]]]
    masks = image_masks(run.bag, session.rig.cameras, frames, run.play.frame_of)
    overlay = output / "overlay.png"
    cv2.imwrite(str(overlay), session_overlay(session, frames, track.at(np.array(frames)).points_world, masks))
    return [overlay, *draw_plots(output, judged)]


def judged(run: LiveRun) -> Judgement:
    """The run's track against the truth of the frames that a camera looked at.

    That is all of footage, fewer where cameras were slower than it.
    """
    truth = None if run.session.truth is None else run.session.truth.of_frames(run.seen)
    return judge(replace(run.session, truth=truth), len(run.seen), run.track)
