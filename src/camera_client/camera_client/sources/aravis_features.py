"""The features and registers of a camera through Aravis. GObject types and errors end here."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from ..gige.features import DeviceRefusal, DeviceSilence, Kind, Value

ERROR_DOMAIN = "arv-device-error-quark"


class AravisFeatures:
    """DeviceAccess of an Aravis.Device; ``Aravis`` and ``GLib`` are the modules.

    Bounds and increments that a device does not describe are None.
    """

    def __init__(self, device: Any, Aravis: Any, GLib: Any) -> None:
        self._device, self._Aravis, self._GLib = device, Aravis, GLib
        self._kinds: dict[str, Kind | None] = {}
        self._types = (
            (Aravis.GcCommand, Kind.COMMAND),
            (Aravis.GcBoolean, Kind.BOOLEAN),
            (Aravis.GcEnumeration, Kind.ENUMERATION),
            (Aravis.GcFloat, Kind.FLOAT),
            (Aravis.GcInteger, Kind.INTEGER),
            (Aravis.GcString, Kind.STRING),
        )

    def kind(self, name: str) -> Kind | None:
        if name not in self._kinds:
            node = self._device.get_feature(name)
            self._kinds[name] = next((kind for type_, kind in self._types if isinstance(node, type_)), None)
        if self._kinds[name] is None:
            return None
        with self._errors():
            return self._kinds[name] if self._device.is_feature_available(name) else None

    def read(self, name: str) -> Value:
        with self._errors():
            return self._method("get_{}_feature_value", name)(name)

    def write(self, name: str, value: Value) -> None:
        with self._errors():
            self._method("set_{}_feature_value", name)(name, value)

    def execute(self, name: str) -> None:
        with self._errors():
            self._device.execute_command(name)

    def limits(self, name: str) -> tuple[float, float] | None:
        bounds = self._described("get_{}_feature_bounds", name)
        return None if bounds is None else tuple(bounds)

    def step(self, name: str) -> float | None:
        value = self._described("get_{}_feature_increment", name)
        return value if value is not None and 0 < value < 1e12 else None  # Aravis gives the least double for "none"

    def choices(self, name: str) -> tuple[str, ...]:
        with self._errors():
            return tuple(self._device.dup_available_enumeration_feature_values_as_strings(name) or ())

    def read_register(self, address: int) -> int:
        with self._errors():
            return self._device.read_register(address) & 0xFFFFFFFF

    def write_register(self, address: int, value: int) -> None:
        with self._errors():
            self._device.write_register(address, value)

    def _method(self, method: str, name: str) -> Callable[..., Any]:
        """Return the device's method for what a feature holds. Raises DeviceRefusal where it holds no value."""
        kind = self.kind(name)
        if kind is None or kind is Kind.COMMAND:
            raise DeviceRefusal(f"{name} holds no value now")
        return getattr(self._device, method.format("string" if kind is Kind.ENUMERATION else kind.value))

    def _described(self, method: str, name: str) -> Any:
        """Return what the device's description says of a number; None where it does not, and of what is none."""
        if self.kind(name) not in (Kind.INTEGER, Kind.FLOAT):
            return None
        with contextlib.suppress(DeviceRefusal), self._errors():
            return self._method(method, name)(name)
        return None

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except self._GLib.Error as error:
            if is_silence(error, self._Aravis):
                raise DeviceSilence(error.message) from None
            raise DeviceRefusal(error.message) from None


def is_silence(error: Any, Aravis: Any) -> bool:
    """True for a GLib.Error that says that the device did not answer."""
    silent = (Aravis.DeviceError.TIMEOUT, Aravis.DeviceError.NOT_CONNECTED)
    return error.domain == ERROR_DOMAIN and error.code in {int(code) for code in silent}
