"""Camera images out of ROS messages: raw (those of sensor_msgs/image_encodings that cameras use) and compressed."""

from __future__ import annotations

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image

from capture_rig.errors import InputError

# encoding -> channels, type, conversion to grey or BGR
ENCODINGS: dict[str, tuple[int, str, int | None]] = {
    "mono8": (1, "u1", None),
    "8UC1": (1, "u1", None),
    "mono16": (1, "u2", None),
    "16UC1": (1, "u2", None),
    "bgr8": (3, "u1", None),
    "8UC3": (3, "u1", None),
    "rgb8": (3, "u1", cv2.COLOR_RGB2BGR),
    "bgra8": (4, "u1", cv2.COLOR_BGRA2BGR),
    "rgba8": (4, "u1", cv2.COLOR_RGBA2BGR),
    "yuv422": (2, "u1", cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, "u1", cv2.COLOR_YUV2BGR_YUYV),
    "bayer_rggb8": (1, "u1", cv2.COLOR_BayerBG2BGR),  # OpenCV names the second row's pattern
    "bayer_bggr8": (1, "u1", cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": (1, "u1", cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, "u1", cv2.COLOR_BayerGB2BGR),
}


def image_of(message: Image | CompressedImage, where: str) -> np.ndarray:
    """(H, W) or (H, W, 3) BGR uint8. Raises InputError naming ``where`` for an encoding or a size that is none."""
    if isinstance(message, CompressedImage):
        return _decoded(message, where)
    if message.encoding not in ENCODINGS:
        raise InputError(
            f"encoding '{message.encoding}' is not known", where=where, remedy=f"Publish one of {', '.join(ENCODINGS)}."
        )
    channels, kind, conversion = ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    row_bytes = message.width * channels * dtype.itemsize
    if message.step < row_bytes or len(message.data) != message.step * message.height or not message.width:
        raise InputError(
            f"an image of {message.width} x {message.height} with step {message.step} does not have "
            f"{len(message.data)} bytes",
            where=where,
            remedy="Mend the publisher.",
        )
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)[:, :row_bytes]
    pixels = np.ascontiguousarray(rows).view(dtype).reshape(message.height, message.width, channels)
    if dtype.itemsize == 2:
        pixels = (pixels / max(int(pixels.max()), 1) * 255).astype(np.uint8)
    pixels = pixels[:, :, 0] if channels == 1 else pixels
    return pixels if conversion is None else cv2.cvtColor(pixels, conversion)


def _decoded(message: CompressedImage, where: str) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_ANYCOLOR)
    if image is None:
        raise InputError(
            f"the image (format '{message.format}') cannot be decoded", where=where, remedy="Publish JPEG or PNG."
        )
    return image
