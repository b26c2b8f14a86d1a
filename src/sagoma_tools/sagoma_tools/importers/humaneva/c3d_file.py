"""``.c3d``: labelled points of a motion capture, read with the library py-c3d."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import c3d
import numpy as np

from capture_rig.errors import InputError

MM_PER = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


@dataclass(frozen=True, eq=False)
class Mocap:
    """Points (F, M, 3) of F mocap frames, mm, Vicon's world (z up); all zero where a point was not seen.

    ``column`` finds a label's point; a subject's name before a colon is not part of a label.
    """

    path: Path
    column: dict[str, int]
    points_mm: np.ndarray
    rate_hz: float

    def track_mm(self, *labels: str) -> np.ndarray:
        """(F, 3) of the first of ``labels`` that the file has; InputError when it has none of them."""
        for label in labels:
            if label in self.column:
                return self.points_mm[:, self.column[label]]
        raise InputError(
            f"has no point labelled {' or '.join(labels)}",
            where=str(self.path),
            remedy="Take the .c3d of the original release: it holds the markers and the body model's points.",
        )


def read_c3d(path: Path) -> Mocap:
    """All points of a ``.c3d`` file; InputError naming the file when it is missing, damaged or cut short."""
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on parameters that nothing here needs
            reader = c3d.Reader(file)
            labels = [str(label).split(":")[-1].strip() for label in reader.point_labels]
            unit = reader.get("POINT:UNITS")
            scale = MM_PER[unit.string_value.strip().lower() if unit is not None else "mm"]
            frames = [points[:, :3] for _, points, _ in reader.read_frames(copy=True)]
            expected, rate_hz = int(reader.frame_count), float(reader.point_rate)
    except OSError as error:
        remedy = "That of trial 2 is withheld by the owners: import its footage alone with --no-truth."
        raise InputError(f"cannot be read ({error.strerror})", where=str(path), remedy=remedy) from None
    except Exception as error:  # the library asserts and indexes its way through damaged files
        raise InputError(
            f"is not a readable .c3d file ({type(error).__name__}: {error})",
            where=str(path),
            remedy="Copy it again from the data set.",
        ) from None
    if not frames or len(frames) < expected:
        raise InputError(
            f"ends after {len(frames)} of {expected} frames", where=str(path), remedy="Copy it again from the data set."
        )
    column = {label: index for index, label in reversed(list(enumerate(labels)))}  # the first of equal labels counts
    return Mocap(path, column, scale * np.stack(frames).astype(float), rate_hz)
