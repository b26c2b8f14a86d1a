"""One feature, many names: how camera generations spell the same thing.

Today's names are those of the GenICam SFNC; the others are from before it (GigE Vision 1.x cameras of the 2000s).
"""

from __future__ import annotations

from collections.abc import Callable

ALIASES: tuple[tuple[str, ...], ...] = (
    ("ExposureTime", "ExposureTimeAbs"),
    ("Gain", "GainAbs", "GainRaw"),  # dB where the camera knows them, else its own steps
    ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"),
    ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled"),
    ("ResultingFrameRate", "AcquisitionResultingFrameRate", "ResultingFrameRateAbs"),
    ("TriggerDelay", "TriggerDelayAbs"),
    ("PtpEnable", "GevIEEE1588"),
    ("PtpStatus", "GevIEEE1588Status"),
    ("PtpDataSetLatch", "GevIEEE1588DataSetLatch"),
    ("PtpOffsetFromMaster", "GevIEEE1588OffsetFromMaster"),
    ("TimestampLatch", "GevTimestampControlLatch"),
    ("TimestampLatchValue", "GevTimestampValue"),
    ("TimestampReset", "GevTimestampControlReset"),
    ("SyncFreeRunTimerTriggerRateAbs", "SyncFreeRunTimerTriggerRate"),
    ("DeviceSerialNumber", "DeviceID"),
    ("DeviceTemperature", "TemperatureAbs"),
    ("ChunkExposureTime", "ChunkExposureTimeAbs"),
    ("UserSetDefault", "UserSetDefaultSelector"),
)
_FAMILY = {name: family for family in ALIASES for name in family}


def spellings(name: str) -> tuple[str, ...]:
    """``name`` itself, then the other names of the same feature."""
    return (name, *(other for other in _FAMILY.get(name, ()) if other != name))


def known_as(name: str, present: Callable[[str], bool]) -> str | None:
    """The first spelling of ``name`` that is ``present``, or None."""
    return next((spelling for spelling in spellings(name) if present(spelling)), None)
