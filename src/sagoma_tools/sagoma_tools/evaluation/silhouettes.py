"""Silhouettes out of a bag, back in the camera's own pixels, for drawing over footage."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage

from capture_rig.camera import CameraModel
from sagoma_ros.images import decode_silhouette

from ..bags import read_messages
from ..topics import camera_topics


def image_masks(
    bag: Path, cameras: Iterable[CameraModel], frames: Sequence[int], frame_of_stamp: Callable[[int], int]
) -> dict[str, list[np.ndarray]]:
    """Each camera's silhouettes (H, W) at the given frames, distorted back to image pixels; empty where none came."""
    return {camera.name: _masks_of(bag, camera, frames, frame_of_stamp) for camera in cameras}


def distort_mask(camera: CameraModel, canvas_mask: np.ndarray) -> np.ndarray:
    """A mask (h, w) on the padded undistorted canvas, looked up at every pixel (H, W) of the camera's image."""
    canvas = camera.undistorted_view().camera
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    rays_world = camera.rays_world(np.column_stack([columns.ravel(), rows.ravel()]))
    on_canvas = rays_world @ camera.R_camera_world.T @ canvas.K.T
    pixels = (on_canvas[:, :2] / on_canvas[:, 2:]).astype(np.float32).reshape(camera.height, camera.width, 2)
    return cv2.remap(canvas_mask, pixels[..., 0], pixels[..., 1], cv2.INTER_NEAREST)


def _masks_of(
    bag: Path, camera: CameraModel, frames: Sequence[int], frame_of_stamp: Callable[[int], int]
) -> list[np.ndarray]:
    topic, canvas = camera_topics(camera.name)[1].name, camera.undistorted_view().camera
    found = {}
    for message in read_messages(bag, topic.__eq__):
        frame = frame_of_stamp(message.stamp_ns)
        if frame in frames:
            mask = decode_silhouette(
                deserialize_message(message.data, CompressedImage), canvas.width, canvas.height, topic
            )
            found[frame] = distort_mask(camera, mask)
    empty = np.zeros((camera.height, camera.width), np.uint8)
    return [found.get(frame, empty) for frame in frames]
