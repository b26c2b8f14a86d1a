"""A person of whom cameras miss a third, and things that stand in cameras' way. Part of bench/rooms.py --holes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

from report import Table

import cv2
import numpy as np
from scenes import shared_sessions

from capture_rig.mask_levels import BACKGROUND, UNCERTAIN
from capture_rig.session import Session, footage_stamp_ns
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline
from mocap_pipeline.session_footage import EPOCH_NS, exact_silhouettes

SESSION, FRAMES = "walk_ring5top", 160
CAMERAS, HOLES = (6, 4, 3), (0, 1, 2)
TRUNK = 0.2, 0.53  # shares of a silhouette's height from the top on: from the shoulders to the hips
KINDS = {"denied": BACKGROUND, "uncertain": UNCERTAIN}
KNEES, DESK_REACH, PILLAR_HALF = 0.72, 1.0, 0.12  # of a silhouette's height: how far down, and how wide things are
LEARN_S = 3.0  # things in the way are scored after that
BAD_MM = 200.0


def holes() -> dict[str, Any]:
    """Print the table and return its figures: rows by cameras, of how many something is missing, and what it is."""
    table, rows = Table("cameras:>7d | of these:>8d | miss:<10 | tracked:>7.2f | mean mm:>7.1f | over 200:>8.3f"), []
    for _, session in shared_sessions([f"sessions/{SESSION}"]):
        frames = list(islice(exact_silhouettes(session), FRAMES))
        for cameras, count in ((c, h) for c in CAMERAS for h in HOLES):
            for kind in (*KINDS, "desk", "pillar") if count else ("nothing",):
                row = {"cameras": cameras, "holes": count, "as": kind, **track(session, frames, cameras, count, kind)}
                table.row(*(row[key] for key in ("cameras", "holes", "as", "tracked", "mean_mm", "over_200mm")))
                rows.append(row)
    return {"rows": rows}


def track(session: Session, frames: list[dict[str, np.ndarray]], cameras: int, count: int, kind: str) -> dict[str, Any]:
    """Track with the rig's first cameras, of which ``count`` miss something; shares and millimetres."""
    names, truth = session.rig.names[:cameras], session.truth
    assert truth is not None
    points = dict(zip(truth.frames.tolist(), truth.stick_figure_points(), strict=True))
    rig = replace(session.rig, cameras=tuple(session.rig.camera(name) for name in names))
    hidden = {name: in_the_way(kind, [masks[name] for masks in frames]) for name in names[:count]}
    pipeline, errors, tracked = MocapPipeline(rig, Configuration.of({})), [], 0
    first = round(LEARN_S * session.fps) if kind in ("desk", "pillar") else 0
    clip = frames if first == 0 else [*frames, *frames[::-1]]  # there and back: time to learn
    for frame, masks in enumerate(clip):
        seen = {name: masks[name] for name in names}
        for name in hidden:
            if kind in KINDS:
                seen[name] = with_hole(masks[name], KINDS[kind])
            else:
                seen[name] = np.where(hidden[name], np.uint8(BACKGROUND), masks[name])
        step = pipeline.step_masks(footage_stamp_ns(EPOCH_NS, frame, session.fps), seen)
        if step.state is not None and frame >= first:
            tracked += 1
            of_truth = frame if frame < len(frames) else 2 * len(frames) - 1 - frame
            errors += list(_errors_mm(step.fit.reference_points_world, points.get(of_truth)))
    found = np.array(errors or [np.nan])
    over = float((found > BAD_MM).mean()) if errors else float("nan")
    return {"tracked": tracked / (len(clip) - first), "mean_mm": float(found.mean()), "over_200mm": over}


def in_the_way(kind: str, masks: list[np.ndarray]) -> np.ndarray:
    """Return the pixels (h, w) bool (bool) hidden where the person walks: by a desk up to the knees, or a pillar."""
    boxes = np.array([cv2.boundingRect(mask) for mask in masks if mask.any()])
    left, top, width, height = np.median(boxes, axis=0)
    hidden = np.zeros(masks[0].shape, bool)
    reach = (DESK_REACH if kind == "desk" else PILLAR_HALF) * height
    columns = slice(max(round(left + 0.5 * width - reach), 0), round(left + 0.5 * width + reach))
    hidden[round(top + KNEES * height) if kind == "desk" else 0 :, columns] = True
    return hidden


def with_hole(mask: np.ndarray, level: int) -> np.ndarray:
    """Return a silhouette (h, w) whose trunk is of another level."""
    rows, holed = np.flatnonzero(mask.any(axis=1)), mask.copy()
    if len(rows):
        top, height = rows[0], rows[-1] - rows[0]
        part = holed[int(top + TRUNK[0] * height) : int(top + TRUNK[1] * height)]
        part[part > 0] = level
    return holed


def _errors_mm(points_world: np.ndarray, truth_world: np.ndarray | None) -> Iterator[float]:
    if truth_world is not None:
        apart = 1e3 * np.linalg.norm(points_world - truth_world, axis=1)
        yield from apart[np.isfinite(apart)]
