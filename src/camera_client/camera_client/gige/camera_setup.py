"""Sets a camera up as the settings say: every feature is set, read back and compared."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.errors import InputError
from gige_vision.gvsp import PixelFormat

from ..settings import AravisSettings
from .capture_time import SECOND
from .features import FLOAT_TOLERANCE, Features
from .pixel_formats import can_be_halved, choose_format, find_format, image_shape, standard_name
from .triggers import switch_triggers_off

AUTO_FUNCTIONS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto", "AcquisitionFrameRateAuto")
TRIGGERED = ("line", "action", "software")  # modes of sync in which the camera has no rate of its own


@dataclass(frozen=True)
class CameraSetup:
    """How the camera takes pictures now.

    pixel_format : its standard name. exposure_us, frame_rate : None where the camera does not report it, or waits for
    triggers. halved : images are made at half of the size.
    """

    pixel_format: str
    width: int
    height: int
    exposure_us: float | None
    frame_rate: float | None
    halved: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W) or (H, W, 3), of the images."""
        return image_shape(self.pixel_format, self.width, self.height, self.halved)


def set_up_camera(features: Features, settings: AravisSettings, channels: str, halve_mosaics: bool) -> CameraSetup:
    """Return everything but the trigger. Raises InputError naming the setting for what the camera cannot do."""
    features.apply(settings.features, "aravis.features")
    features.ensure("AcquisitionMode", "Continuous", "aravis.sync")
    switch_triggers_off(features)
    features.switch_off("ChunkModeActive", "aravis.features")
    for name in AUTO_FUNCTIONS:
        features.ensure(name, "Off", "aravis.features")
    pixel_format = standard_name(_set_format(features, settings, channels))
    _set_region(features, settings)
    if settings.exposure_us >= 0:
        features.ensure("ExposureMode", "Timed", "aravis.exposure_us")
        features.set("ExposureTime", settings.exposure_us, "aravis.exposure_us")
    if settings.gain >= 0:
        features.set("Gain", settings.gain, "aravis.gain")
    _set_rate(features, settings)
    if settings.packet_size:
        features.set("GevSCPSPacketSize", settings.packet_size, "aravis.packet_size")
    if settings.packet_delay_ns >= 0:
        ticks_a_second = features.number("GevTimestampTickFrequency") or SECOND
        features.set("GevSCPD", round(settings.packet_delay_ns * ticks_a_second / SECOND), "aravis.packet_delay_ns")
    width, height = _integer(features, "Width"), _integer(features, "Height")
    exposure_us = features.number("ExposureTime")
    rate_hz = None if settings.sync in TRIGGERED else features.number("AcquisitionFrameRate")
    halved = halve_mosaics and can_be_halved(pixel_format, width, height)
    return CameraSetup(pixel_format, width, height, exposure_us, rate_hz, halved)


def _set_format(features: Features, settings: AravisSettings, channels: str) -> str:
    available = list(features.access.choices(features.require("PixelFormat", "aravis.pixel_format")))
    wanted = settings.pixel_format
    chosen = choose_format(available, channels) if wanted == "auto" else find_format(wanted, available)
    if chosen is None:
        raise InputError(
            f"does not offer pixel format {wanted!r} but {', '.join(available)}",
            where=features.where,
            remedy=f"aravis.pixel_format can be {', '.join(PixelFormat.__members__)}.",
        )
    features.set("PixelFormat", chosen, "aravis.pixel_format")
    return chosen


def _set_region(features: Features, settings: AravisSettings) -> None:
    """Binning first, for it changes how large the region may be; then size, from the corner; then the offset."""
    if settings.binning > 0:
        for name in ("BinningHorizontal", "BinningVertical"):
            features.set(name, settings.binning, "aravis.binning")
    for size, offset, key, wanted_size, wanted_offset in (
        ("Width", "OffsetX", "aravis.offset_x", settings.width, settings.offset_x),
        ("Height", "OffsetY", "aravis.offset_y", settings.height, settings.offset_y),
    ):
        if wanted_size < 0 and wanted_offset < 0:
            continue
        if features.find(offset) is not None:
            features.set(offset, 0, key)
        limits = features.access.limits(size)  # at offset 0
        largest = int(limits[1]) if limits else _integer(features, f"{size}Max")
        if wanted_size >= 0:
            features.set(size, wanted_size or largest, f"aravis.{size.lower()}")
        left = largest - _integer(features, size)
        if features.find(offset) is not None and (wanted_offset > 0 or left > 0):
            features.set(offset, left // 2 if wanted_offset < 0 else wanted_offset, key)


def _set_rate(features: Features, settings: AravisSettings) -> None:
    """Set the camera's own rate; where triggers give it, the camera's limit is switched off."""
    if settings.sync in TRIGGERED:
        features.switch_off("AcquisitionFrameRateEnable", "aravis.sync")
        return
    if settings.frame_rate < 0:
        return
    if features.find("AcquisitionFrameRateEnable") is not None:
        features.switch("AcquisitionFrameRateEnable", True, "aravis.frame_rate")
    features.set("AcquisitionFrameRate", settings.frame_rate, "aravis.frame_rate")
    reached = features.number("ResultingFrameRate")
    if reached is not None and reached < (1 - FLOAT_TOLERANCE) * settings.frame_rate:
        features.warn(
            f"{features.where} reaches only {reached:g} of {settings.frame_rate:g} Hz: shorten the exposure, make the "
            "region smaller, or raise the packet size"
        )


def _integer(features: Features, name: str) -> int:
    value = features.number(name)
    if value is None:
        raise InputError(f"does not tell its {name}", where=features.where, remedy="Use another camera.")
    return int(value)
