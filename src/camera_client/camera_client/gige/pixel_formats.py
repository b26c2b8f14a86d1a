"""Pixel formats of GenICam cameras that we can take, and how each becomes a mono or BGR image."""

from __future__ import annotations

import cv2
import numpy as np

from .frame_source import Image

# OpenCV names a Bayer pattern by its second row, GenICam by its first: BayerRG8 is OpenCV's "BG"
_CONVERSIONS: dict[str, int | None] = {
    "BayerRG8": cv2.COLOR_BayerBG2BGR,
    "BayerGR8": cv2.COLOR_BayerGB2BGR,
    "BayerGB8": cv2.COLOR_BayerGR2BGR,
    "BayerBG8": cv2.COLOR_BayerRG2BGR,
    "BGR8": None,
    "RGB8": cv2.COLOR_RGB2BGR,
    "Mono8": None,
}
PREFERENCE = tuple(_CONVERSIONS)
_PACKED_3 = ("BGR8", "RGB8")


def choose_format(available: list[str], channels: str) -> str | None:
    """The preferred one of the camera's formats (colour at one byte a pixel first); None when none can be taken.

    ``channels``: "mono", "colour", or "auto" for either.
    """
    fits = {"auto": PREFERENCE, "mono": ("Mono8",), "colour": tuple(n for n in PREFERENCE if n != "Mono8")}
    return next((name for name in fits[channels] if name in available), None)


def image_shape(name: str, width: int, height: int) -> tuple[int, ...]:
    """Shape of the converted image."""
    return (height, width) if name == "Mono8" else (height, width, 3)


def to_image(data: bytes, name: str, width: int, height: int) -> Image:
    """The raw bytes of one frame as an image of its own memory, (H, W) or (H, W, 3) BGR.

    Raises ValueError when the bytes are too few.
    """
    depth = 3 if name in _PACKED_3 else 1
    size = width * height * depth
    if len(data) < size:
        raise ValueError(f"{len(data)} bytes are too few for {width} x {height} {name}")
    raw = np.frombuffer(data, np.uint8, size).reshape((height, width, 3) if depth == 3 else (height, width))
    conversion = _CONVERSIONS[name]
    return raw.copy() if conversion is None else cv2.cvtColor(raw, conversion)
