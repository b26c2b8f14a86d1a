"""What can go wrong with a camera, switched on and off while it runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capture_rig.errors import InputError

LIGHTS_OFF = 0.06
"""Share of the light that is left when somebody turns the lamps off."""


@dataclass
class Faults:
    """Every fault of one camera; assigning to a field takes effect with the next packet, frame or command.

    packet_loss : probability that a stream packet (resent ones too) is never sent.
    stall : no frames leave, while control goes on answering.
    unplugged : the cable is out: nothing is answered and nothing is sent, but the camera keeps its state.
    frozen : the picture does not change any more; stamps and ids go on.
    lens_cap : black pictures (with the sensor's noise).
    lights_off : the scene is much darker; light : the same by degrees, as a factor.
    stamp_jump_ns : added to the camera's clock.
    wrong_format : leaders announce another pixel format than the one that was set.
    no_resend : the camera neither offers nor answers packet resends.
    slow_control_ms : every command is answered "pending" first, and only then.
    ptp_lost : the grandmaster is gone: the status goes back to Listening.
    """

    packet_loss: float = 0.0
    stall: bool = False
    unplugged: bool = False
    frozen: bool = False
    lens_cap: bool = False
    lights_off: bool = False
    light: float = 1.0
    stamp_jump_ns: int = 0
    wrong_format: bool = False
    no_resend: bool = False
    slow_control_ms: float = 0.0
    ptp_lost: bool = False

    @property
    def brightness(self) -> float:
        """Factor on the scene's light."""
        return self.light * (LIGHTS_OFF if self.lights_off else 1.0)

    def update(self, changes: Mapping[str, Any], where: str = "faults") -> None:
        """Set several faults by name, all or none. Raises InputError for an unknown name or an impossible value."""
        checked = {name: _checked(name, value, where) for name, value in changes.items()}
        for name, value in checked.items():
            setattr(self, name, value)

    def clear(self) -> None:
        """No faults any more."""
        for field in dataclasses.fields(self):
            setattr(self, field.name, field.default)

    def active(self) -> dict[str, Any]:
        """The faults that are on."""
        values = dataclasses.asdict(self)
        return {f.name: values[f.name] for f in dataclasses.fields(self) if values[f.name] != f.default}


FAULT_NAMES = tuple(field.name for field in dataclasses.fields(Faults))


def _checked(name: str, value: Any, where: str) -> Any:
    kinds: dict[str, type] = {field.name: type(field.default) for field in dataclasses.fields(Faults)}
    if name not in kinds:
        raise InputError(f"there is no fault '{name}'", where=where, remedy=f"Known faults: {', '.join(kinds)}.")
    kind = kinds[name]
    if kind is bool:
        fits = isinstance(value, bool) or value in (0, 1)
    else:
        fits = isinstance(value, int | float) and not isinstance(value, bool)
    high = {"packet_loss": 1.0, "light": 10.0}.get(name)
    if not fits or (kind is float and not value >= 0) or (high is not None and value > high):
        limits = f"a number from 0 to {high:g}" if high else "true or false" if kind is bool else "a number"
        raise InputError(f"{name} = {value!r} is not possible", where=where, remedy=f"Give {limits}.")
    return kind(value)
