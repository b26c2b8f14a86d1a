"""Hostile messages: for any message type of a graph, what a broken or malicious sender may send.

Attacks are made of a valid message of the topic where one was heard, else of an empty one. Those of bytes are sent as
they are (rclpy publishes serialized bytes): a receiver's middleware meets them first.
"""

from __future__ import annotations

import array
import copy
import struct
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message

MIB = 1 << 20
BOMB_PX = 60_000
YAML_BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "\n".join(
    f"{name}: &{name} [{', '.join(['*' + before] * 9)}]"
    for before, name in zip("abcdefghij", "bcdefghijk", strict=True)
)
PATHS = ("../../../../tmp/sagoma_was_here", "/tmp/sagoma_was_here", "~/sagoma_was_here", "a\0b", "x" * 5000, "")


Attack = Callable[[Any, np.random.Generator], Any]
"""(valid message, generator) -> what to send: a message, or bytes; None where it does not apply."""


def attacks(now_ns: Callable[[], int]) -> tuple[Attack, ...]:
    """Return every attack; ``now_ns`` is the clock that stamps follow."""
    return (
        lambda valid, rng: serialize_message(valid)[: max(4, len(serialize_message(valid)) // 2)],  # cut in the middle
        _lying,
        lambda valid, rng: with_stamp(valid, now_ns() + round(3.15e18)),  # in 100 years
        lambda valid, rng: _with_numbers(valid, float("nan")),
        _enlarged,
        _bomb,
        _nan_cloud,
        lambda valid, rng: _text(valid, YAML_BOMB),
        lambda valid, rng: _text(valid, PATHS[int(rng.integers(len(PATHS)))]),
    )


def _lying(valid: Any, rng: np.random.Generator) -> bytes:
    """Bytes in which an aligned number that may be a length says 4 GiB."""
    data = bytearray(serialize_message(valid))
    place = 4 + 4 * int(rng.integers(0, max((min(len(data), 80) - 4) // 4, 1)))
    data[place : place + 4] = b"\xff\xff\xff\xff"
    return bytes(data)


# --- of any message


def with_stamp(valid: Any, stamp_ns: int) -> Any:
    if not hasattr(valid, "header"):
        return None
    made = copy.deepcopy(valid)
    sec, made.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    made.header.stamp.sec = min(sec, 2**31 - 1)
    return made


def _with_numbers(valid: Any, number: float) -> Any:
    """A copy in which every real number is this one; None where it has none."""
    made = copy.deepcopy(valid)
    return made if _set_numbers(made, number) else None


def _set_numbers(message: Any, number: float) -> bool:
    changed = False
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        inner = value[:3] if isinstance(value, list) else [value]
        if isinstance(value, float):
            setattr(message, name, number)
        elif isinstance(value, array.array) and value.typecode in "fd":
            setattr(message, name, array.array(value.typecode, [number] * len(value)))
        elif isinstance(value, np.ndarray) and value.dtype.kind == "f":
            setattr(message, name, np.full_like(value, number))
        elif not any([_set_numbers(one, number) for one in inner if hasattr(one, "get_fields_and_field_types")]):
            continue
        changed = True
    return changed


def _enlarged(valid: Any, rng: np.random.Generator) -> Any:
    """A copy whose lists and arrays are of twenty thousand messages, or a million texts or numbers."""
    made, changed = copy.deepcopy(valid), False
    for name, kind in made.get_fields_and_field_types().items():
        value = getattr(made, name)
        if not kind.startswith("sequence") or not isinstance(value, list | array.array):
            continue
        if isinstance(value, array.array):
            setattr(made, name, array.array(value.typecode, [1]) * 1_000_000)
        elif value:
            setattr(made, name, ["x"] * 1_000_000 if isinstance(value[0], str) else [value[0]] * 20_000)
        changed = True
    return made if changed else None


# --- of single types


def png_bomb() -> bytes:
    """A small PNG whose header claims BOMB_PX x BOMB_PX grey pixels."""
    row = zlib.compress(bytes(MIB), 9)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", BOMB_PX, BOMB_PX, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", row) + chunk(b"IEND", b"")


def _bomb(valid: Any, rng: np.random.Generator) -> Any:
    if not (hasattr(valid, "format") and hasattr(valid, "data")):
        return None
    made = copy.deepcopy(valid)
    made.data = array.array("B", png_bomb())
    return made


def _nan_cloud(valid: Any, rng: np.random.Generator) -> Any:
    if not hasattr(valid, "point_step"):
        return None
    made = copy.deepcopy(valid)
    made.data = array.array("B", struct.pack("<f", np.nan) * (len(made.data) // 4))
    return made if len(made.data) == made.row_step * made.height else None


def _text(valid: Any, text: str) -> Any:
    """The text in a String, or in every value of a diagnostic message."""
    made = copy.deepcopy(valid)
    if hasattr(made, "data") and isinstance(made.data, str):
        made.data = text
        return made
    if hasattr(made, "status") and isinstance(made.status, list):
        made.status = [DiagnosticStatus(name=text[:1000], values=[KeyValue(key=text[:1000], value=text)])]
        return made
    return None


def requests(kind: type) -> Iterator[Any]:
    """Yield an empty request of a service type, and hostile ones: all its texts paths, its numbers NaN or huge."""
    yield kind.Request()
    for path in PATHS:
        if "\0" not in path and (changed := _filled(kind.Request(), path)) is not None:
            yield changed
    for number in (float("nan"), 1e300):
        if (changed := _with_numbers(kind.Request(), number)) is not None:
            yield changed


def _filled(request: Any, text: str) -> Any:
    """The request with ``text`` in each text, and as the only element of each list of texts or parameters."""
    changed = False
    for name, kind in request.get_fields_and_field_types().items():
        value: Any = getattr(request, name)
        if kind == "string":
            value = text
        elif kind == "sequence<string>":
            value = [text] * 1000
        elif kind == "sequence<rcl_interfaces/Parameter>":
            names = ("bodies.folder", "mesh.folder", "background_file", "camera_info_file", "rig_file", text)
            value = [Parameter(each, Parameter.Type.STRING, text).to_parameter_msg() for each in names]
        elif not (hasattr(value, "get_fields_and_field_types") and _filled(value, text) is not None):
            continue
        setattr(request, name, value)
        changed = True
    return request if changed else None
