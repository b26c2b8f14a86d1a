"""A session folder: one video and one background a camera, the rig, and optionally the truth.

Files: ``camNN.mp4``, ``camNN_background.mp4`` or ``.png``, ``rig.yaml``; optional ``camNN_mask.mp4`` (exact
silhouettes), ``truth.csv`` or ``reference*.csv``, of further persons ``truth_2.csv``, ``truth_3.csv``, ...;
``session.yaml`` (``fps``, ``units``, ``source``); ``stamps.csv`` of cameras that were not in step: seconds at which the
images of each frame were taken, a column a camera.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count, takewhile
from pathlib import Path

import numpy as np

from .errors import InputError
from .files import read_text
from .lens import Array
from .rig import Rig, load_rig
from .video import Video
from .yaml_file import read_mapping

# --- Reference data of a session: where the 15 reference points really were.
#
# The 15 points are those of the thesis (5.1): torso centre, head tip, neck, shoulders, hips, elbows, knees, hand tips,
# feet (ankles), left before right.

ANGLE_COUNT = 18
LEFT_HAND, RIGHT_HAND, LEFT_ELBOW, RIGHT_ELBOW = 11, 12, 7, 8

# Thresholds: from Drillis & Contini 1966.
# elbow to wrist over elbow to finger tip: forearm 0.146 and hand 0.108 of stature
# (Drillis & Contini 1966, as tabulated by Winter, Biomechanics and Motor Control of Human Movement)
WRIST_FRACTION = 0.146 / (0.146 + 0.108)

_RENDERED = "neck+l_hip+r_hip head_top neck l_shoulder r_shoulder l_hip r_hip l_elbow r_elbow l_knee r_knee l_hand_tip "
_RENDERED += "r_hand_tip l_ankle r_ankle"
_POSE_NETWORK = (
    "Neck+LHip+RHip Head Neck LShoulder RShoulder LHip RHip LElbow RElbow LKnee RKnee LWrist RWrist LAnkle RAnkle"
)
RENDERED, POSE_NETWORK = ([tuple(name.split("+")) for name in names.split()] for names in (_RENDERED, _POSE_NETWORK))
"""The columns that give each of the 15 points, in their order; the torso's centre lies between three."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Reference points of a session.

    frames : (F,) video frame of each row, 0-based.
    points_world : (F, 15, 3) metres, map frame, NaN where unknown, as the reference defines them.
    angles : (F, 18) radians in the stick figure's order, or None where the reference has none.
    wrist_fraction : where on the stick elbow -> hand tip the reference's hand points lie; 1 is the tip itself.
    """

    frames: np.ndarray
    points_world: Array
    angles: Array | None
    wrist_fraction: float
    source: Path

    def of_frames(self, frames: np.ndarray) -> Truth:
        """Return the rows of these video frames alone."""
        rows = np.isin(self.frames, frames)
        angles = None if self.angles is None else self.angles[rows]
        return replace(self, frames=self.frames[rows], points_world=self.points_world[rows], angles=angles)

    def points_at(self, frames: Sequence[int] | np.ndarray) -> Array:
        """(n, 15, 3) the points at these video frames, NaN where the reference has none."""
        row_of = {int(frame): row for row, frame in enumerate(self.frames)}
        rows = np.array([row_of.get(int(frame), -1) for frame in np.asarray(frames)], dtype=int)
        return np.append(self.points_world, np.full((1, 15, 3), np.nan), axis=0)[rows]

    def stick_figure_points(self) -> Array:
        """(F, 15, 3) the reference with hand tips: wrists are extended along the forearm where it ends there."""
        return _with_hands(self.points_world, 1 / self.wrist_fraction)

    def comparable(self, points_world: Array) -> Array:
        """The stick figure's points (..., 15, 3) as this reference defines them: hand tips moved to the wrists."""
        return _with_hands(points_world, self.wrist_fraction)


def _with_hands(points_world: Array, share: float) -> Array:
    """Return points (..., 15, 3) whose hand points lie at this share of the way from the elbow to where they lay."""
    points = np.array(points_world, float)
    for hand, elbow in ((LEFT_HAND, LEFT_ELBOW), (RIGHT_HAND, RIGHT_ELBOW)):
        forearm = points[..., hand, :] - points[..., elbow, :]
        points[..., hand, :] = points[..., elbow, :] + share * forearm
    return points


def load_truth(path: str | Path) -> Truth:
    """Read ``truth.csv`` (rendered sessions) or ``reference*.csv`` (points of a 2D pose network), in metres."""
    path = Path(path)
    header, rows = read_table(path)
    table, wrist_fraction = (RENDERED, 1.0) if "head_top_x" in header else (POSE_NETWORK, WRIST_FRACTION)
    column = {name: index for index, name in enumerate(header)}
    points = np.stack([_point(rows, column, parts, path) for parts in table], axis=1)
    angle_names = [name for name in header if name.endswith("_rad") and not name.startswith("torso_")]
    angles = rows[:, [column[name] for name in angle_names]] if len(angle_names) == ANGLE_COUNT else None
    return Truth(rows[:, 0].astype(int), points, angles, wrist_fraction, path)


def read_table(path: Path) -> tuple[list[str], Array]:
    """Return the columns' names, the first of which is ``frame``, and the rows of a CSV, NaN where a cell is empty.

    Raises InputError for a file that is no such table.
    """
    remedy = "The first row names the columns, every other row holds numbers."
    try:
        header, *lines = [row for row in csv.reader(io.StringIO(read_text(path, remedy), newline="")) if row]
        rows = np.array([[float(cell) if cell else np.nan for cell in line] for line in lines])
    except (csv.Error, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"cannot be read as a table of numbers ({error})", where=str(path), remedy=remedy) from None
    if header[0] != "frame" or rows.ndim != 2 or rows.shape[1] != len(header):
        raise InputError(
            "is not a table whose first column is 'frame'",
            where=str(path),
            remedy="Every row needs one number per column.",
        )
    if not (np.array_equal(rows[:, 0], np.trunc(rows[:, 0])) and (np.abs(rows[:, 0]) < 2**53).all()):
        raise InputError(
            "column 'frame' holds something else than whole numbers",
            where=str(path),
            remedy="Give the 0-based video frame of each row.",
        )
    return header, rows


def write_table(path: Path, names: Sequence[str], frames: Iterable[int], values: Array, digits: int) -> None:
    """Write a row a frame, its number (F,), then the values (F, n) called ``names``; cells that are not finite are
    empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["frame", *names])
        for frame, row in zip(frames, values, strict=True):
            writer.writerow([int(frame), *(f"{value:.{digits}f}" if np.isfinite(value) else "" for value in row)])


def _point(rows: Array, column: dict[str, int], parts: tuple[str, ...], path: Path) -> Array:
    for name in (f"{part}_{axis}" for part in parts for axis in "xyz"):
        if name not in column:
            raise InputError(
                f"column '{name}' is missing", where=str(path), remedy="Give x, y, z of every reference point."
            )
    xyz = {name: rows[:, [column[f"{name}_{axis}"] for axis in "xyz"]] for name in parts}
    if len(parts) == 1:
        return xyz[parts[0]]
    neck, left_hip, right_hip = (xyz[name] for name in parts)  # the torso centre: half way from neck to mid-hips
    return (neck + (left_hip + right_hip) / 2) / 2


VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".mpg", ".webm")  # in either case
STAMPS = "stamps.csv"
STILL_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif")


@dataclass(frozen=True, eq=False)
class Session:
    """Footage of one capture: every rig camera has a video; backgrounds, exact masks and truth are optional.

    other_truths : of the second person in view, the third, ...
    stamps_s : (F, cameras in name order) when the images of each frame were taken; None: all at frame / fps.
    """

    folder: Path
    rig: Rig
    fps: float
    videos: dict[str, Path]
    backgrounds: dict[str, Path]
    masks: dict[str, Path]
    truth: Truth | None
    other_truths: tuple[Truth, ...] = ()
    stamps_s: Array | None = None

    def stamps_ns(self, epoch_ns: int, frame: int) -> dict[str, int]:
        """Return the capture stamps of a video frame by camera; those beyond the file's last go on at ``fps``."""
        if self.stamps_s is None:
            return dict.fromkeys(self.rig.names, footage_stamp_ns(epoch_ns, frame, self.fps))
        last = len(self.stamps_s) - 1
        beyond_s = max(frame - last, 0) / self.fps
        row = self.stamps_s[min(frame, last)] + beyond_s
        return {n: epoch_ns + round(s * 1e9) for n, s in zip(self.rig.names, row.tolist(), strict=True)}

    @property
    def truths(self) -> tuple[Truth, ...]:
        """The truths of all persons, the first person's first; empty without any."""
        return () if self.truth is None else (self.truth, *self.other_truths)


def load_session(folder: str | Path) -> Session:
    """Read a session folder; a missing or contradictory file is an InputError with its path and the remedy."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError("is not a folder", where=str(folder), remedy="Give a session folder (rig.yaml, camNN.mp4).")
    rig = load_rig(folder / "rig.yaml")
    found = {name: find_footage(folder, name, VIDEO_SUFFIXES) for name in rig.names}
    videos = {name: path for name, path in found.items() if path is not None}
    _check_cameras(folder, rig, videos)
    return Session(
        folder=folder,
        rig=rig,
        fps=_frame_rate(folder, videos),
        videos=videos,
        backgrounds=_present(folder, rig, "_background", VIDEO_SUFFIXES + STILL_SUFFIXES + (".npz",)),
        masks=_present(folder, rig, "_mask", VIDEO_SUFFIXES),
        truth=_truth(folder),
        other_truths=_other_truths(folder),
        stamps_s=_stamps(folder / STAMPS, rig),
    )


def footage_stamp_ns(epoch_ns: int, frame: int, fps: float) -> int:
    """Capture stamp of video frame ``frame``: every camera of a session computes the same number."""
    return epoch_ns + round(frame * 1e9 / fps)


def find_footage(folder: Path, stem: str, suffixes: tuple[str, ...]) -> Path | None:
    """Return the file called ``stem`` with the first of the suffixes, in lower or upper case; None without one."""
    named = (folder / (stem + cased) for suffix in suffixes for cased in (suffix, suffix.upper()))
    return next((path for path in named if path.is_file()), None)


def _present(folder: Path, rig: Rig, tail: str, suffixes: tuple[str, ...]) -> dict[str, Path]:
    found = {name: find_footage(folder, name + tail, suffixes) for name in rig.names}
    return {name: path for name, path in found.items() if path is not None}


def _check_cameras(folder: Path, rig: Rig, videos: dict[str, Path]) -> None:
    missing = [name for name in rig.names if name not in videos]
    if missing:
        raise InputError(
            f"the rig has {len(rig.names)} cameras, but there is no video for {', '.join(missing)}",
            where=str(folder),
            remedy=f"Add {missing[0]}.mp4, or take the camera out of rig.yaml.",
        )
    stems = {path.stem for path in folder.iterdir() if path.suffix.lower() in VIDEO_SUFFIXES}
    strangers = sorted(s for s in stems - set(rig.names) if not s.endswith(("_background", "_mask")))
    strangers = [s for s in strangers if s.startswith("cam")]
    if strangers:
        raise InputError(
            f"there is a video for {', '.join(strangers)}, which rig.yaml does not list",
            where=str(folder),
            remedy=f"Calibrate {strangers[0]} and add it to rig.yaml, or move its video away.",
        )


def _frame_rate(folder: Path, videos: dict[str, Path]) -> float:
    stated = stated_rate(folder / "session.yaml")
    rates = {name: _video_rate(path, stated is None) for name, path in videos.items()}
    if stated is not None:
        return stated
    if max(rates.values()) - min(rates.values()) > 1e-3 * max(rates.values()):
        raise InputError(
            f"the videos have different frame rates: {rates}",
            where=str(folder),
            remedy="Give the true rate as 'fps' in session.yaml; sagoma evaluate then names those of a variable one.",
        )
    return next(iter(rates.values()))


def _video_rate(path: Path, needed: bool) -> float:
    """Return the rate in the header; InputError if it is not a camera's and ``needed``."""
    with Video(path) as video:
        if needed and not video.fps:
            raise InputError(
                f"has no frame rate that a camera has: its header says {video.header_fps:g} fps",
                where=str(path),
                remedy="Give the true rate as 'fps' in session.yaml.",
            )
        return video.fps


def stated_rate(path: Path) -> float | None:
    """Return the frame rate in a session.yaml, None if missing. Raises InputError for an invalid one."""
    if not path.is_file():
        return None
    fps = read_mapping(path, "It holds 'fps', 'units' and 'source', all optional.").get("fps")
    if fps is None:
        return None
    if not isinstance(fps, int | float) or isinstance(fps, bool) or not 0 < fps < 10_000:
        raise InputError(f"fps = {fps!r} is not a frame rate", where=str(path), remedy="Give frames per second.")
    return float(fps)


def _stamps(path: Path, rig: Rig) -> Array | None:
    """Read the stamps (F, cameras), s. Raises InputError for a camera without any, and times that do not rise."""
    if not path.is_file():
        return None
    header, rows = read_table(path)
    missing = [name for name in rig.names if name not in header]
    if missing:
        raise InputError(f"column '{missing[0]}' is missing", where=str(path), remedy="Give every camera's stamps.")
    stamps_s = rows[:, [header.index(name) for name in rig.names]]
    if not (np.isfinite(stamps_s).all() and (np.diff(stamps_s.min(axis=1)) > 0).all()):
        raise InputError("has stamps that do not rise", where=str(path), remedy="Give seconds, a row a frame.")
    return stamps_s


def _truth(folder: Path) -> Truth | None:
    candidates = [folder / "truth.csv", *sorted(folder.glob("reference*.csv"))]
    return next((load_truth(path) for path in candidates if path.is_file()), None)


def _other_truths(folder: Path) -> tuple[Truth, ...]:
    paths = (folder / f"truth_{number}.csv" for number in count(2))
    return tuple(load_truth(path) for path in takewhile(Path.is_file, paths))
