"""The graph's cores called one after another in this process: what lockstep gives, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from camera_client.background_files import read_background
from camera_client.settings import CameraClientSettings
from camera_client.silhouette import SilhouettePipeline
from capture_rig.errors import InputError
from capture_rig.frame_set import FrameSet
from capture_rig.session import Session, footage_stamp_ns
from capture_rig.settings import build_settings
from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.settings import EkfSettings
from ekf_tracker.state import EkfState
from hull_server.pipeline import HullPipeline
from hull_server.settings import HullSettings
from icp_tracker.icp_node import IcpNodeSettings
from icp_tracker.pose_source import make_pose_source
from icp_tracker.tracker import IcpTracker
from icp_tracker.voxel_cloud import VoxelCloud

from .track import Track

EPOCH_NS = 1_000_000_000_000_000_000
Masks = dict[str, np.ndarray]


@dataclass(frozen=True)
class Feedback:
    """The EKF's state after a set, as the ICP tracker takes it."""

    stamp_ns: int
    pose: Any
    velocity: np.ndarray


@dataclass(frozen=True, eq=False)
class Configuration:
    """The settings of every stage; :meth:`of` takes the parameters of the graph's nodes as one flat mapping."""

    camera: CameraClientSettings
    hull: HullSettings
    icp: IcpNodeSettings
    ekf: EkfSettings

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Configuration:
        """From NODE.PARAMETER keys, as ``sagoma up --set`` takes them; InputError for a node that does not exist."""
        parts: dict[str, dict[str, Any]] = {"cameras": {}, "hull_server": {}, "icp_tracker": {}, "ekf_tracker": {}}
        for key, value in settings.items():
            node, _, parameter = key.partition(".")
            if node not in parts:
                raise InputError(f"'{key}' names no node", where="settings", remedy=f"Nodes: {', '.join(parts)}.")
            parts[node][parameter.removeprefix("filter.") if node == "ekf_tracker" else parameter] = value
        return cls(
            build_settings(CameraClientSettings, parts["cameras"], "cameras"),
            build_settings(HullSettings, parts["hull_server"], "hull_server"),
            build_settings(IcpNodeSettings, parts["icp_tracker"], "icp_tracker"),
            build_settings(EkfSettings, parts["ekf_tracker"], "ekf_tracker"),
        )


def track_session(
    session: Session,
    configuration: Configuration,
    *,
    exact_masks: bool = False,
    progress: Callable[[int], None] = lambda frame: None,
) -> Track:
    """Footage in, track out: silhouettes, hull, ICP fit started from the EKF's state, EKF update, frame by frame.

    exact_masks : take the session's exact silhouettes instead of segmenting its footage.
    """
    masks = exact_silhouettes(session) if exact_masks else silhouettes(session, configuration.camera)
    hull = HullPipeline(session.rig, configuration.hull)
    source = make_pose_source(configuration.icp.initial_pose, configuration.icp.body_file)
    icp, ekf = IcpTracker(source, configuration.icp), None
    feedback: Feedback | None = None
    rows: list[tuple[int, EkfState]] = []
    for frame, frame_masks in enumerate(masks):
        progress(frame)
        stamp_ns = footage_stamp_ns(EPOCH_NS, frame, session.fps)
        frame_set = FrameSet(stamp_ns, frame_masks, dict.fromkeys(frame_masks, stamp_ns), ())
        result = hull.run(frame_set)
        line = result.centerline
        # float32, as the clouds between the nodes carry them
        points, sigma = (a.astype(np.float32).astype(np.float64) for a in (line.points_world, line.sigma))
        samples = result.voxels
        voxels = VoxelCloud.checked(samples.points_world.astype(np.float32), samples.surface)
        fit = icp.step(stamp_ns, points, sigma, voxels, feedback)
        if ekf is None and icp.body is not None:
            ekf = ArticulatedEkf(icp.body, configuration.ekf)
        if ekf is None:
            continue
        state = ekf.step(stamp_ns, fit.reference_points_world, fit.covariance, fit.visible)
        if isinstance(state, EkfState):
            rows.append((frame, state))
            feedback = Feedback(stamp_ns, state.pose, state.drift)
    return _track(rows, session)


def silhouettes(session: Session, settings: CameraClientSettings) -> Iterator[Masks]:
    """Canvas masks of every camera (levels of ``capture_rig.mask_levels``), segmented as the camera client does."""
    pipelines: dict[str, SilhouettePipeline] = {}
    for images in _images(session.videos):
        for name, image in images.items():
            if name not in pipelines:
                background = read_background(session.backgrounds[name], image.shape, settings.background_model)
                camera = session.rig.camera(name)
                pipelines[name] = SilhouettePipeline(
                    camera, background, settings.silhouette, settings.background_model, session.rig.volume
                )
        yield {name: pipelines[name].run(image).mask for name, image in images.items()}


def exact_silhouettes(session: Session) -> Iterator[Masks]:
    """Canvas masks of every camera from the session's exact silhouettes."""
    missing = [name for name in session.rig.names if name not in session.masks]
    if missing:
        raise InputError(f"there is no exact silhouette for {', '.join(missing)}", where=str(session.folder),
                         remedy=f"Add {missing[0]}_mask.mp4, or segment the footage.")  # fmt: skip
    views = {camera.name: camera.undistorted_view() for camera in session.rig.cameras}
    for images in _images(session.masks):
        yield {n: views[n].undistort_mask(np.where(i > 127, np.uint8(255), np.uint8(0))) for n, i in images.items()}


def _images(videos: dict[str, Path]) -> Iterator[dict[str, np.ndarray]]:
    """Images of all cameras, frame after frame until the shortest video ends; grey where the footage is grey."""
    captures = {name: cv2.VideoCapture(str(path)) for name, path in sorted(videos.items())}
    grey: dict[str, bool] = {}
    try:
        while True:
            images = {name: capture.read()[1] for name, capture in captures.items()}
            if any(image is None for image in images.values()):
                return
            for name, image in images.items():
                grey.setdefault(
                    name, bool((image[..., 0] == image[..., 1]).all() and (image[..., 1] == image[..., 2]).all())
                )
            yield {name: image[..., 0].copy() if grey[name] else image for name, image in images.items()}
    finally:
        for capture in captures.values():
            capture.release()


def _track(rows: list[tuple[int, EkfState]], session: Session) -> Track:
    if not rows:
        raise InputError("no body was found in any frame", where=str(session.folder),
                         remedy="Start from a T-pose, or give the reference of the first frame.")  # fmt: skip
    frames, states = zip(*rows, strict=True)
    return Track(
        np.array(frames),
        np.stack([state.points_world for state in states]),
        np.stack([state.point_covariance for state in states]),
        np.stack([state.angles for state in states]),
    )
