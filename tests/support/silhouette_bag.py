"""A bag of silhouettes as cameras would have sent them, without cameras: input of the server alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from rclpy.serialization import serialize_message

from capture_rig.rig import Rig, save_rig
from capture_rig.session import footage_stamp_ns
from sagoma_ros.images import camera_info_message, silhouette_message
from sagoma_tools.graph.topics import camera_topics
from sagoma_tools.recording.writer import BagWriter

EPOCH_NS = 1_700_000_000_000_000_000


def write_silhouette_bag(folder: Path, rig: Rig, frames: Iterable[Mapping[str, np.ndarray]], fps: float) -> Path:
    """Write one camera_info and one silhouette (h, w) of the canvas for every camera and frame; returns the bag."""
    rig_file = folder.with_suffix(".rig.yaml")
    save_rig(rig, rig_file)
    canvases = {camera.name: camera.undistorted_view().camera for camera in rig.cameras}
    with BagWriter(folder) as writer:
        for camera in rig.names:
            for topic in camera_topics(camera):
                writer.add_topic(topic.name, topic.msgtype)
        for frame, masks in enumerate(frames):
            stamp_ns = footage_stamp_ns(EPOCH_NS, frame, fps)
            for camera, mask in masks.items():
                info, silhouette = camera_topics(camera)
                frame_id = f"{camera}_optical"
                message = camera_info_message(canvases[camera], stamp_ns, frame_id)
                writer.write(info.name, stamp_ns, serialize_message(message))
                writer.write(silhouette.name, stamp_ns, serialize_message(silhouette_message(mask, stamp_ns, frame_id)))
        writer.describe({"made_by": "tests/support/silhouette_bag.py"}, rig_file)
    return folder
