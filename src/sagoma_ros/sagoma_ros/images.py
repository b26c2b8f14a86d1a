"""Silhouettes as PNG of few levels, images, camera_info (REP-104) and reports of support to and from messages."""

from __future__ import annotations

import array

import cv2
import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.mask_levels import BACKGROUND
from mocap_packets import silhouette
from mocap_packets.silhouette import ForegroundSupport

from . import mask_png
from .messages import to_ns, to_stamp

SILHOUETTE_FORMAT = "mono8; png compressed mono8"
MONO_PNG = ((1, 0), (2, 0), (4, 0), (8, 0))  # bits a pixel, colour type
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
}
_BAYER = {  # OpenCV names the second row's pattern
    "rggb": cv2.COLOR_BayerBG2BGR,
    "bggr": cv2.COLOR_BayerRG2BGR,
    "gbrg": cv2.COLOR_BayerGR2BGR,
    "grbg": cv2.COLOR_BayerGB2BGR,
}
ENCODINGS |= {f"bayer_{name}{8 * n}": (1, f"u{n}", code) for n in (1, 2) for name, code in _BAYER.items()}


ABSENT = "none"  # the format of a message that declares that there is no silhouette of this instant


def silhouette_message(mask: np.ndarray, stamp_ns: int, frame_id: str) -> CompressedImage:
    """Mask (h, w) uint8 as a PNG of 2 to 6 KB that rviz, Foxglove and image_transport show.

    The levels are those of ``capture_rig.mask_levels``. The PNG has one bit a pixel; two with shadow candidates, four
    with degrees of darkness.
    """
    header, data = Header(stamp=to_stamp(stamp_ns), frame_id=frame_id), array.array("B", mask_png.encode(mask))
    return CompressedImage(header=header, format=SILHOUETTE_FORMAT, data=data)


def absence_message(stamp_ns: int) -> CompressedImage:
    """Make the message by which a replay declares that there is no silhouette of this instant."""
    return CompressedImage(header=Header(stamp=to_stamp(stamp_ns)), format=ABSENT)


def preview_message(image: np.ndarray, stamp_ns: int, frame_id: str) -> CompressedImage:
    """Image (h, w[, 3]) uint8 BGR as JPEG, for looking at."""
    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return CompressedImage(
        header=Header(stamp=to_stamp(stamp_ns), frame_id=frame_id), format="jpeg", data=_bytes(encoded)
    )


def decode_silhouette(
    message: CompressedImage, width: int, height: int, where: str, candidates: int = BACKGROUND
) -> np.ndarray:
    """Return the mask (height, width) uint8, 0 or 255, of a silhouette message.

    ``candidates`` is the level that shadow candidates get: BACKGROUND, FOREGROUND, or SHADOW_CANDIDATE to keep them and
    all degrees of darkness as they were sent.
    Raises InputError when it is no grey PNG, cannot be decoded, or has another size than the camera's canvas.
    """
    data = bytes(message.data)
    if not data.startswith(mask_png.SIGNATURE):
        remedy = f"Publish '{SILHOUETTE_FORMAT}', as camera_client does."
        raise InputError(f"format '{message.format}' is not a PNG silhouette", where=where, remedy=remedy)
    header = mask_png.read_header(data)
    if header is None:
        raise _damaged(where)
    if (header.depth, header.colour_type) not in MONO_PNG:
        what = f"the PNG is not mono8: its bit depth and colour type are {[header.depth, header.colour_type]}"
        raise InputError(what, where=where, remedy=f"Publish '{SILHOUETTE_FORMAT}', as camera_client does.")
    if (header.width, header.height) != (width, height):  # before any memory is allocated
        what = f"the silhouette is {header.width} x {header.height} pixels, the undistorted canvas {width} x {height}"
        raise InputError(what, where=where, remedy="Give camera client and hull server the same rig file.")
    mask = mask_png.decode(data, candidates)
    if mask is not None:
        return mask
    other = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)  # another program wrote it
    if other is None or other.shape != (height, width):
        raise _damaged(where)
    return cv2.LUT(other, mask_png.levels_of_greys(header.depth, candidates))


def _damaged(where: str) -> InputError:
    return InputError("the PNG cannot be decoded", where=where, remedy="The message is damaged; check the network.")


def image_message(image: np.ndarray, stamp_ns: int, frame_id: str) -> Image:
    """Image (h, w) mono8 or (h, w, 3) bgr8."""
    message = Image(height=image.shape[0], width=image.shape[1], encoding="mono8" if image.ndim == 2 else "bgr8")
    message.header.stamp, message.header.frame_id = to_stamp(stamp_ns), frame_id
    message.step = image.shape[1] * (1 if image.ndim == 2 else 3)
    message.data = _bytes(image)
    return message


def camera_info_message(camera: CameraModel, stamp_ns: int, frame_id: str) -> CameraInfo:
    """camera_info of an image of ``camera``; of an undistorted one D = 0 and K = P."""
    info = CameraInfo(width=camera.width, height=camera.height, distortion_model=camera.distortion_model)
    info.header.stamp, info.header.frame_id = to_stamp(stamp_ns), frame_id
    info.d = camera.D.tolist()
    info.k = camera.K.reshape(9)
    info.r = np.eye(3).reshape(9)
    info.p = np.hstack([camera.K, np.zeros((3, 1))]).reshape(12)
    return info


def _bytes(values: np.ndarray) -> array.array:
    """rclpy copies an array('B') as a block; an ndarray it copies element by element, a thousand times slower."""
    return array.array("B", values.tobytes())


def decode_image(message: Image | CompressedImage, where: str, bits: int | None = None) -> np.ndarray:
    """Return the image (H, W) or (H, W, 3) BGR uint8 of a raw message (encodings of cameras) or a compressed one.

    bits : of a grey level in encodings of 16 bits, the upper 8 are kept; None: as bright as the image allows.
    Raises InputError naming ``where`` for an unknown encoding or a wrong size.
    """
    if isinstance(message, CompressedImage):
        return _decode_compressed(message, where)
    if message.encoding not in ENCODINGS:
        remedy = f"Publish one of {', '.join(ENCODINGS)}."
        raise InputError(f"encoding '{message.encoding}' is not known", where=where, remedy=remedy)
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
        if bits is None:
            pixels = (pixels / max(int(pixels.max()), 1) * 255).astype(np.uint8)
        else:
            pixels = np.minimum(pixels >> (bits - 8), 255).astype(np.uint8)
    pixels = pixels[:, :, 0] if channels == 1 else pixels
    return pixels if conversion is None else cv2.cvtColor(pixels, conversion)


def _decode_compressed(message: CompressedImage, where: str) -> np.ndarray:
    try:
        image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_ANYCOLOR)
    except cv2.error:  # empty, or larger than OpenCV takes
        image = None
    if image is None:
        remedy = "Publish JPEG or PNG."
        raise InputError(f"the image (format '{message.format}') cannot be decoded", where=where, remedy=remedy)
    return image


def support_message(report: ForegroundSupport, tf_prefix: str = "") -> Image:
    """Return a report as a mono8 image of one pixel a cell."""
    return image_message(report.cells, report.stamp_ns, f"{tf_prefix}{report.camera}_optical")


def read_support(message: Image, camera: str, canvas_width: int, where: str) -> ForegroundSupport:
    """Return the inverse of :func:`support_message`; InputError when it is not of this camera's canvas."""
    cells, stamp_ns = decode_image(message, where), to_ns(message.header.stamp)
    remedy = "Give camera client and hull server the same rig file."
    if cells.ndim != 2 or not np.isin(cells, silhouette.LEVELS).all():
        raise InputError("holds other levels than those of a report", where=where, remedy="Check its publisher.")
    try:
        return ForegroundSupport.of_canvas(stamp_ns, camera, cells, canvas_width)
    except ValueError as error:
        raise InputError(str(error), where=where, remedy=remedy) from None
