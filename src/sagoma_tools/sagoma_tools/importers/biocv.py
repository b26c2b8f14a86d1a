"""Imports a trial of the BioCV data set (Evans et al. 2024, University of Bath, doi:10.15125/BATH-01258) as a session.

By the data set's public note a participant's archive holds the calibration of each camera and a folder for each trial,
with nine videos and ``markers.c3d``. A calibration is a text of numbers: image width and height, K (3 x 3), L (4 x 4,
world to camera, mm), k0 to k4 in OpenCV's order. Markers are on the skin: a joint is the mean of those around it, by
the names of :data:`MARKERS` or of a file of the user's.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.files import replaced_folder
from capture_rig.rig import Rig, default_volume, save_rig
from capture_rig.rigid import WRITTEN_TOLERANCE
from capture_rig.session import VIDEO_SUFFIXES
from capture_rig.video import Video
from capture_rig.yaml_file import read_mapping

from .formats import (
    Instants,
    Mocap,
    between,
    pose_of,
    read_c3d,
    read_numbers,
    save_description,
    volume_around,
    write_truth_file,
)

NUMBERS = "width height K(3 x 3) L(4 x 4, mm) k0..k4"
COUNT = 2 + 9 + 16 + 5
RIGID = "L is the matrix from world to camera, millimetres, its last row 0 0 0 1."
MARKERS: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "Head": (("HEAD_TOP",), ("LFHD", "RFHD", "LBHD", "RBHD")),
    "Neck": (("NECK",), ("C7", "CLAV")),
} | {
    f"{side}{joint}": tuple(tuple(label.format(side) for label in names) for names in choices)
    for side in "LR"
    for joint, choices in {
        "Shoulder": (("{}SJC",), ("{}_SHOULDER",), ("{}SHO",)),
        "Elbow": (("{}EJC",), ("{}ELB", "{}ELBM"), ("{}_ELBOW_LAT", "{}_ELBOW_MED"), ("{}ELB",)),
        "Wrist": (("{}WJC",), ("{}WRA", "{}WRB"), ("{}_WRIST_LAT", "{}_WRIST_MED")),
        "Hip": (("{}HJC",), ("{}_HIP",), ("{}ASI", "{}PSI")),
        "Knee": (("{}KJC",), ("{}KNE", "{}KNEM"), ("{}_KNEE_LAT", "{}_KNEE_MED"), ("{}KNE",)),
        "Ankle": (("{}AJC",), ("{}ANK", "{}ANKM"), ("{}_ANKLE_LAT", "{}_ANKLE_MED"), ("{}ANK",)),
    }.items()
}
"""Columns of ``reference.csv``, and of which markers each may be the middle; the first choice whose markers are all
there."""


def import_trial(
    trial: Path, folder: Path, calibration: Path | None = None, markers: Path | None = None, mocap_delay_s: float = 0.0
) -> list[str]:
    """Write the session folder ``folder`` of the trial's videos, all or nothing; return its description, line by line.

    calibration : folder of the calibration files; else they are looked for in the participant's folder.
    markers : YAML, point: [marker, ...]. mocap_delay_s : time of the first mocap frame after the first image, s.
    World frame: the data set's, z up; metres. Raises InputError naming the file.
    """
    videos = _videos(trial)
    names = {video: f"cam{number:02d}" for number, video in enumerate(videos, 1)}
    cameras = tuple(read_calibration(_calibration(video, calibration), video, names[video]) for video in videos)
    mocap = read_c3d(trial / "markers.c3d", "It lies in the folder of the trial, beside the videos.")
    chosen = choose_markers(mocap, None if markers is None else read_mapping(markers, "Give lists of markers."))
    fps, frames = _rate_and_length(videos)
    points = {name: _at_frames(mocap, labels, frames, fps, mocap_delay_s) for name, labels in chosen.items()}
    known = np.isfinite(np.hstack(list(points.values()))).all(axis=1)
    with replaced_folder(folder) as partial:
        for video in videos:  # not decoded again
            shutil.copyfile(video, partial / (names[video] + video.suffix.lower()))
        seen = np.concatenate(list(points.values()))
        seen = seen[np.isfinite(seen).all(axis=1)]
        save_rig(Rig(cameras, volume_around(seen) if len(seen) else default_volume(cameras)), partial / "rig.yaml")
        write_truth_file(partial / "reference.csv", np.arange(frames), points)
        of_cameras = {name: video.name for video, name in names.items()}
        of_points = {name: list(labels) for name, labels in chosen.items()}
        source = f"BioCV, {trial.resolve().parent.name} {trial.name}"
        save_description(partial, fps, source, "biocv", cameras=of_cameras, markers=of_points)
    return [
        f"{trial.name}: {frames} frames of {', '.join(names.values())}",
        *(f"{point}: {', '.join(labels)}" for point, labels in chosen.items()),
        f"all markers are there in {known.sum()} frames ({known.mean():.0%})",
    ]


def read_calibration(path: Path, video: Path, name: str) -> CameraModel:
    """Return the camera of a calibration file, called ``name``, metres.

    Raises InputError naming the file for missing numbers, an image size that is not the video's, or a matrix L that is
    no rigid motion.
    """
    numbers = read_numbers(path, COUNT, NUMBERS)
    width, height = int(numbers[0]), int(numbers[1])
    with Video(video) as opened:
        if opened.size_px != (width, height):
            what = f"is of images of {width} x {height} px, those of {video.name} are {opened.size_px}"
            raise InputError(what, where=str(path), remedy="Give the calibration of that camera.")
    K, L, distortion = numbers[2:11].reshape(3, 3), numbers[11:27].reshape(4, 4), numbers[27:32]
    if np.abs(L[3] - [0, 0, 0, 1]).max() > WRITTEN_TOLERANCE:
        raise InputError(f"the last row of its L is {L[3].tolist()}", where=str(path), remedy=RIGID)
    T_camera_world = pose_of(L[:3, :3], L[:3, 3], path, RIGID)
    return CameraModel(name, width, height, K, "plumb_bob", distortion, T_camera_world)


def choose_markers(mocap: Mocap, given: Mapping[str, object] | None = None) -> dict[str, tuple[str, ...]]:
    """Return the markers whose mean is each point. Raises InputError listing the file's markers."""
    choices: dict[str, tuple[tuple[str, ...], ...]] = dict(MARKERS)
    for name, labels in (given or {}).items():
        if name not in MARKERS or not isinstance(labels, list) or not all(isinstance(one, str) for one in labels):
            remedy = f"Write NAME: [MARKER, ...] for any of {', '.join(MARKERS)}."
            what = f"{name!r}: {labels!r} is not a list of markers of a point"
            raise InputError(what, where="--markers", remedy=remedy)
        choices[name] = (tuple(labels),)
    chosen = {
        name: next((labels for labels in options if labels and all(label in mocap.column for label in labels)), None)
        for name, options in choices.items()
    }
    unknown = [name for name, labels in chosen.items() if labels is None]
    if unknown:
        what = f"has no markers for {', '.join(unknown)} by the names that are known; it has {', '.join(mocap.column)}"
        remedy = f"Give --markers a YAML file with lines such as '{unknown[0]}: [{next(iter(mocap.column))}]'."
        raise InputError(what, where=str(mocap.path), remedy=remedy)
    return {name: labels for name, labels in chosen.items() if labels is not None}


def _at_frames(mocap: Mocap, labels: Iterable[str], frames: int, fps: float, delay_s: float) -> np.ndarray:
    """Return (F, 3) the middle of markers at each frame's time, m; NaN where one of them was not seen around it."""
    positions = np.round((np.arange(frames) / fps - delay_s) * mocap.rate_hz, 6) + 1.0
    at = Instants.of(positions, len(mocap.points_mm))
    middle_mm = np.mean([between(mocap.track_mm(label), at) for label in labels], axis=0)
    return np.where(at.inside[:, None], middle_mm / 1000.0, np.nan)


def _videos(trial: Path) -> list[Path]:
    remedy = "Give the folder of one trial: it holds a video of each camera and markers.c3d."
    if not trial.is_dir():
        raise InputError("is not a folder", where=str(trial), remedy=remedy)
    videos = sorted(path for path in trial.iterdir() if path.suffix.lower() in VIDEO_SUFFIXES)
    if len(videos) < 2:
        raise InputError(f"holds {len(videos)} videos", where=str(trial), remedy=remedy)
    return videos


def _calibration(video: Path, folder: Path | None) -> Path:
    """Return the file in the folder, or anywhere in the participant's, whose name up to the first dot is the video's,
    and that is no video."""
    place = folder or video.resolve().parents[1]
    named = (path for path in sorted(place.rglob(f"{video.stem}.*")) if path.is_file())
    found = next((path for path in named if path.suffix.lower() not in VIDEO_SUFFIXES), None)
    if found is None:
        what = f"no calibration of {video.name} is there"
        raise InputError(what, where=str(place), remedy="Give its folder: --calibration.")
    return found


def _rate_and_length(videos: list[Path]) -> tuple[float, int]:
    """Return frames a second and the frames of the shortest video. Raises InputError when rates differ."""
    rates, lengths = [], []
    for path in videos:
        with Video(path) as video:
            rates.append(video.fps)
            lengths.append(video.skip(1 << 30))
    if max(rates) - min(rates) > 1e-3 * max(rates):
        what = f"the videos have {min(rates):g} to {max(rates):g} frames a second"
        raise InputError(what, where=str(videos[0].parent), remedy="Copy them again from the data set.")
    return float(rates[0]), min(lengths)
