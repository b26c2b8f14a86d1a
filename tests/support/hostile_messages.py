"""Hostile messages: for any message type of a graph, what a broken or malicious sender may send.

Attacks are made of a valid message of the topic where one was heard, else of an empty one. Those of bytes are sent as
they are (rclpy publishes serialized bytes): a receiver's middleware meets them first.
"""

from __future__ import annotations

import array
import copy
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message

MIB = 1 << 20
BOMB_PX = 60_000
YAML_BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "\n".join(
    f"{name}: &{name} [{', '.join(['*' + before] * 9)}]"
    for before, name in zip("abcdefghij", "bcdefghijk", strict=True)
)
PATHS = ("../../../../tmp/sagoma_was_here", "/tmp/sagoma_was_here", "~/sagoma_was_here", "a\0b", "x" * 5000, "")


@dataclass(frozen=True)
class Attack:
    """Something to send on every topic that it applies to.

    make : (valid message, generator) -> what to send: messages, or bytes; None where it does not apply.
    repeat : how often; floods are sent as fast as ``per_second`` says.
    """

    name: str
    make: Callable[[Any, np.random.Generator], Any]
    repeat: int = 3
    per_second: float = 200.0


def attacks(now_ns: Callable[[], int]) -> list[Attack]:
    """Return every attack; ``now_ns`` is the clock that stamps follow."""

    def stamped(offset_s: float) -> Callable[[Any, Any], Any]:
        return lambda valid, rng: with_stamp(valid, max(now_ns() + round(offset_s * 1e9), 0))

    def not_a_number(valid: Any, rng: np.random.Generator) -> Any:
        return _mapped(valid, lambda v: float("nan") if isinstance(v, float) else v, np.nan)

    def path(valid: Any, rng: np.random.Generator) -> Any:
        return _text(valid, PATHS[int(rng.integers(len(PATHS)))])

    return [
        Attack("cut in the middle", lambda valid, rng: _cut(serialize_message(valid))),
        Attack("lengths of 4 GiB", _lying),
        Attack("stamp in 100 years", stamped(3.15e9)),
        Attack("NaN", not_a_number),
        Attack("a million elements", _enlarged, repeat=2),
        Attack("picture bomb", _bomb),
        Attack("a cloud of NaN", _nan_cloud),
        Attack("YAML bomb", lambda valid, rng: _text(valid, YAML_BOMB)),
        Attack("path traversal", path, repeat=12),
    ]


# --- of bytes


def _cut(data: bytes) -> bytes:
    return data[: max(4, len(data) // 2)]


def _lying(valid: Any, rng: np.random.Generator) -> bytes:
    """Every aligned number that may be a length says 4 GiB, one after the other."""
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


def _mapped(valid: Any, change: Callable[[Any], Any], element: float | None = None) -> Any:
    """A copy with ``change`` made to every text or number in it, and ``element`` in every array; None: none has it."""
    made = copy.deepcopy(valid)
    return made if _map(made, change, element) else None


def _map(message: Any, change: Callable[[Any], Any], element: float | None) -> bool:
    changed = False
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            changed |= _map(value, change, element)
        elif isinstance(value, list) and value and hasattr(value[0], "get_fields_and_field_types"):
            changed |= any([_map(each, change, element) for each in value[:3]])
        elif isinstance(value, array.array) and value.typecode in "fd" and element is not None:
            setattr(message, name, array.array(value.typecode, [element] * len(value)))
            changed = True
        elif isinstance(value, np.ndarray) and value.dtype.kind == "f" and element is not None:
            setattr(message, name, np.full_like(value, element))
            changed = True
        elif isinstance(value, str | float) and (new := change(value)) is not value:
            setattr(message, name, new)
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


def png_bomb(width: int = BOMB_PX, height: int = BOMB_PX) -> bytes:
    """A small PNG whose header claims ``width`` x ``height`` grey pixels, and whose data inflates to all of them."""
    row = zlib.compress(bytes(MIB), 9)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
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


def requests(kind: type, rng: np.random.Generator) -> Mapping[str, Any]:
    """Return hostile requests of a service type by name: all its texts paths, its numbers NaN, its lists huge."""
    empty = kind.Request()
    made: dict[str, Any] = {"empty": empty}
    for path in PATHS:
        if "\0" not in path and (changed := _filled(kind.Request(), path)) is not None:
            made[f"texts are {path[:24]!r}"] = changed
    for name, number in (("NaN", float("nan")), ("1e300", 1e300)):
        changed = _mapped(empty, lambda v, n=number: n if isinstance(v, float) else v, number)  # type: ignore[misc]
        if changed is not None:
            made[name] = changed
    if hasattr(empty, "transition"):
        empty.transition.id = 255
    return made


def _filled(request: Any, text: str) -> Any:
    """The request with ``text`` in each text, and as the only element of each list of texts or parameters."""
    changed = False
    for name, kind in request.get_fields_and_field_types().items():
        value = getattr(request, name)
        if kind == "string":
            setattr(request, name, text)
            changed = True
        elif kind == "sequence<string>":
            setattr(request, name, [text] * 1000)
            changed = True
        elif kind == "sequence<rcl_interfaces/Parameter>":
            from rclpy.parameter import Parameter

            names = ("bodies.folder", "mesh.folder", "background_file", "camera_info_file", "rig_file", text)
            given = [Parameter(each, Parameter.Type.STRING, text) for each in names]
            setattr(request, name, [each.to_parameter_msg() for each in given])
            changed = True
        elif hasattr(value, "get_fields_and_field_types"):
            changed |= _filled(value, text) is not None
    return request if changed else None
