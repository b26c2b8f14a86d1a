"""Sets a camera's GenICam features through Aravis, reads them back and compares; errors say what it would have taken.

GObject types and errors end here.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from enum import Enum
from typing import Any

from capture_rig.errors import InputError

Value = bool | int | float | str
ERROR_DOMAIN = "arv-device-error-quark"

# Thresholds: judgement, no measurement.
FLOAT_TOLERANCE = 0.02  # relative rounding of a float to the sensor's lines or steps
ON, OFF = ("true", "1", "on", "yes"), ("false", "0", "off", "no")
_SWITCH_WORDS = {True: ("On", "True", "Enable", "Enabled"), False: ("Off", "False", "Disable", "Disabled")}


class DeviceRefusal(Exception):
    """The device refused: the feature is locked, absent, or does not take the value."""


class DeviceSilence(Exception):
    """The device did not answer in time: it is off, unplugged, or gone."""


class Kind(Enum):
    """What a feature holds."""

    INTEGER = "integer"
    FLOAT = "float"
    ENUMERATION = "enumeration"
    BOOLEAN = "boolean"
    STRING = "string"
    COMMAND = "command"


class AravisFeatures:
    """An Aravis.Device's features by their exact names, and its 32-bit registers; ``Aravis``, ``GLib``: the modules.

    Every method may raise DeviceSilence when the device does not answer, and DeviceRefusal when it refuses.
    """

    def __init__(self, device: Any, Aravis: Any, GLib: Any) -> None:
        self._device, self._Aravis, self._GLib = device, Aravis, GLib
        self._types = (
            (Aravis.GcCommand, Kind.COMMAND),
            (Aravis.GcBoolean, Kind.BOOLEAN),
            (Aravis.GcEnumeration, Kind.ENUMERATION),
            (Aravis.GcFloat, Kind.FLOAT),
            (Aravis.GcInteger, Kind.INTEGER),
            (Aravis.GcString, Kind.STRING),
        )

    def kind(self, name: str) -> Kind | None:
        """Return what a feature holds; None for one that the device does not have, or not now."""
        node = self._device.get_feature(name)
        kind = next((kind for type_, kind in self._types if isinstance(node, type_)), None)
        return kind if kind is not None and self._ask("is_feature_available", name) else None

    def read(self, name: str) -> Value:
        return self._ask(f"get_{self._type_of(name)}_feature_value", name)

    def write(self, name: str, value: Value) -> None:
        self._ask(f"set_{self._type_of(name)}_feature_value", name, value)

    def execute(self, name: str) -> None:
        self._ask("execute_command", name)

    def limits(self, name: str) -> tuple[float, float] | None:
        """Return smallest and largest value of a number; None where the device does not describe it."""
        return self._described("get_{}_feature_bounds", name)

    def step(self, name: str) -> float | None:
        """Return the distance between the values of a number; None where the device does not describe it."""
        value = self._described("get_{}_feature_increment", name)
        return value if value is not None and 0 < value < 1e12 else None  # Aravis gives the least double for "none"

    def choices(self, name: str) -> tuple[str, ...]:
        """Return the entries of an enumeration that are to be had now."""
        return tuple(self._ask("dup_available_enumeration_feature_values_as_strings", name) or ())

    def read_register(self, address: int) -> int:
        return self._ask("read_register", address) & 0xFFFFFFFF

    def write_register(self, address: int, value: int) -> None:
        self._ask("write_register", address, value)

    def _ask(self, method: str, *arguments: Any) -> Any:
        with device_errors(self._Aravis, self._GLib):
            return getattr(self._device, method)(*arguments)

    def _type_of(self, name: str) -> str:
        """Return Aravis's word for what a feature holds. Raises DeviceRefusal where it holds no value."""
        kind = self.kind(name)
        if kind is None or kind is Kind.COMMAND:
            raise DeviceRefusal(f"{name} holds no value now")
        return "string" if kind is Kind.ENUMERATION else kind.value

    def _described(self, method: str, name: str) -> Any:
        """Return the limits of a numeric feature; None if it has none or is not numeric."""
        kind = self.kind(name)
        if kind not in (Kind.INTEGER, Kind.FLOAT):
            return None
        with contextlib.suppress(DeviceRefusal):
            return self._ask(method.format(kind.value), name)
        return None


@contextlib.contextmanager
def device_errors(Aravis: Any, GLib: Any) -> Iterator[None]:
    """Turn what Aravis raises into DeviceSilence, where the device did not answer, and DeviceRefusal."""
    try:
        yield
    except GLib.Error as error:
        silent = (Aravis.DeviceError.TIMEOUT, Aravis.DeviceError.NOT_CONNECTED)
        if error.domain == ERROR_DOMAIN and error.code in {int(code) for code in silent}:
            raise DeviceSilence(error.message) from None
        raise DeviceRefusal(error.message) from None


class Features:
    """Features of one device by any generation's name, with every write checked.

    ``where`` begins every error: which camera this is. ``warnings``: what works, but the user should know.
    """

    def __init__(self, access: AravisFeatures, where: str) -> None:
        self.access, self.where = access, where
        self.warnings: list[str] = []

    def warn(self, text: str) -> None:
        """Add a warning, once; "" is none."""
        if text and text not in self.warnings:
            self.warnings.append(text)

    def find(self, name: str) -> str | None:
        """Return the name under which this device has the feature; None when it has it under none."""
        return next((spelling for spelling in spellings(name) if self.access.kind(spelling) is not None), None)

    def require(self, name: str, key: str) -> str:
        """Return the same as :meth:`find`; InputError, blaming the setting ``key``, when there is no such feature."""
        found = self.find(name)
        if found is None:
            raise self._error(
                f"has no feature {' or '.join(spellings(name))}, which {key} needs",
                f"Leave {key} out, or use a camera that has it.",
            )
        return found

    def read(self, name: str) -> Value | None:
        """Return the feature's value; None when the device has no such feature or does not let it be read now."""
        found = self.find(name)
        if found is None or self.access.kind(found) is Kind.COMMAND:
            return None
        try:
            return self.access.read(found)
        except DeviceRefusal:
            return None

    def number(self, name: str) -> float | None:
        """Return the feature's value when it is a number."""
        value = self.read(name)
        return None if value is None or isinstance(value, str) else float(value)

    def ensure(self, name: str, wanted: Value, key: str) -> None:
        """Set a feature that may be absent, unless it is so already: what needs no change may well be locked."""
        found = self.find(name)
        if found is not None and self.read(found) != wanted:
            self.set(found, wanted, key)

    def set(self, name: str, wanted: Value, key: str) -> Value:
        """Set, read back, compare; returns the value read back. ``wanted`` may be text for any kind of feature.

        A feature that may only be written is taken to hold what it was given. Raises InputError naming feature,
        wanted and got value, what is allowed, and the setting ``key`` to change.
        """
        found = self.require(name, key)
        kind = self.access.kind(found)
        if kind is Kind.COMMAND:
            raise self._error(
                f"{found} is a command and takes no value (asked for {wanted!r})",
                f"Write '{found}!' in {key} to run it.",
            )
        assert kind is not None
        try:
            value = self._on_grid(found, _parsed(kind, wanted))
        except ValueError:
            raise self._error(f"{found} = {wanted!r} is no {kind.value}", f"Give a proper value in {key}.") from None
        try:
            self.access.write(found, value)
        except DeviceRefusal as refusal:
            raise self._error(
                f"refuses {found} = {value} ({refusal})",
                f"{self._allowance(found)}Change {key}, or what locks this feature.",
            ) from None
        got = self.read(found)
        if got is None:
            return value
        if not self._same(found, value, got):
            raise self._error(
                f"took {found} = {got} instead of {value}",
                f"{self._allowance(found)}Set {key} to a value that the camera keeps.",
            )
        return got

    def switch(self, name: str, on: bool, key: str) -> Value:
        """Set what is a boolean on one camera, On and Off on the next, and 1 and 0 on a third."""
        found = self.require(name, key)
        words: tuple[str, ...] = _SWITCH_WORDS[on]
        if self.access.kind(found) is Kind.ENUMERATION:
            words = tuple(word for word in words if word in self.access.choices(found)) or words
        return self.set(found, words[0], key)

    def switch_off(self, name: str, key: str) -> None:
        """Switch a feature off that may be absent, unless it is off already."""
        if self.read(name) not in (None, False, 0, "Off"):
            self.switch(name, False, key)

    def run(self, name: str, key: str) -> None:
        """Run a command. Raises InputError when there is none, or it is refused."""
        found = self.require(name, key)
        if self.access.kind(found) is not Kind.COMMAND:
            raise self._error(f"{found} is no command", f"Write '{found}=value' in {key} to set it.")
        try:
            self.access.execute(found)
        except DeviceRefusal as refusal:
            raise self._error(f"refuses {found}! ({refusal})", f"Change {key}.") from None

    def apply(self, lines: Sequence[str], key: str) -> None:
        """Set "Name=value" and run "Name!" (a command), one after the other, in this order."""
        for line in lines:
            name, equals, value = (part.strip() for part in line.partition("="))
            if not equals and name.endswith("!") and len(name) > 1:
                self.run(name[:-1].strip(), key)
            elif equals and name:
                self.set(name, value, key)
            else:
                raise self._error(f"{key} holds {line!r}", "Write 'Name=value', or 'Name!' for a command.")

    # --- values --------------------------------------------------------------------------------------------------

    def _on_grid(self, name: str, value: Value) -> Value:
        """Return the value, of an integer in range on its grid; what is out of range is the device's to refuse."""
        if self.access.kind(name) is not Kind.INTEGER or isinstance(value, str):
            return value
        limits, step = self.access.limits(name), self.access.step(name)
        if limits is None or not step or not limits[0] <= value <= limits[1]:
            return value
        return int(limits[0] + step * round((value - limits[0]) / step))

    def _same(self, name: str, wanted: Value, got: Value) -> bool:
        if self.access.kind(name) is not Kind.FLOAT or isinstance(wanted, str) or isinstance(got, str):
            return wanted == got
        return abs(got - wanted) <= max(FLOAT_TOLERANCE * abs(wanted), self.access.step(name) or 1e-9)

    def _allowance(self, name: str) -> str:
        """Return what the feature takes, as a sentence; empty where the device does not describe it."""
        try:
            if self.access.kind(name) is Kind.ENUMERATION:
                return f"Allowed: {', '.join(self.access.choices(name))}. "
            limits, step = self.access.limits(name), self.access.step(name)
        except DeviceRefusal:
            return ""
        if limits is None:
            return ""
        return f"Allowed: {limits[0]:g} to {limits[1]:g}{f' in steps of {step:g}' if step else ''}. "

    def _error(self, what: str, remedy: str) -> InputError:
        return InputError(what, where=self.where, remedy=remedy)


def _parsed(kind: Kind, wanted: Value) -> Value:
    """Return a value, or its text, as what a feature of this kind holds. Raises ValueError."""
    if kind in (Kind.ENUMERATION, Kind.STRING):
        return str(wanted)
    text = str(wanted).lower()
    if kind is not Kind.FLOAT and text in ON + OFF:
        return text in ON if kind is Kind.BOOLEAN else int(text in ON)
    if kind is Kind.INTEGER:
        return int(wanted) if isinstance(wanted, float) and wanted.is_integer() else int(text, 0)
    value = float(text)
    if kind is Kind.BOOLEAN or not math.isfinite(value):
        raise ValueError(text)
    return value


# --- how camera generations spell the same feature: today's name of the GenICam SFNC first, then those from before it
# (GigE Vision 1.x cameras of the 2000s)

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
    ("SyncFreeRunTimerTriggerRateAbs", "SyncFreeRunTimerTriggerRate"),
    ("DeviceTemperature", "TemperatureAbs"),
)
_FAMILY = {name: family for family in ALIASES for name in family}


def spellings(name: str) -> tuple[str, ...]:
    """Return all names of a feature: ``name`` itself, then those of other generations."""
    return (name, *(other for other in _FAMILY.get(name, ()) if other != name))
