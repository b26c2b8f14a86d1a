"""Exposure and gain of a camera, by hand or by its auto functions."""

from __future__ import annotations

from gige_vision.gvcp import Status

from .feature_table import AUTO, GAIN_RAW_STEP_DB
from .features import Value
from .pixels import Image
from .registers import RegisterError, Registers
from .settings import OLD, CameraSettings

AUTO_TARGET = 110.0
"""Mean grey level that the auto functions steer to."""
AUTO_SPEED = 0.2
AUTO_STEP_PX = 16
DARKEST = 1.0


class ExposureControl:
    """How bright a picture comes out, relative to what the scene shows at nominal exposure and 0 dB.

    While ExposureAuto or GainAuto run, a factor of their own is steered towards a mean grey level, and the feature that
    they rule cannot be written.
    """

    def __init__(self, registers: Registers, settings: CameraSettings) -> None:
        self._registers, self._settings = registers, settings
        self._auto_factor = 1.0
        registers.checks["ExposureTime"] = lambda value: self._refuse_while_auto("ExposureAuto", value)
        registers.checks["Gain"] = lambda value: self._refuse_while_auto("GainAuto", value)

    @property
    def exposure_us(self) -> float:
        return self._registers.real("ExposureTime")

    @property
    def exposure_ns(self) -> int:
        return round(self.exposure_us * 1000)

    @property
    def gain_db(self) -> float:
        value = self._registers.real("Gain")
        return value * GAIN_RAW_STEP_DB if self._settings.generation == OLD else value

    def factor(self, scene: Image) -> float:
        """Factor on the scene's grey levels."""
        by_hand = self.exposure_us / self._settings.nominal_exposure_us * 10.0 ** (self.gain_db / 20.0)
        if not (self._is_auto("ExposureAuto") or self._is_auto("GainAuto")):
            self._auto_factor = 1.0
            return by_hand
        mean = max(float(scene[::AUTO_STEP_PX, ::AUTO_STEP_PX].mean()), DARKEST)
        self._auto_factor += AUTO_SPEED * (AUTO_TARGET / (mean * by_hand) - self._auto_factor)
        return by_hand * self._auto_factor

    def _is_auto(self, key: str) -> bool:
        return self._registers.integer(key) != AUTO["Off"]

    def _refuse_while_auto(self, key: str, value: Value) -> None:
        if self._is_auto(key):
            raise RegisterError(Status.ACCESS_DENIED)
