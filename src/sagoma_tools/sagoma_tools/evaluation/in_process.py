"""Tracks sessions in this process, without ROS: the same results as lockstep; the rows of an ablation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from camera_client.background.model import read_background
from camera_client.settings import CameraClientSettings
from camera_client.sources.footage_reader import VideoReader
from capture_rig.errors import InputError
from capture_rig.session import Session, footage_stamp_ns
from capture_rig.video_findings import VideoFacts
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.state import BodyState
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import BodyFollower, Masks, MocapPipeline, make_segmenter

from .people import main_track
from .reasons import nobody_tracked, reasons_of_step
from .track import Track

FootageEnded = Callable[[dict[str, VideoFacts]], None]
EPOCH_NS = 1_000_000_000_000_000_000


def ignore_end(facts: dict[str, VideoFacts]) -> None:
    """Do nothing about what came of the videos."""


def track_session(
    session: Session,
    configuration: Configuration,
    *,
    exact_masks: bool = False,
    progress: Callable[[int], None] = lambda frame: None,
) -> Track:
    """Footage in, track out: silhouettes, hull, ICP fit started from the EKF's state, EKF update, frame by frame.

    exact_masks : take the session's exact silhouettes instead of segmenting its footage.
    Raises InputError when no body was found in any frame.
    """
    (track,) = track_variants(session, {"": configuration}, exact_masks=exact_masks, progress=progress).values()
    return track


def track_variants(
    session: Session,
    variants: Mapping[str, Configuration],
    *,
    exact_masks: bool = False,
    progress: Callable[[int], None] = lambda frame: None,
    ended: FootageEnded = ignore_end,
) -> dict[str, Track]:
    """Track as :func:`track_people`; of each configuration, the track of the person that the first truth is of."""
    people = track_people(session, variants, exact_masks=exact_masks, progress=progress, ended=ended)
    return {name: main_track(tracks, session.truths, session.fps) for name, tracks in people.items()}


def track_people(
    session: Session,
    variants: Mapping[str, Configuration],
    *,
    exact_masks: bool = False,
    progress: Callable[[int], None] = lambda frame: None,
    ended: FootageEnded = ignore_end,
) -> dict[str, dict[int, Track]]:
    """Track everybody with several configurations over the same hulls: every frame is segmented and carved once.

    Returns each configuration's tracks by the person's number; the first person's is always there. Cameras and hull
    are set as the first one says, from which the others may differ in fit and filter only; it is also the one that must
    find a body (InputError): another's tracks may be empty. ``ended`` : is told what came of the videos when the
    shortest has ended.
    """
    first, *others = variants.values()
    if any((other.camera, other.hull) != (first.camera, first.hull) for other in others):
        raise ValueError("variants of one run differ in the settings of cameras or hull")
    pipeline = MocapPipeline(session.rig, first)
    masks = exact_silhouettes(session, ended) if exact_masks else segmented(session, first.camera, pipeline, ended)
    followers = [pipeline.body, *(BodyFollower.of(other, session.rig) for other in others)]
    rows: list[dict[int, list[tuple[int, BodyState]]]] = [{FIRST_PERSON: []} for _ in followers]
    reasons: list[tuple[str, ...]] = []
    for frame, frame_masks in enumerate(masks):
        progress(frame)
        products = pipeline.carve(footage_stamp_ns(EPOCH_NS, frame, session.fps), frame_masks)
        steps = [follower.step(products) for follower in followers]
        reasons.append(reasons_of_step(steps[0]))
        for step, states in zip(steps, rows, strict=True):
            for person in step.people:
                if person.state is not None:
                    states.setdefault(person.person, []).append((frame, person.state))
    if not rows[0][FIRST_PERSON]:
        raise nobody_tracked("no body was found in any frame", str(session.folder), reasons)
    return {
        name: {person: Track.of_states(of_person) for person, of_person in sorted(states.items())}
        for name, states in zip(variants, rows, strict=True)
    }


def segmented(
    session: Session, settings: CameraClientSettings, pipeline: MocapPipeline, ended: FootageEnded = ignore_end
) -> Iterator[Masks]:
    """Canvas masks of every camera by the cameras of ``pipeline``, which are made with the first images.

    They hear what the pipeline's hull server reports if each frame is carved before the next one is asked for.
    """
    without = [name for name in session.rig.names if name not in session.backgrounds]
    if without:
        remedy = f"Add {without[0]}_background.mp4 or .png: the empty scene."
        raise InputError(f"there is no background for {', '.join(without)}", where=str(session.folder), remedy=remedy)
    for frame, images in enumerate(images_of(session.videos, ended)):
        for name in [name for name in images if name not in pipeline.cameras]:
            background = read_background(session.backgrounds[name], images[name].shape, settings.background_model)
            camera = session.rig.camera(name)
            pipeline.cameras[name] = make_segmenter(camera, background, settings, session.rig.volume)
        yield pipeline.segment(footage_stamp_ns(EPOCH_NS, frame, session.fps), images)


def silhouettes(session: Session, settings: CameraClientSettings) -> Iterator[Masks]:
    """Canvas masks of every camera (levels of ``capture_rig.mask_levels``) as sent in the loop with a hull server."""
    configuration = replace(Configuration.of({}), camera=settings)
    pipeline = MocapPipeline(session.rig, configuration)
    for frame, masks in enumerate(segmented(session, settings, pipeline)):
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
        opened: dict[str, VideoReader] = {}
        for name, path in sorted(videos.items()):
            opened[name] = VideoReader(path, "auto", threads=0)
            stack.callback(opened[name].close)
            opened[name].probe()
        while True:
            images = {name: reader.read() for name, reader in opened.items()}
            found = {name: image for name, image in images.items() if image is not None}
            if len(found) < len(images):
                ended({name: reader.facts() for name, reader in opened.items()})
                return
            yield found


# ablation: from the thesis's method to ours, one part of the tracker more in every row

SOLVE = "icp_tracker.articulated."
THESIS = "thesis: hierarchical ICP, identity model"


@dataclass(frozen=True)
class Part:
    """A part of the tracker, and the settings that switch it off.

    without : settings (NODE.PARAMETER) that switch it off; feedback : False where without it each fit starts from
    the fit before instead of the filter's state.
    """

    name: str
    without: Mapping[str, Any] = field(default_factory=dict)
    feedback: bool = True


PARTS = (
    Part("all joints at once", {"icp_tracker.method": "hierarchical"}),
    Part("sticks inside the hull", {SOLVE + "volume.inside_weight": 0.0}),
    Part("the hull's surface on the body surface", {SOLVE + "volume.weight": 0.0}),
    Part("contour rays tangent to the body surface", {SOLVE + "contour.weight": 0.0}),
    Part("fits start from the filter's state", feedback=False),
    Part("constant velocity", {"ekf_tracker.motion_model": "identity"}),
)
"""In the order in which the rows add them."""
ROWS = (THESIS, *(f"+ {part.name}" for part in PARTS))
"""Each row's name; the last one is all of it."""
OURS = ROWS[-1]


def ablation_rows(settings: Mapping[str, Any]) -> dict[str, Configuration]:
    """Name to configuration: the thesis's method first; each row adds one part; the last one is the settings' own."""
    return {name: _without(PARTS[count:], settings) for count, name in enumerate(ROWS)}


def thesis_configuration(settings: Mapping[str, Any]) -> Configuration:
    """The thesis's method: hierarchical ICP started from its own last pose (4.3), then the filter without a motion
    model (5.2)."""
    return _without(PARTS, settings)


def _without(parts: tuple[Part, ...], settings: Mapping[str, Any]) -> Configuration:
    changed = dict(settings)
    for part in parts:
        changed.update(part.without)
    return Configuration.of(changed, feedback=all(part.feedback for part in parts))
