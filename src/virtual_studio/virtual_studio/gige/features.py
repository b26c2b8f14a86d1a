"""What a feature of a camera is: one row of the table that register memory and GenICam XML are both made from."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import Enum
from itertools import count

Value = int | float | str

FEATURE_SPACE = 0x1_0000
"""Where the registers begin that have no place in the standard."""


class Kind(Enum):
    """What a feature looks like to a client; registers hold big-endian integers, doubles or texts."""

    INTEGER = "Integer"
    FLOAT = "Float"
    ENUMERATION = "Enumeration"
    BOOLEAN = "Boolean"
    COMMAND = "Command"
    STRING = "String"


@dataclass(frozen=True)
class Feature:
    """One feature and its register.

    key : what this program calls it, whatever name the camera's generation gives it.
    name : its GenICam name; "" for a register that no client sees by name.
    address, length : its register, bytes; address -1: wherever there is room.
    default : value after power-on; low, high, step : limits of what may be written.
    low_key, high_key : the features that hold the limits instead, where they depend on others.
    entries : an enumeration's names and values.
    bits : (first, last), counted from the lowest: this feature is only a part of the register at its address, which
    another row describes.
    locked : cannot be written while frames are being taken. volatile : changes by itself, clients must not cache it.
    chunk : this is no register but the content of a chunk with this id.
    """

    key: str
    kind: Kind
    name: str = ""
    address: int = -1
    length: int = 4
    default: Value = 0
    writable: bool = True
    low: float | None = None
    high: float | None = None
    step: int | None = None
    low_key: str = ""
    high_key: str = ""
    entries: tuple[tuple[str, int], ...] = ()
    bits: tuple[int, int] | None = None
    unit: str = ""
    category: str = ""
    help: str = ""
    locked: bool = False
    volatile: bool = False
    chunk: int = 0
    selector: str = ""

    @property
    def has_register(self) -> bool:
        """False for a view of another row's register, and for a chunk."""
        return self.bits is None and not self.chunk


def placed(features: list[Feature]) -> tuple[Feature, ...]:
    """The same features with an address for each register that had none."""
    addresses = count(FEATURE_SPACE, 8)
    return tuple(
        dataclasses.replace(f, address=_take(addresses, f.length)) if f.address < 0 and f.has_register else f
        for f in features
    )


def integer(key: str, category: str, default: int = 0, **more: object) -> Feature:
    return Feature(key, Kind.INTEGER, name=key, category=category, default=default, **more)  # type: ignore[arg-type]


def real(key: str, category: str, default: float = 0.0, **more: object) -> Feature:
    return Feature(key, Kind.FLOAT, name=key, category=category, default=default, length=8, **more)  # type: ignore[arg-type]


def boolean(key: str, category: str, default: bool = False, **more: object) -> Feature:
    return Feature(key, Kind.BOOLEAN, name=key, category=category, default=int(default), **more)  # type: ignore[arg-type]


def command(key: str, category: str, **more: object) -> Feature:
    return Feature(key, Kind.COMMAND, name=key, category=category, **more)  # type: ignore[arg-type]


def text(key: str, category: str, default: str, length: int, **more: object) -> Feature:
    return Feature(key, Kind.STRING, name=key, category=category, default=default, length=length, **more)  # type: ignore[arg-type]


def choice(key: str, category: str, entries: dict[str, int], default: str = "", **more: object) -> Feature:
    """An enumeration; its default is the first entry unless named."""
    first = entries[default] if default else next(iter(entries.values()))
    return Feature(
        key, Kind.ENUMERATION, name=key, category=category, entries=tuple(entries.items()), default=first, **more
    )  # type: ignore[arg-type]


def hidden(key: str, address: int, default: Value = 0, length: int = 4, writable: bool = False) -> Feature:
    """A register of the standard that no GenICam feature names."""
    kind = Kind.STRING if isinstance(default, str) else Kind.INTEGER
    return Feature(key, kind, address=address, length=length, default=default, writable=writable)


def _take(addresses: count, length: int) -> int:
    address = next(addresses)
    for _ in range((length - 1) // 8):
        next(addresses)
    return address
