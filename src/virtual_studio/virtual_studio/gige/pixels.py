"""From a picture to the bytes of a pixel format, as a sensor of that kind would send them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gige_vision.pixel_formats import PixelFormat

Image = NDArray[np.uint8]
Bytes = NDArray[np.uint8]

_BAYER_ROWS = {"RG": ((2, 1), (1, 0)), "GR": ((1, 2), (0, 1)), "GB": ((1, 0), (2, 1)), "BG": ((0, 1), (1, 2))}
"""Channel (of B, G, R) of the four pixels of a pattern's tile."""


def pixel_bytes(image: Image, pixel_format: PixelFormat) -> Bytes:
    """The bytes (n,) of a picture, (H, W) grey or (H, W, 3) BGR, in a pixel format.

    More than 8 bits repeat the upper bits below, so that black stays black and white white. A grey picture gives grey
    colours, a coloured one the grey of BT.601.
    """
    if not pixel_format.is_colour:
        grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        if pixel_format.depth == 8:
            return np.ascontiguousarray(grey).reshape(-1)
        deep = _deepened(grey, pixel_format.depth)
        return _packed(deep, pixel_format.depth) if pixel_format.is_packed else deep.astype("<u2").view(np.uint8)
    if pixel_format.is_bayer:
        return _bayer(image, pixel_format.name[5:7]).reshape(-1)
    colour = image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    if pixel_format is PixelFormat.BGR8:
        return np.ascontiguousarray(colour).reshape(-1)
    if pixel_format is PixelFormat.RGB8:
        return np.asarray(cv2.cvtColor(colour, cv2.COLOR_BGR2RGB), np.uint8).reshape(-1)
    return _yuv422(colour, luma_first=pixel_format is PixelFormat.YUV422_8)


def _deepened(grey: Image, depth: int) -> NDArray[np.uint16]:
    wide = grey.reshape(-1).astype(np.uint16)
    return np.asarray((wide << (depth - 8)) | (wide >> (16 - depth)), np.uint16)


def _packed(values: NDArray[np.uint16], depth: int) -> Bytes:
    """GigE Vision's two pixels in three bytes: upper bits, lower bits of both, upper bits."""
    odd = len(values) % 2
    pairs = np.append(values, np.zeros(odd, np.uint16)).reshape(-1, 2)
    low = depth - 8
    mask = (1 << low) - 1
    out = np.empty((len(pairs), 3), np.uint8)
    out[:, 0] = pairs[:, 0] >> low
    out[:, 1] = (pairs[:, 0] & mask) | (pairs[:, 1] & mask) << 4
    out[:, 2] = pairs[:, 1] >> low
    flat = out.reshape(-1)
    return flat[:-1] if odd else flat


def _bayer(image: Image, pattern: str) -> Image:
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    mosaic = np.empty(image.shape[:2], np.uint8)
    for y, row in enumerate(_BAYER_ROWS[pattern]):
        for x, channel in enumerate(row):
            mosaic[y::2, x::2] = image[y::2, x::2, channel]
    return mosaic


def _yuv422(colour: Image, luma_first: bool) -> Bytes:
    """Full range, each pair of pixels with the mean of its colours."""
    even = colour[:, : colour.shape[1] // 2 * 2]
    # OpenCV's YCrCb is BT.601 with the full range of 8 bits in every channel
    full = np.asarray(cv2.cvtColor(even, cv2.COLOR_BGR2YCrCb), np.uint16)
    red_blue = (full[:, 0::2, 1:] + full[:, 1::2, 1:] + 1) // 2
    out = np.empty((*even.shape[:2], 2), np.uint8)
    luma, chroma = (0, 1) if luma_first else (1, 0)
    out[..., luma] = full[..., 0]
    out[:, 0::2, chroma] = red_blue[..., 1]  # U belongs to blue
    out[:, 1::2, chroma] = red_blue[..., 0]
    return out.reshape(-1)
