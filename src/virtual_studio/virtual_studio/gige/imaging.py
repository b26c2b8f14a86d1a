"""What the sensor makes of the scene, down to the bytes it sends.

Binning, region, exposure, gain, the faults of light and lens, noise, and the pixel format.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gige_vision.gvcp import Status
from gige_vision.gvsp import PixelFormat, encode_chunk

from ..rendering.camera import Image
from .device import OLD, CameraSettings, Device
from .feature_table import AUTO, CHUNKS, MAX_GAIN_DB, RAW_GAINS
from .registers import RegisterError, Registers, Value

Bytes = NDArray[np.uint8]
_SECOND_ROW = {"RG": "GB", "GR": "BG", "GB": "RG", "BG": "GR"}
"""Of the tile of a Bayer pattern, by its first row, which names it."""
_AXES = (
    ("SensorWidth", "BinningHorizontal", "WidthMax", "Width", "OffsetX"),
    ("SensorHeight", "BinningVertical", "HeightMax", "Height", "OffsetY"),
)
_REFRESHING = ("PixelFormat", "ChunkModeActive", *(key for _, binning, _, *sides in _AXES for key in (binning, *sides)))
_STEP = 4
_CHUNK_BYTES = len(encode_chunk(0, bytes(8)))
_NOISE_PIXELS = 1 << 21


class ImagingPipeline:
    """Turns what the scene shows into the picture that leaves the camera, (H, W) or (H, W, 3) uint8."""

    def __init__(self, device: Device) -> None:
        self._registers, self._settings, self._faults = device.registers, device.settings, device.faults
        self.exposure, self.region = ExposureControl(device.registers, device.settings), Region(device.registers)
        self._rng = np.random.default_rng(device.settings.seed)
        self._noise: NDArray[np.int8] | None = None
        self._last: Image | None = None

    def capture(self, scene: Image) -> Image:
        """Takes the picture of what the scene shows."""
        if not self._faults.frozen or self._last is None:
            self._last = self._with_noise(self._exposed(self._cropped(self._binned(scene))))
        return self._last

    def _binned(self, scene: Image) -> Image:
        across, down = self._registers.integer("BinningHorizontal"), self._registers.integer("BinningVertical")
        if across == down == 1:
            return scene
        height, width = scene.shape[0] // down, scene.shape[1] // across
        whole = scene[: height * down, : width * across]
        return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def _cropped(self, scene: Image) -> Image:
        x, y, w, h = (self._registers.integer(key) for key in ("OffsetX", "OffsetY", "Width", "Height"))
        return scene if (h, w) == scene.shape[:2] else scene[y : y + h, x : x + w]

    def _exposed(self, scene: Image) -> Image:
        if self._faults.lens_cap:
            return np.zeros_like(scene)
        factor = self.exposure.factor * self._faults.light
        if factor == 1.0:
            return scene
        table = np.clip(np.rint(np.arange(256) * factor), 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(np.ascontiguousarray(scene), table), np.uint8)

    def _with_noise(self, picture: Image) -> Image:
        if not self._settings.noise:
            return picture
        if self._noise is None:
            noise = self._settings.noise * self._rng.standard_normal(_NOISE_PIXELS, np.float32)
            self._noise = np.clip(np.rint(noise), -128, 127).astype(np.int8)
        while len(self._noise) <= picture.size:  # a sensor of many megapixels sees the pattern repeat
            self._noise = np.tile(self._noise, 2)
        start = int(self._rng.integers(len(self._noise) - picture.size))
        noise_of_frame = self._noise[start : start + picture.size].reshape(picture.shape)
        return np.asarray(cv2.add(picture, noise_of_frame, dtype=cv2.CV_8U), np.uint8)


class ExposureControl:
    """How bright a picture becomes, relative to what the scene shows at nominal exposure and 0 dB.

    While ExposureAuto or GainAuto run, the feature that they control cannot be written; its value stays.
    """

    def __init__(self, registers: Registers, settings: CameraSettings) -> None:
        self._registers, self._settings = registers, settings
        registers.checks["ExposureTime"] = lambda value: self._refuse_while_auto("ExposureAuto", value)
        registers.checks["Gain"] = lambda value: self._refuse_while_auto("GainAuto", value)

    @property
    def exposure_us(self) -> float:
        return self._registers.real("ExposureTime")

    @property
    def exposure_ns(self) -> int:
        return round(self.exposure_us * 1000)

    @property
    def factor(self) -> float:
        """The factor on the scene's grey levels."""
        gain_db = self._registers.real("Gain") * (MAX_GAIN_DB / RAW_GAINS if self._settings.generation == OLD else 1)
        return self.exposure_us / self._settings.nominal_exposure_us * 10.0 ** (gain_db / 20.0)

    def _refuse_while_auto(self, key: str, value: Value) -> None:
        if self._registers.integer(key) != AUTO["Off"]:
            raise RegisterError(Status.ACCESS_DENIED)


class Region:
    """Keeps limits and payload size true whenever region, binning, format or chunks change."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self.enabled_chunks: set[str] = set()
        for key in _REFRESHING:
            registers.writes[key] = self.refresh
        registers.reads["ChunkEnable"] = lambda: int(registers.label("ChunkSelector") in self.enabled_chunks)
        registers.writes["ChunkEnable"] = self._chunk_written
        self.refresh()

    def refresh(self) -> None:
        """Updates the dependent registers; a region that binning made too large is cropped."""
        r = self._registers
        for sensor, binning, largest, size, offset in _AXES:
            most = r.integer(sensor) // r.integer(binning)
            r[largest] = most
            r[size] = min(r.integer(size), most - most % _STEP)
            r[offset] = min(r.integer(offset), most - r.integer(size))
            r[f"{size}Limit"] = most - r.integer(offset)
            r[f"{offset}Limit"] = most - r.integer(size)
        r["PayloadSize"] = self.image_bytes + self.chunk_bytes

    @property
    def pixel_format(self) -> PixelFormat:
        return PixelFormat(self._registers.integer("PixelFormat"))

    @property
    def image_bytes(self) -> int:
        return self.pixel_format.image_bytes(self._registers.integer("Width"), self._registers.integer("Height"))

    @property
    def chunks(self) -> tuple[str, ...]:
        """The chunks that follow each image."""
        if not self._registers.integer("ChunkModeActive"):
            return ()
        return tuple(name for name in CHUNKS if name in self.enabled_chunks)

    @property
    def chunk_bytes(self) -> int:
        """Bytes behind the image: its own chunk's tail, and the chunks."""
        if not self._registers.integer("ChunkModeActive"):
            return 0
        return len(encode_chunk(0, b"")) + _CHUNK_BYTES * len(self.chunks)

    def _chunk_written(self) -> None:
        name = self._registers.label("ChunkSelector")
        if self._registers.integer("ChunkEnable"):
            self.enabled_chunks.add(name)
        else:
            self.enabled_chunks.discard(name)
        self.refresh()


def pixel_bytes(image: Image, pixel_format: PixelFormat) -> Bytes:
    """Encodes a picture, (H, W) grey or (H, W, 3) BGR, in a format that the cameras offer: bytes (n,).

    More than 8 bits repeat the upper bits below, so that black stays black and white white. A grey picture gives grey
    colours, a coloured one the grey of BT.601.
    """
    if not pixel_format.is_colour:
        grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        if pixel_format.depth == 8:
            return np.ascontiguousarray(grey).reshape(-1)
        deep = _deepened(grey, pixel_format.depth)
        if pixel_format.is_packed:
            return _packed(deep, pixel_format.depth)
        if pixel_format.name.endswith("p"):
            return _row_of_bits(deep, pixel_format.depth)[: pixel_format.image_bytes(grey.shape[1], grey.shape[0])]
        return deep.astype("<u2").view(np.uint8)
    if pixel_format.is_bayer:
        return _bayer(image, pixel_format.name[len("Bayer") : -1]).reshape(-1)
    colour = image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    if pixel_format is PixelFormat.BGR8:
        return np.ascontiguousarray(colour).reshape(-1)
    if pixel_format is PixelFormat.RGB8:
        return np.asarray(cv2.cvtColor(colour, cv2.COLOR_BGR2RGB), np.uint8).reshape(-1)
    return _yuv422(colour)


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


def _row_of_bits(values: NDArray[np.uint16], depth: int) -> Bytes:
    """One long number, the first pixel in its lowest bits: four pixels a time, which fill whole bytes."""
    fours = np.append(values, np.zeros(-len(values) % 4, np.uint16)).reshape(-1, 4).astype("<u8")
    number = np.bitwise_or.reduce(fours << (depth * np.arange(4, dtype=np.uint64)), axis=1)
    return np.ascontiguousarray(number.view(np.uint8).reshape(-1, 8)[:, : depth // 2]).reshape(-1)


def _bayer(image: Image, first_row: str) -> Image:
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    mosaic = np.empty(image.shape[:2], np.uint8)
    for y, row in enumerate((first_row, _SECOND_ROW[first_row])):
        for x, colour in enumerate(row):
            mosaic[y::2, x::2] = image[y::2, x::2, "BGR".index(colour)]
    return mosaic


def _yuv422(colour: Image) -> Bytes:
    """Full range, each pair of pixels with the mean of its colours."""
    even = colour[:, : colour.shape[1] // 2 * 2]
    # OpenCV's YCrCb is BT.601 with the full range of 8 bits in every channel
    full = np.asarray(cv2.cvtColor(even, cv2.COLOR_BGR2YCrCb), np.uint16)
    red_blue = (full[:, 0::2, 1:] + full[:, 1::2, 1:] + 1) // 2
    out = np.empty((*even.shape[:2], 2), np.uint8)
    out[..., 0] = full[..., 0]
    out[:, 0::2, 1] = red_blue[..., 1]  # U belongs to blue
    out[:, 1::2, 1] = red_blue[..., 0]
    return out.reshape(-1)
