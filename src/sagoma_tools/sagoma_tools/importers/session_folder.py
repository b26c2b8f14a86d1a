"""Writes session folders: the folder appears whole or not at all; truth.csv holds points."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import FLOOR_MARGIN_M, Volume

SIDE_MARGIN_M, TOP_MARGIN_M = 0.4, 0.3
"""From the outermost markers to the sides of the capture volume: body surface and hands lie beyond them."""


@contextmanager
def new_session_folder(folder: str | Path) -> Iterator[Path]:
    """An empty folder beside ``folder`` to write into; it becomes ``folder`` when the block ends without an error.

    Raises InputError when ``folder`` exists and is not empty.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        remedy = "Give the path of a new folder, or remove this one yourself."
        raise InputError("exists and is not an empty folder", where=str(folder), remedy=remedy)
    partial = folder.parent / f".{folder.name}.{os.getpid()}.partial"
    partial.mkdir(parents=True)
    try:
        yield partial
        if folder.exists():
            folder.rmdir()
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def volume_around(points_world: np.ndarray) -> Volume:
    """Return the capture volume around all markers (n, 3) of a recording, metres."""
    low, high = points_world.min(axis=0), points_world.max(axis=0)
    return Volume(
        np.array([*(low[:2] - SIDE_MARGIN_M), -FLOOR_MARGIN_M]),
        np.array([*(high[:2] + SIDE_MARGIN_M), high[2] + TOP_MARGIN_M]),
    )


def write_truth_file(path: Path, frames: np.ndarray, points_world: Mapping[str, np.ndarray]) -> None:
    """Write one row a frame: its 0-based number (F,), then x, y, z of every point (F, 3), metres, map frame.

    Cells of points that are not finite stay empty: unknown.
    """
    header = ["frame", *(f"{name}_{axis}" for name in points_world for axis in "xyz")]
    table = np.hstack(list(points_world.values()))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for frame, row in zip(frames, table, strict=True):
            writer.writerow([int(frame), *(f"{value:.6f}" if np.isfinite(value) else "" for value in row)])
