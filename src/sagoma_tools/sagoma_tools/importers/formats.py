"""What importers share: session folders, motion captures (.c3d), and HumanEva's other formats and clock.

.cal : a camera's calibration in the terms of Bouguet's toolbox, whose model is OpenCV's plumb_bob. 22 numbers: focal
lengths (2), principal point (2), skew (1), k1 k2 p1 p2 k3 (5), rotation by rows (9), translation in mm (3), with
x_camera = R x_world + T; the world is Vicon's, z up.
.mp : a subject's measures as Vicon's software stores them, lines ``$Name = value`` in millimetres.
.ofs : three numbers a, b, s: mocap frame = b + (image frame - a) s, both counted from 1; s is near 2 (120 Hz against
60 Hz). Frames are counted from 1, as the data set's authors do (S2 Walking 1: 6 to 438 validation, 439 on training).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import c3d
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.files import read_text
from capture_rig.rig import FLOOR_MARGIN_M, Volume
from capture_rig.rigid import WRITTEN_TOLERANCE, nearest_rotation
from capture_rig.session import write_table
from capture_rig.yaml_file import save_mapping

from ..recording.writer import own_version

SIDE_MARGIN_M, TOP_MARGIN_M = 0.4, 0.3
"""From the outermost markers to the sides of the capture volume: body surface and hands lie beyond them."""


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
    names = [f"{name}_{axis}" for name in points_world for axis in "xyz"]
    write_table(path, names, frames, np.hstack(list(points_world.values())), 6)


def save_description(folder: Path, fps: float, source: str, kind: str, **more: Any) -> None:
    """Write session.yaml; ``kind`` of import, ``more`` : further keys of the kind."""
    made_by = f"sagoma import {kind}, {own_version()}"
    about = {"fps": float(fps), "units": "metres, pixels", "source": source, "made_by": made_by}
    save_mapping(folder / "session.yaml", {**about, **more})


COPY_AGAIN = "Copy it again from the data set."
CAL_NUMBERS = "fc(2) cc(2) alpha_c kc(5) R(9, row by row) T(3, mm)"
LINE = re.compile(r"^\s*\$\s*(\w+)\s*=\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*$", re.MULTILINE)
MM_PER = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
OFS_NUMBERS = "image frame, mocap frame, mocap frames per image frame"
FIRST_USABLE_FRAME = 6
"""The codec repeats the first image of every movie: its first five frames show nothing new."""


def read_numbers(path: Path, count: int, meaning: str) -> np.ndarray:
    """Return the first ``count`` numbers (count,) of a text file. Raises InputError naming the file."""
    remedy = f"It reads {meaning}: copy it again from the data set."
    words = read_text(path, remedy).split()
    try:
        numbers = np.array([float(word) for word in words[:count]])
    except ValueError as error:
        raise InputError(f"holds something else than numbers ({error})", where=str(path), remedy=remedy) from None
    if len(numbers) < count or not np.isfinite(numbers).all():
        found = f"{int(np.isfinite(numbers).sum())} finite numbers"
        raise InputError(f"holds {found} instead of {count}", where=str(path), remedy=remedy)
    return numbers


def read_cal(path: Path, name: str, width: int, height: int) -> CameraModel:
    """The camera that a ``.cal`` file describes, called ``name``, metres; its images are ``width`` x ``height`` px.

    Raises InputError naming the file for missing numbers, a skewed sensor, or a matrix that is no rotation.
    """
    numbers = read_numbers(path, 22, CAL_NUMBERS)
    focal, centre, skew, D = numbers[0:2], numbers[2:4], numbers[4], numbers[5:10]
    if (focal <= 0).any() or skew != 0:
        what = f"focal lengths {focal.tolist()} and skew {skew:g} are not those of a camera with square axes"
        raise InputError(what, where=str(path), remedy="Focal lengths must be positive pixels and the skew 0.")
    T_camera_world = pose_of(numbers[10:19].reshape(3, 3), numbers[19:22], path, f"It reads {CAL_NUMBERS}.")
    K = np.array([[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]])
    return CameraModel(name, width, height, K, "plumb_bob", D, T_camera_world)


def pose_of(R: np.ndarray, translation_mm: np.ndarray, path: Path, meaning: str) -> np.ndarray:
    """Return T_camera_world (4, 4), m, of a file's rotation, whose digits are rounded, and translation (3,).

    Raises InputError naming the file for a matrix that is no rotation.
    """
    error = max(np.abs(R @ R.T - np.eye(3)).max(), abs(np.linalg.det(R) - 1))
    if error > WRITTEN_TOLERANCE:
        what = f"its R is not a rotation: it departs from R R^T = I, det R = 1 by {error:.2g}"
        raise InputError(what, where=str(path), remedy=f"{meaning} {COPY_AGAIN}")
    T_camera_world = np.eye(4)
    T_camera_world[:3, :3], T_camera_world[:3, 3] = nearest_rotation(R), translation_mm / 1000.0
    return T_camera_world


def read_mp(path: Path, names: tuple[str, ...]) -> dict[str, float]:
    """Return the named measures of a ``.mp`` file, mm. Raises InputError naming the file and the missing line."""
    text = read_text(path, "It lies in Mocap_Data beside the .c3d files.")
    measures = {name: float(value) for name, value in LINE.findall(text)}
    missing = [name for name in names if name not in measures]
    if missing:
        raise InputError(f"has no line '${missing[0]} = number'", where=str(path), remedy=COPY_AGAIN)
    return {name: measures[name] for name in names}


@dataclass(frozen=True, eq=False)
class Mocap:
    """Points (F, M, 3) of F mocap frames, mm, Vicon's world (z up); NaN where a point was not seen.

    ``column`` finds a label's point; a subject's name before a colon is not part of a label.
    """

    path: Path
    column: dict[str, int]
    points_mm: np.ndarray
    rate_hz: float

    def track_mm(self, *labels: str) -> np.ndarray:
        """(F, 3) of the first of ``labels`` that the file has. Raises InputError when it has none of them."""
        for label in labels:
            if label in self.column:
                return self.points_mm[:, self.column[label]]
        remedy = "Take the .c3d of the original release: it holds the markers and the body model's points."
        raise InputError(f"has no point labelled {' or '.join(labels)}", where=str(self.path), remedy=remedy)


WITHHELD = "That of trial 2 is withheld by the owners: import its footage alone with --no-truth."


def read_c3d(path: Path, remedy: str = WITHHELD) -> Mocap:
    """Return all points of a ``.c3d`` file.

    Raises InputError naming a file that is damaged, cut short, or cannot be read (then with ``remedy``).
    """
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about parameters that are not read here
            reader = c3d.Reader(file)
            labels = [str(label).split(":")[-1].strip() for label in reader.point_labels]
            unit = reader.get("POINT:UNITS")
            scale = MM_PER[unit.string_value.strip().lower() if unit is not None else "mm"]
            frames = [points[:, :3] for _, points, _ in reader.read_frames(copy=True)]
            expected, rate_hz = int(reader.frame_count), float(reader.point_rate)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path), remedy=remedy) from None
    except Exception as error:  # the library asserts and indexes its way through damaged files
        what = f"is not a readable .c3d file ({type(error).__name__}: {error})"
        raise InputError(what, where=str(path), remedy=COPY_AGAIN) from None
    if not frames or len(frames) < expected:
        raise InputError(f"ends after {len(frames)} of {expected} frames", where=str(path), remedy=COPY_AGAIN)
    column = {label: index for index, label in reversed(list(enumerate(labels)))}  # the first of equal labels counts
    points_mm = scale * np.stack(frames).astype(float)
    points_mm[(points_mm == 0).all(axis=2)] = np.nan  # the files' mark of points that were not seen
    return Mocap(path, column, points_mm, rate_hz)


@dataclass(frozen=True, eq=False)
class Instants:
    """Fractional mocap frames: rows ``lower`` and ``upper`` (F,) of a file and the ``fraction`` (F,) between them.

    ``inside`` (F,) is False where the file does not reach; its rows are then clipped.
    """

    lower: np.ndarray
    upper: np.ndarray
    fraction: np.ndarray
    inside: np.ndarray

    @classmethod
    def of(cls, positions: np.ndarray, count: int) -> Instants:
        """Build from 1-based positions (F,) in a file of ``count`` mocap frames."""
        lower, upper = np.floor(positions).astype(int) - 1, np.ceil(positions).astype(int) - 1
        inside = (lower >= 0) & (upper < count)
        last = count - 1
        return cls(lower.clip(0, last), upper.clip(0, last), positions - np.floor(positions), inside)


def between(track_mm: np.ndarray, at: Instants) -> np.ndarray:
    """Return a track (T, 3) at instants (F,): (F, 3), on the straight line between its neighbours, NaN where one is."""
    fraction = at.fraction[:, None]
    return (1 - fraction) * track_mm[at.lower] + fraction * track_mm[at.upper]


class Offset(NamedTuple):
    """Image frame ``image`` was taken at mocap frame ``mocap``; both 1-based and fractional."""

    image: float
    mocap: float
    mocap_per_image: float


def read_ofs(path: Path) -> Offset:
    """Return the offset of one camera. Raises InputError naming the file."""
    offset = Offset(*read_numbers(path, 3, OFS_NUMBERS).tolist())
    if offset.mocap_per_image <= 0:
        remedy = "It must be positive, near 2: copy the file again from the data set."
        raise InputError(f"{offset.mocap_per_image:g} mocap frames per image frame", where=str(path), remedy=remedy)
    return offset


@dataclass(frozen=True)
class CommonTime:
    """Common frame k is image ``first_image[camera]`` + k - 1 and mocap frame ``first_mocap`` + (k - 1) times the rate.

    All counted from 1; images are whole, mocap frames fractional; ``mocap_per_frame`` is near 2.
    """

    first_image: Mapping[str, int]
    first_mocap: float
    mocap_per_frame: float

    def image(self, camera: str, frame: int) -> int:
        """Return the camera's image (1-based) of a common frame."""
        return self.first_image[camera] + frame - 1

    def mocap(self, frames: np.ndarray) -> np.ndarray:
        """Fractional mocap frames (F,), 1-based, of common frames (F,)."""
        return self.first_mocap + (np.asarray(frames, float) - 1) * self.mocap_per_frame


def common_time(offsets: Mapping[str, Offset]) -> CommonTime:
    """The clock that the authors' code derives from the offsets of all cameras, imported or not, colour before grey."""
    cameras = list(offsets.values())
    # every camera's image at one instant: mocap frame b of the first camera
    instant = cameras[0].mocap
    images = np.array([c.image + (instant - c.mocap) / c.mocap_per_image for c in cameras])
    mocap_per_frame = float(np.mean([c.mocap_per_image for c in cameras]))
    # common frame 1 is the first image of the camera that starts latest, ...
    first_mocap = instant - mocap_per_frame * (images.min() - 1)
    first_images = images - images.min() + 1
    # ... or the first mocap frame where the motion capture starts later still
    if first_mocap < 1:
        first_images = first_images + (1 - first_mocap) / mocap_per_frame
        first_mocap = 1.0
    rounded = np.floor(first_images + 0.5).astype(int).tolist()  # shutters are not in step: off by half a frame at most
    return CommonTime(dict(zip(offsets, rounded, strict=True)), float(first_mocap), mocap_per_frame)
