"""A session folder: one video and one background a camera, the rig, and optionally the truth.

Files: ``camNN.mp4``, ``camNN_background.mp4`` or ``.png``, ``rig.yaml``; optional ``camNN_mask.mp4`` (exact
silhouettes), ``truth.csv`` or ``reference*.csv``, ``session.yaml`` (``fps``, ``units``, ``source``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2

from .errors import InputError
from .rig import Rig, load_rig
from .truth import Truth, load_truth
from .yaml_file import read_mapping

VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov")
STILL_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif")


@dataclass(frozen=True, eq=False)
class Session:
    """Footage of one capture: every rig camera has a video; backgrounds, exact masks and truth are optional."""

    folder: Path
    rig: Rig
    fps: float
    videos: dict[str, Path]
    backgrounds: dict[str, Path]
    masks: dict[str, Path]
    truth: Truth | None


def load_session(folder: str | Path) -> Session:
    """Read a session folder; a missing or contradictory file is an InputError with its path and the remedy."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError("is not a folder", where=str(folder), remedy="Give a session folder (rig.yaml, camNN.mp4).")
    rig = load_rig(folder / "rig.yaml")
    found = {name: _find(folder, name, VIDEO_SUFFIXES) for name in rig.names}
    videos = {name: path for name, path in found.items() if path is not None}
    _check_cameras(folder, rig, videos)
    return Session(
        folder=folder,
        rig=rig,
        fps=_frame_rate(folder, videos),
        videos=videos,
        backgrounds=_present(folder, rig, "_background", VIDEO_SUFFIXES + STILL_SUFFIXES),
        masks=_present(folder, rig, "_mask", VIDEO_SUFFIXES),
        truth=_truth(folder),
    )


def footage_stamp_ns(epoch_ns: int, frame: int, fps: float) -> int:
    """Capture stamp of video frame ``frame``: every camera of a session computes the same number."""
    return epoch_ns + round(frame * 1e9 / fps)


def _find(folder: Path, stem: str, suffixes: tuple[str, ...]) -> Path | None:
    return next((folder / (stem + s) for s in suffixes if (folder / (stem + s)).is_file()), None)


def _present(folder: Path, rig: Rig, tail: str, suffixes: tuple[str, ...]) -> dict[str, Path]:
    found = {name: _find(folder, name + tail, suffixes) for name in rig.names}
    return {name: path for name, path in found.items() if path is not None}


def _check_cameras(folder: Path, rig: Rig, videos: dict[str, Path]) -> None:
    missing = [name for name in rig.names if name not in videos]
    if missing:
        raise InputError(
            f"the rig has {len(rig.names)} cameras, but there is no video for {', '.join(missing)}",
            where=str(folder),
            remedy=f"Add {missing[0]}.mp4, or take the camera out of rig.yaml.",
        )
    stems = {path.stem for path in folder.iterdir() if path.suffix in VIDEO_SUFFIXES}
    strangers = sorted(s for s in stems - set(rig.names) if not s.endswith(("_background", "_mask")))
    strangers = [s for s in strangers if s.startswith("cam")]
    if strangers:
        raise InputError(
            f"there is a video for {', '.join(strangers)}, which rig.yaml does not list",
            where=str(folder),
            remedy=f"Calibrate {strangers[0]} and add it to rig.yaml, or move its video away.",
        )


def _frame_rate(folder: Path, videos: dict[str, Path]) -> float:
    rates = {name: _video_rate(path) for name, path in videos.items()}
    stated = _stated_rate(folder / "session.yaml")
    if stated is not None:
        return stated
    if max(rates.values()) - min(rates.values()) > 1e-3 * max(rates.values()):
        raise InputError(
            f"the videos have different frame rates: {rates}",
            where=str(folder),
            remedy="Give the true rate as 'fps' in session.yaml.",
        )
    return next(iter(rates.values()))


def _video_rate(path: Path) -> float:
    capture = cv2.VideoCapture(str(path))
    try:
        rate = capture.get(cv2.CAP_PROP_FPS) if capture.isOpened() else 0.0
    finally:
        capture.release()
    if not 0 < rate < 10_000:
        raise InputError("cannot be opened as a video", where=str(path), remedy="Check the file, or its codec.")
    return float(rate)


def _stated_rate(path: Path) -> float | None:
    if not path.is_file():
        return None
    fps = read_mapping(path, "It holds 'fps', 'units' and 'source', all optional.").get("fps")
    if fps is None:
        return None
    if not isinstance(fps, int | float) or isinstance(fps, bool) or not 0 < fps < 10_000:
        raise InputError(f"fps = {fps!r} is not a frame rate", where=str(path), remedy="Give frames per second.")
    return float(fps)


def _truth(folder: Path) -> Truth | None:
    candidates = [folder / "truth.csv", *sorted(folder.glob("reference*.csv"))]
    return next((load_truth(path) for path in candidates if path.is_file()), None)
