"""Writes ``truth.csv``: named reference points of the frames of a session."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np


def write_truth_file(path: Path, frames: np.ndarray, points_world: Mapping[str, np.ndarray]) -> None:
    """One row a frame: its 0-based number (F,), then x, y, z of every point (F, 3), metres, map frame.

    Cells of points that are not finite stay empty: unknown.
    """
    header = ["frame", *(f"{name}_{axis}" for name in points_world for axis in "xyz")]
    table = np.hstack(list(points_world.values()))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for frame, row in zip(frames, table, strict=True):
            writer.writerow([int(frame), *(f"{value:.6f}" if np.isfinite(value) else "" for value in row)])
