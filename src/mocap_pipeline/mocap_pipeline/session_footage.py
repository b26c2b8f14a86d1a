"""A session folder for the pipeline: images with their stamps, silhouettes, a pipeline with the backgrounds, and
detections of 2D poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from camera_client.background.model import BackgroundModel, read_background
from camera_client.settings import CameraClientSettings
from camera_client.sources.footage_reader import FootageReader, open_footage
from capture_rig.errors import InputError
from capture_rig.rig import Rig
from capture_rig.session import Session, footage_stamp_ns, read_table
from capture_rig.video import Video, VideoFacts
from mocap_packets.frame_set import FrameSet
from mocap_packets.keypoints import NUMBERS, Detections

from .configuration import Configuration
from .pipeline import Masks, MocapPipeline

EPOCH_NS = 1_000_000_000_000_000_000
"""Stamp of a session's first images."""
FootageEnded = Callable[[dict[str, VideoFacts]], None]


def ignore_end(facts: dict[str, VideoFacts]) -> None:
    """Ignore the videos' facts."""


def pipeline_of(session: Session, configuration: Configuration | None = None) -> MocapPipeline:
    """Return a pipeline for the session's images. Raises InputError where a camera has no background."""
    chosen = configuration or Configuration.of({})
    without = [name for name in session.rig.names if name not in session.backgrounds]
    if without:
        remedy = f"Add {without[0]}_background.mp4 or .png: the empty scene."
        raise InputError(f"there is no background for {', '.join(without)}", where=str(session.folder), remedy=remedy)

    def background(name: str) -> BackgroundModel:
        with closing(open_footage(session.videos[name])) as video:
            return read_background(session.backgrounds[name], video.probe())

    return MocapPipeline(session.rig, chosen, {name: background(name) for name in session.rig.names})


def frame_sets(session: Session, ended: FootageEnded = ignore_end) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """Stamp, ns, and images (H, W[, 3]) uint8 by camera, frame after frame until the shortest video ends.

    ended : is called with the videos' facts.
    """
    for frame, images in enumerate(images_of(session.videos, ended)):
        stamps_ns = session.stamps_ns(EPOCH_NS, frame)
        yield FrameSet.of_stamps(stamps_ns, images).stamp_ns, images


def segmented(session: Session, pipeline: MocapPipeline, ended: FootageEnded = ignore_end) -> Iterator[Masks]:
    """Canvas masks of every camera, as the pipeline segments them.

    Its cameras get its hull server's support reports if each frame is carved before the next one is requested.
    """
    for stamp_ns, images in frame_sets(session, ended):
        yield pipeline.segment(stamp_ns, images)


def silhouettes(session: Session, settings: CameraClientSettings) -> Iterator[Masks]:
    """Canvas masks of every camera (levels of ``capture_rig.mask_levels``) as sent in the loop with a hull server."""
    pipeline = pipeline_of(session, replace(Configuration.of({}), camera=settings))
    for frame, masks in enumerate(segmented(session, pipeline)):
        yield masks
        pipeline.carve(footage_stamp_ns(EPOCH_NS, frame, session.fps), masks)


def exact_silhouettes(session: Session, ended: FootageEnded = ignore_end) -> Iterator[Masks]:
    """Canvas masks of every camera from the session's exact silhouettes."""
    missing = [name for name in session.rig.names if name not in session.masks]
    if missing:
        what = f"there is no exact silhouette for {', '.join(missing)}"
        raise InputError(what, where=str(session.folder), remedy=f"Add {missing[0]}_mask.mp4, or segment the footage.")
    views = {camera.name: camera.undistorted_view() for camera in session.rig.cameras}
    for images in images_of(session.masks, ended):
        yield {n: views[n].undistort_mask(np.where(i > 127, np.uint8(255), np.uint8(0))) for n, i in images.items()}


def images_of(videos: dict[str, Path], ended: FootageEnded = ignore_end) -> Iterator[dict[str, np.ndarray]]:
    """Images of all cameras, frame after frame until the shortest video ends; grey where the footage is grey, as the
    camera client reads it."""
    with ExitStack() as stack:
        opened = {name: stack.enter_context(Video(path)) for name, path in sorted(videos.items())}
        readers = {name: FootageReader(video, "auto") for name, video in opened.items()}
        for reader in readers.values():
            reader.probe()
        while True:
            images = {name: reader.read() for name, reader in readers.items()}
            found = {name: image for name, image in images.items() if image is not None}
            if len(found) < len(images):
                ended({name: video.facts for name, video in opened.items()})
                return
            yield found


def load_detections(folder: str | Path, rig: Rig) -> dict[int, list[Detections]]:
    """Read FOLDER/CAM.csv of the rig's cameras: a row a skeleton, the columns ``frame`` (of the video, from 0) and
    ``JOINT_x``, ``JOINT_y``, ``JOINT_cov_xx``, ``..._cov_xy``, ``..._cov_yy``, ``..._score``, empty where not found.

    Returns the images by frame, without stamps. Raises InputError for a folder without tables, and for other columns.
    """
    images: dict[int, list[Detections]] = {}
    paths = {name: Path(folder) / f"{name}.csv" for name in rig.names}
    found = {name: path for name, path in paths.items() if path.is_file()}
    if not found:
        remedy = f"Name the tables as cameras: {rig.names[0]}.csv."
        raise InputError("has no table of a camera of the rig", where=str(folder), remedy=remedy)
    for camera, path in found.items():
        header, rows = read_table(path)
        names = [column.removesuffix("_x") for column in header if column.endswith("_x") and "_cov_" not in column]
        missing = [f"{name}_{number}" for name in names for number in NUMBERS if f"{name}_{number}" not in header]
        if missing:
            raise InputError(f"column '{missing[0]}' is missing", where=str(path), remedy=f"Each joint has {NUMBERS}.")
        values = np.stack([rows[:, [header.index(f"{n}_{number}") for number in NUMBERS]] for n in names], axis=1)
        frames = rows[:, 0].astype(int)
        for frame in np.unique(frames).tolist():
            images.setdefault(frame, []).append(Detections(camera, 0, names, values[frames == frame]))
    return images
