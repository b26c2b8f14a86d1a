"""The motion as tables (CSV): all that a take knows of one person, a row a frame, units in the columns' names."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES

from .isb_angles import isb_angles
from .motion import NS_PER_S, Motion

DIGITS = 9
"""Significant ones: micrometres in a room."""
UPPER = tuple(zip(*np.triu_indices(3), strict=True))


def write_csv(motion: Motion, path: Path) -> None:
    """Write points (m) and covariances (m^2, six numbers each), torso, joint angles (rad), angles of the ISB (deg).

    World frame: x, y horizontal, z up. Cells of a gap are empty; ``state`` says how far to trust a row.
    """
    header = ["time_s", "stamp_ns", "state"]
    columns = []
    for p, name in enumerate(POINT_NAMES):
        header += [f"{name}_{axis}_m" for axis in "xyz"] + [f"{name}_cov_{'xyz'[i]}{'xyz'[j]}_m2" for i, j in UPPER]
        columns += [motion.points_world[:, p], np.stack([motion.covariance[:, p, i, j] for i, j in UPPER], axis=1)]
    header += [f"torso_frame_{axis}_m" for axis in "xyz"] + [f"torso_frame_q{axis}" for axis in "xyzw"]
    columns += [motion.torso_position_world, _quaternions(motion.R_world_torso)]
    header += [f"{name}_rad" for name in ANGLE_NAMES]
    columns.append(motion.angles)
    isb = isb_angles(motion)
    header += [f"isb_{name}_deg" for name in isb]
    columns.append(np.stack(list(isb.values()), axis=1))
    numbers = np.concatenate(columns, axis=1)
    stamps = motion.start_ns + np.rint(np.arange(len(motion)) * (NS_PER_S / motion.rate_hz)).astype(np.int64)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for time_s, stamp_ns, state, row in zip(motion.times_s, stamps, motion.states, numbers, strict=True):
            writer.writerow([f"{time_s:.6f}", stamp_ns, state, *map(_cell, row)])


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.{DIGITS}g}"


def _quaternions(R: np.ndarray) -> np.ndarray:
    """(F, 4) x, y, z, w with w >= 0; NaN in gaps."""
    known = np.isfinite(R).all(axis=(1, 2))
    out = np.full((len(R), 4), np.nan)
    out[known] = Rotation.from_matrix(R[known]).as_quat(canonical=True)
    return out
