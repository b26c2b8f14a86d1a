"""Pixel formats of GenICam cameras that we can take, and how each becomes an 8-bit mono or BGR image.

Grey levels of 10 and 12 bits are cut to their upper 8: the background model, and everything after it, works on 8 bits.
A Bayer mosaic is interpolated, or each tile of 2 x 2 pixels is one pixel of an image at half of the size, which invents
nothing: silhouettes are better and cheaper so (test_camera_bayer.py).
Source: EMVA Pixel Format Naming Convention 2.x.
"""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig.kernel import kernel
from gige_vision.gvsp import PixelFormat

from ..frame_source import Image

Bytes = np.ndarray  # (N,) uint8: a frame as it came

# OpenCV names a Bayer pattern by its second row, GenICam by its first: BayerRG8 is "BG"; row and column of a tile's red
BAYER = {
    "BayerRG8": (cv2.COLOR_BayerBG2BGR, 0, 0),
    "BayerGR8": (cv2.COLOR_BayerGB2BGR, 0, 1),
    "BayerGB8": (cv2.COLOR_BayerGR2BGR, 1, 0),
    "BayerBG8": (cv2.COLOR_BayerRG2BGR, 1, 1),
}
# two pixels in four bytes: where the first one's luma is (the second's is two further), Cb and Cr, which they share
YUV = {"YUV422_8": (0, 1, 3), "YUV422_8_UYVY": (1, 0, 2)}
_OLD_NAMES = {
    "BGR8Packed": "BGR8",
    "RGB8Packed": "RGB8",
    "YUV422Packed": "YUV422_8_UYVY",
    "YUV422_YUYV_Packed": "YUV422_8",
    "YCbCr422_8": "YUV422_8",
}


def standard_name(name: str) -> str:
    """Today's name of a pixel format; other names are returned as they are."""
    return _OLD_NAMES.get(name, name)


def choose_format(available: list[str], channels: str) -> str | None:
    """Return the preferred one of the camera's formats, as the camera spells it; None when none can be taken.

    ``channels``: "mono", "colour", or "auto" for either (colour first). Fewer bytes a pixel come before more.
    """
    spelled = {standard_name(name): name for name in reversed(available)}
    fits = (each.name for each in PixelFormat if channels == "auto" or each.is_colour == (channels == "colour"))
    return next((spelled[name] for name in fits if name in spelled), None)


def find_format(wanted: str, available: list[str]) -> str | None:
    """Return the camera's spelling of the format ``wanted``; None when it has no such format."""
    return next((name for name in available if standard_name(name) == standard_name(wanted)), None)


def can_be_halved(name: str, width: int, height: int) -> bool:
    """Whether it is a mosaic of whole tiles."""
    return standard_name(name) in BAYER and width % 2 == height % 2 == 0


def image_shape(name: str, width: int, height: int, halved: bool = False) -> tuple[int, ...]:
    """Shape of the converted image: (H, W), or (H, W, 3) for colour; ``halved``: of a mosaic, at half of the size."""
    if halved:
        return height // 2, width // 2, 3
    return (height, width, 3) if PixelFormat[standard_name(name)].is_colour else (height, width)


def to_image(data: bytes | Bytes, name: str, width: int, height: int, halved: bool = False) -> Image:
    """Return the raw bytes of one frame as an image of its own memory: (H, W), or (H, W, 3) BGR; uint8.

    ``halved``: of a mosaic, (H / 2, W / 2, 3). Raises ValueError when the bytes are too few.
    """
    name = standard_name(name)
    size = PixelFormat[name].image_bytes(width, height)
    if len(data) < size:
        raise ValueError(f"{len(data)} bytes are too few for {width} x {height} {name}")
    raw = data[:size] if isinstance(data, np.ndarray) else np.frombuffer(data, np.uint8, size)
    if name in BAYER:
        mosaic, (code, red_row, red_column) = raw.reshape(height, width), BAYER[name]
        if not halved:
            return cv2.cvtColor(mosaic, code)
        image = np.empty((height // 2, width // 2, 3), np.uint8)
        halve_mosaic(mosaic, red_row, red_column, image)
        return image
    if name in YUV:  # 0 to 255 is the full range (BT.601 weights)
        pairs, (luma, blue, red) = raw.reshape(height, width // 2, 4), YUV[name]
        chroma = (cv2.resize(pairs[..., at], (width, height), interpolation=cv2.INTER_NEAREST) for at in (red, blue))
        return cv2.cvtColor(cv2.merge([raw[luma::2].reshape(height, width), *chroma]), cv2.COLOR_YCrCb2BGR)
    if name == "RGB8":
        return cv2.cvtColor(raw.reshape(height, width, 3), cv2.COLOR_RGB2BGR)
    if name in ("BGR8", "Mono8"):
        return raw.reshape(image_shape(name, width, height)).copy()
    bits = int(name.removeprefix("Mono"))  # of two bytes, little endian, the lower ones
    return (raw.view("<u2") >> (bits - 8)).astype(np.uint8).reshape(height, width)


@kernel
def halve_mosaic(mosaic, red_row, red_column, image):  # type: ignore[no-untyped-def]
    """Write one pixel, BGR, for each tile of 2 x 2 pixels of a Bayer mosaic (2 h, 2 w) into ``image`` (h, w, 3).

    red_row, red_column : of the red pixel in each tile; green is the mean of the two beside it, rounded.
    """
    for y in range(image.shape[0]):
        to, with_red, with_blue = image[y], mosaic[2 * y + red_row], mosaic[2 * y + 1 - red_row]
        for x in range(image.shape[1]):
            red, blue = 2 * x + red_column, 2 * x + 1 - red_column
            to[x, 0] = with_blue[blue]
            to[x, 1] = (np.int32(with_red[blue]) + np.int32(with_blue[red]) + 1) >> 1
            to[x, 2] = with_red[red]
