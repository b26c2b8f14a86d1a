"""What a browser may send: where its view is, and new values of controls; all else viser does not get to read."""

from __future__ import annotations

import logging
import math
from collections.abc import Awaitable, Callable
from typing import Any, Literal

import msgspec

from capture_rig.errors import shortened

Vector = tuple[float, float, float]
ControlOf = Callable[[str], Any]
"""Finds a control by its id, None where there is none."""


class Sent(msgspec.Struct, tag_field="type", tag=lambda name: f"{name}Message", forbid_unknown_fields=True):
    """A message of viser's client, named as viser names it."""


class ViewerCamera(Sent):
    """Where the view is: quaternion wxyz, metres, radians, pixels."""

    wxyz: tuple[float, float, float, float]
    position: Vector
    fov: float
    near: float
    far: float
    image_height: int
    image_width: int
    look_at: Vector
    up_direction: Vector

    def fault(self, control_of: ControlOf) -> str:
        """Say what cannot be used; empty when all can."""
        numbers = (*self.wxyz, *self.position, self.fov, self.near, self.far, *self.look_at, *self.up_direction)
        return "" if all(map(math.isfinite, numbers)) else "a view that is not finite"


class GuiUpdate(Sent):
    """A control's new value; viser would set any attribute of it that is named."""

    uuid: str
    updates: dict[Literal["value"], bool | int | float | str]

    def fault(self, control_of: ControlOf) -> str:
        """Say what cannot be used; empty when all can, and of a control that is gone, which viser leaves alone."""
        control = control_of(self.uuid)
        fits = control is None or all(_fits(value, control) for value in self.updates.values())
        return "" if fits else "a value that its control cannot have"


async def next_message(receive: Callable[[], Awaitable[Any]], control_of: ControlOf, log: logging.Logger) -> bytes:
    """Return the next message that viser may read, and log what is left out before it."""
    while True:
        data = await receive()
        fault = fault_of(data, control_of)
        if not fault:
            return data
        log.warning("the page has left out what a browser sent: %s", fault)


def fault_of(data: str | bytes, control_of: ControlOf) -> str:
    """Say why a message is none of this page's; empty when it is one."""
    if isinstance(data, str):
        return "text"
    try:
        message = msgspec.msgpack.decode(data, type=ViewerCamera | GuiUpdate)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        return shortened(str(error)) or repr(error)
    return message.fault(control_of)


def _fits(value: object, control: Any) -> bool:
    """Is this of the type of the control's value, and one of its options where it has some?"""
    now = control.value
    if isinstance(now, bool) or isinstance(value, bool):
        return isinstance(now, bool) and isinstance(value, bool)
    if isinstance(now, str):
        return isinstance(value, str) and value in getattr(control, "options", (value,))
    return isinstance(now, int | float) and isinstance(value, int | float) and math.isfinite(value)
