"""The 15 reference points as markers, TRC (OpenSim, Visual3D) and C3D (the field's exchange format, c3d.org), and as
a table with all else (CSV)."""

from __future__ import annotations

import csv
import io
import warnings
from pathlib import Path

import numpy as np
from c3d import Writer
from scipy.spatial.transform import Rotation

from capture_rig.files import write_bytes, write_text
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES

from .isb_angles import isb_angles
from .motion import NS_PER_S, R_BIOMECHANICS_WORLD, Motion, in_frames, point_deviations

MM_PER_M = 1000
LABEL_LENGTH = 16
"""Characters of the longest label, "right_shoulder", and some: C3D labels have one length."""
NO_POINT = -1.0
"""The residual by which C3D marks a point as not there."""


def write_trc(motion: Motion, path: Path) -> None:
    """Write markers in millimetres, y up (OpenSim's axes); a gap is a row of empty cells."""
    points_mm = MM_PER_M * (motion.points_world @ R_BIOMECHANICS_WORLD.T)
    rate, frames = f"{motion.rate_hz:g}", len(motion)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{motion.name}.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frames}\t{len(POINT_NAMES)}\tmm\t{rate}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(POINT_NAMES) + "\t\t",
        "\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, len(POINT_NAMES) + 1)),
        "",
    ]
    for frame, (time_s, row) in enumerate(zip(motion.times_s, points_mm, strict=True), 1):
        cells = ("" if np.isnan(value) else f"{value:.4f}" for value in row.ravel())
        lines.append("\t".join([str(frame), f"{time_s:.6f}", *cells, ""]))  # a last tab, else a last empty cell is lost
    write_text(path, "\n".join(lines) + "\n")


def write_c3d(motion: Motion, path: Path) -> None:
    """Write points in millimetres, z up, as floats; the residual is the point's standard deviation (mm), -1 in a gap.

    The standard deviation is the root mean square of those along the covariance's three axes.
    """
    writer = Writer(point_rate=motion.rate_hz, analog_rate=0, point_scale=-1.0, point_units="mm  ", gen_scale=1.0)
    labels = [name.ljust(LABEL_LENGTH) for name in POINT_NAMES]
    writer.set_point_labels(labels)
    writer.set_screen_axis("+X", "+Z")
    rows = np.zeros((len(motion), len(POINT_NAMES), 5), np.float32)
    rows[..., :3] = MM_PER_M * np.nan_to_num(motion.points_world)
    sigma_mm = MM_PER_M * point_deviations(motion.covariance)
    rows[..., 3] = np.where(np.isnan(sigma_mm), NO_POINT, sigma_mm)
    nothing = np.empty((0, 0))
    writer.add_frames([(row, nothing) for row in rows])
    stream = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "No analog data", UserWarning)  # there is none to write
        writer.write(stream)
    write_bytes(path, stream.getvalue())


# --- Tables (CSV): all data of one person in a take, a row a frame, units in the columns' names.

DIGITS = 9
"""Significant ones: micrometres in a room."""
UPPER = tuple(zip(*np.triu_indices(3), strict=True))


def write_csv(motion: Motion, path: Path) -> None:
    """Write points (m) and covariances (m^2, six numbers each), torso, joint angles (rad), angles of the ISB (deg).

    World frame: x, y horizontal, z up. Cells of a gap are empty; ``state`` is the quality of a row.
    """
    header = ["time_s", "stamp_ns", "state"]
    columns = []
    for p, name in enumerate(POINT_NAMES):
        header += [f"{name}_{axis}_m" for axis in "xyz"] + [f"{name}_cov_{'xyz'[i]}{'xyz'[j]}_m2" for i, j in UPPER]
        columns += [motion.points_world[:, p], np.stack([motion.covariance[:, p, i, j] for i, j in UPPER], axis=1)]
    header += [f"torso_frame_{axis}_m" for axis in "xyz"] + [f"torso_frame_q{axis}" for axis in "xyzw"]
    turned = Rotation.from_matrix(motion.R_world_torso[motion.tracked]).as_quat(canonical=True)  # w >= 0
    columns += [motion.torso_position_world, in_frames(turned, motion.tracked)]
    header += [f"{name}_rad" for name in ANGLE_NAMES]
    columns.append(motion.angles)
    isb = isb_angles(motion)
    header += [f"isb_{name}_deg" for name in isb]
    columns.append(np.stack(list(isb.values()), axis=1))
    numbers = np.concatenate(columns, axis=1)
    stamps = motion.start_ns + np.rint(np.arange(len(motion)) * (NS_PER_S / motion.rate_hz)).astype(np.int64)
    file = io.StringIO()
    writer = csv.writer(file)
    writer.writerow(header)
    for time_s, stamp_ns, state, row in zip(motion.times_s, stamps, motion.states, numbers, strict=True):
        cells = ("" if np.isnan(value) else f"{value:.{DIGITS}g}" for value in row)
        writer.writerow([f"{time_s:.6f}", stamp_ns, state, *cells])
    write_text(path, file.getvalue())
