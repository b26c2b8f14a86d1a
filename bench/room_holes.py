"""A person of whom cameras miss a third: denied as background, or uncertain. Part of bench/rooms.py --holes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

from report import Table

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
BAD_MM = 200.0


def holes() -> dict[str, Any]:
    """Print the table and return its figures: rows by cameras, cameras with a hole, and what the hole is taken for."""
    table, rows = Table("cameras:>7d | holes:>5d | as:<10 | tracked:>7.2f | mean mm:>7.1f | over 200:>8.3f"), []
    for _, session in shared_sessions([f"sessions/{SESSION}"]):
        frames = list(islice(exact_silhouettes(session), FRAMES))
        for cameras, count in ((c, h) for c in CAMERAS for h in HOLES):
            for kind in KINDS if count else ("denied",):
                row = {"cameras": cameras, "holes": count, "as": kind, **track(session, frames, cameras, count, kind)}
                table.row(*(row[key] for key in ("cameras", "holes", "as", "tracked", "mean_mm", "over_200mm")))
                rows.append(row)
    return {"rows": rows}


def track(session: Session, frames: list[dict[str, np.ndarray]], cameras: int, count: int, kind: str) -> dict[str, Any]:
    """Track with the rig's first cameras, of which ``count`` have a hole of a kind; shares and millimetres."""
    names, truth = session.rig.names[:cameras], session.truth
    assert truth is not None
    points = dict(zip(truth.frames.tolist(), truth.stick_figure_points(), strict=True))
    rig = replace(session.rig, cameras=tuple(session.rig.camera(name) for name in names))
    pipeline, errors, tracked = MocapPipeline(rig, Configuration.of({})), [], 0
    for frame, masks in enumerate(frames):
        seen = {n: with_hole(masks[n], KINDS[kind]) if k < count else masks[n] for k, n in enumerate(names)}
        step = pipeline.step_masks(footage_stamp_ns(EPOCH_NS, frame, session.fps), seen)
        if step.state is not None:
            tracked += 1
            errors += list(_errors_mm(step.fit.reference_points_world, points.get(frame)))
    found = np.array(errors or [np.nan])
    over = float((found > BAD_MM).mean()) if errors else float("nan")
    return {"tracked": tracked / len(frames), "mean_mm": float(found.mean()), "over_200mm": over}


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
