"""A take as files of other programs, everybody's motion, and as a video over each camera's silhouettes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.files import make_folder
from capture_rig.mask_levels import SHADOW_CANDIDATE
from capture_rig.rig import load_rig
from capture_rig.video import VideoFile
from motion_export.animation_files import write_bvh, write_glb
from motion_export.marker_files import write_c3d, write_csv, write_trc
from motion_export.motion import NS_PER_S, Motion
from motion_export.opensim import write_mot, write_osim
from sagoma_ros.images import decode_silhouette

from ..graph.topics import SILHOUETTE_SUFFIX, cameras_in
from ..overlays import MAX_WIDTH_PX, Window, captioned, draw_skeleton, montage, tiling, write_name
from ..recording.reader import SIDECAR_RIG, BagMessage, read_messages, rig_in
from ..recording.recorded_motion import TRUSTED, recorded_motions
from .measure import measure
from .take import Quality, Take

Writer = Callable[[Motion, Path], None]


def writers(mass_kg: float | None = None) -> Mapping[str, Mapping[str, Writer]]:
    """Return for each format the extensions of its files and their writers."""
    return {
        "bvh": {"bvh": write_bvh},
        "glb": {"glb": write_glb},
        "c3d": {"c3d": write_c3d},
        "trc": {"trc": write_trc},
        "opensim": {"osim": partial(write_osim, mass_kg=mass_kg), "mot": write_mot},
        "csv": {"csv": write_csv},
    }


FORMATS = tuple(writers())
WITHOUT_GAPS = ("bvh", "opensim")
EXPORTS = "export"
"""The default folder of its files in a take's folder."""


def export_take(
    take: Path,
    folder: Path,
    formats: Sequence[str],
    rate_hz: float | None = None,
    mass_kg: float | None = None,
    overwrite: bool = False,
    log: Callable[[str], None] = lambda text: None,
) -> list[Path]:
    """Write every person of a take in every requested format, each file all or nothing; return the files.

    rate_hz : frames a second, None for the take's own. mass_kg : of the OpenSim model, None for a BMI of 22.
    overwrite : replace files. log : called with a line for every person and file. Raises InputError for a take without
    a person, and for files that exist.
    """
    motions = recorded_motions(take, rate_hz)
    planned = [
        (body_id, kind, folder / f"{motion.name}.{extension}", write)
        for body_id, motion in motions.items()
        for kind in dict.fromkeys(formats)
        for extension, write in writers(mass_kg)[kind].items()
    ]
    existing = [str(path) for _, _, path, _ in planned if path.exists()]
    if existing and not overwrite:
        remedy = "Give another --output, or --overwrite."
        raise InputError(f"{', '.join(existing)} exists", where="--output", remedy=remedy)
    make_folder(folder)
    for body_id, motion in motions.items():
        log(f"{body_id}: {describe(motion)}")
    for body_id, kind, path, write in planned:
        write(motions[body_id], path)
        filled = motions[body_id].gaps and kind in WITHOUT_GAPS
        log(f"  {path}{'  (gaps are filled by interpolation)' if filled else ''}")
    return [path for _, _, path, _ in planned]


def describe(motion: Motion) -> str:
    """Return length, rate and gaps of a motion in words."""
    lost = sum(end - first for first, end in motion.gaps) / motion.rate_hz
    gaps = f", {len(motion.gaps)} gaps of {lost:.1f} s in all" if motion.gaps else ", no gaps"
    return f"{len(motion)} frames at {motion.rate_hz:g} Hz{gaps}"


# as a video -----------------------------------------------------------------------------------------------------------


VIDEO = "overlay.mp4"
ROOM_GREY, BODY_GREY, SHADOW_GREY = 38, 150, 75
MOST_HZ = 60


def write_video(take: Take, path: Path, progress: Callable[[int, int], None] = lambda frame, frames: None) -> int:
    """Write a take's video in real time; returns its frames.

    Raises InputError for a take without a rig or silhouettes, and a path that exists.
    """
    if path.exists():
        raise InputError("exists already", where=str(path), remedy="Give another --output, or move it away.")
    quality = (take.summary or measure(take.path)).quality
    views = _views(take)
    try:
        motions = recorded_motions(take.path)
    except InputError:
        motions = {}  # of a take without a person, the silhouettes
    rate_hz = min(quality.rate_hz, MOST_HZ) or MOST_HZ  # one frame set has no rate
    frames = round(quality.seconds * rate_hz) + 1
    with VideoFile(path, rate_hz) as video:
        for frame, sheet in enumerate(sheets(take.name, views, motions, quality, rate_hz, frames)):
            progress(frame, frames)
            video.write(sheet)
    return frames


@dataclass
class Masks:
    """One camera's silhouettes, and the camera of their undistorted canvas."""

    camera: CameraModel
    messages: Iterator[BagMessage]
    _now: BagMessage | None = None
    _next: BagMessage | None = None

    def picture_at(self, stamp_ns: int) -> np.ndarray | None:
        """Return the newest picture (H, W, 3) at a stamp, None where there is none within a second; stamps grow."""
        while self._next is None or self._next.stamp_ns <= stamp_ns:
            self._now = self._next or self._now
            self._next = next(self.messages, None)
            if self._next is None:
                break
        if self._now is None or stamp_ns - self._now.stamp_ns > NS_PER_S:
            return None
        image = self._now.decode(CompressedImage)
        mask = decode_silhouette(image, self.camera.width, self.camera.height, self._now.topic)
        grey = np.full(mask.shape, ROOM_GREY, np.uint8)
        grey[mask > 0] = SHADOW_GREY
        grey[mask > SHADOW_CANDIDATE] = BODY_GREY
        return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


def sheets(
    name: str, views: Sequence[Masks], motions: Mapping[str, Motion], quality: Quality, rate_hz: float, frames: int
) -> Iterator[np.ndarray]:
    """Yield the video's pictures, BGR, all of one even size."""
    columns, scale = tiling([view.camera.width for view in views], [view.camera.height for view in views])
    for frame in range(frames):
        seconds = frame / rate_hz
        stamp_ns = quality.begins_ns + round(seconds * 1e9)
        there = {
            body_id: (motion, row)
            for body_id, motion in motions.items()
            if (row := motion.frame_at(stamp_ns)) is not None
        }
        slack_ns = round(0.5e9 / rate_hz)
        cells = [_cell(view, view.picture_at(stamp_ns + slack_ns), there, scale) for view in views]
        sheet = montage(cells, columns, MAX_WIDTH_PX)
        states = {body_id: str(motion.states[row]) for body_id, (motion, row) in there.items()}
        said = ", ".join(f"{body_id} {state}" for body_id, state in states.items()) or "nobody"
        sure = all(state == TRUSTED for state in states.values()) if states else None
        yield captioned(sheet, f"{name}   {seconds:6.2f} s   {said}", sure)


def _cell(view: Masks, picture: np.ndarray | None, there: Mapping[str, tuple[Motion, int]], scale: float) -> np.ndarray:
    camera = view.camera
    window = Window.whole(camera, scale)
    width, height = window.size_px
    if picture is None:
        cell: np.ndarray = np.zeros((height, width, 3), np.uint8)
        write_name(cell, "no picture", (8, height // 2))
    else:
        cell = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    for motion, row in there.values():
        draw_skeleton(cell, camera, motion.points_world[row], window=window)
    return write_name(cell, camera.name)


def _views(take: Take) -> list[Masks]:
    if (rig_file := rig_in(take.path)) is None:
        remedy = "Record with --rig, or copy the rig file there."
        what = f"has no {SIDECAR_RIG}: where the cameras stood is not known"
        raise InputError(what, where=str(take.path), remedy=remedy)
    cameras = cameras_in(take.topics)
    if not cameras:
        remedy = "Record the cameras' topics, too."
        raise InputError("holds no silhouettes of any camera", where=str(take.path), remedy=remedy)
    rig, views = load_rig(rig_file), []
    for name in cameras:
        messages = read_messages(take.path, f"/{name}{SILHOUETTE_SUFFIX}".__eq__)
        views.append(Masks(rig.camera(name).undistorted_view().camera, messages))
    return views
