"""Reads a board's four outer corners, which a person gives where detection fails, from a file.

The file, and a picture with a grid to read the corners off, can be written to be filled in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_rig.errors import InputError
from capture_rig.files import write_text
from capture_rig.yaml_file import read_mapping

FORMAT = (
    "Write NAME: [[x, y], [x, y], [x, y], [x, y]] for each camera, or NAME: {corners: [...], frame: 12}: the outermost "
    "inner corners of the print in pixels, in reading order (first row's two ends, then the last row's last and first)."
)
GRID_STEP_PX, GRID_PICTURE_PX = 50, 1600


@dataclass(frozen=True, eq=False)
class OuterCorners:
    """The outermost inner corners as a person gave them: (4, 2) px, in one frame or (None) in all of them."""

    pixels: np.ndarray
    frame: int | None = None


def read_corners(path: str | Path) -> dict[str, OuterCorners]:
    """Corners by camera, from a YAML file. Raises InputError naming file, camera, value and remedy."""
    document = read_mapping(Path(path), FORMAT)
    return {str(name): _corners(entry, f"{path}: {name}") for name, entry in document.items()}


def _corners(entry: Any, where: str) -> OuterCorners:
    frame = None
    if isinstance(entry, Mapping):
        unknown = set(entry) - {"corners", "frame"}
        if unknown or "corners" not in entry:
            raise InputError(f"has the keys {sorted(map(str, entry))}", where=where, remedy=FORMAT)
        entry, frame = entry["corners"], entry.get("frame")
    if frame is not None and (not isinstance(frame, int) or isinstance(frame, bool) or frame < 0):
        raise InputError(f"frame = {frame!r} is not the number of a frame", where=where, remedy="Count from 0.")
    try:
        pixels = np.array(entry, float)
    except (TypeError, ValueError):
        pixels = np.empty(0)
    if pixels.shape != (4, 2) or not np.isfinite(pixels).all():
        raise InputError(f"{entry!r} is not four [x, y] corners", where=where, remedy=FORMAT)
    return OuterCorners(pixels, frame)


def write_corner_help(folder: Path, name: str, image: np.ndarray) -> Path:
    """Write NAME_click.png, the picture enlarged under a grid of pixel coordinates; returns its path."""
    from matplotlib.figure import Figure

    height, width = image.shape[:2]
    figure = Figure(figsize=(GRID_PICTURE_PX / 100, GRID_PICTURE_PX / 100 * height / width), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(image if image.ndim == 2 else image[..., ::-1], cmap="gray", vmin=0, vmax=255)
    axes.set(xticks=range(0, width, GRID_STEP_PX), yticks=range(0, height, GRID_STEP_PX))
    axes.tick_params(labelsize=7, labelrotation=45)
    axes.grid(color="#ffff00", linewidth=0.5)
    path = folder / f"{name}_click.png"
    figure.savefig(path, dpi=100)
    return path


def write_template(path: Path, names: list[str]) -> None:
    """Write a corners file whose numbers a person replaces."""
    lines = [f"# {FORMAT}", "# Replace every number; delete the cameras that need none."]
    lines += [f"{name}: [[0, 0], [1, 0], [1, 1], [0, 1]]" for name in names]
    write_text(path, "\n".join(lines) + "\n")
