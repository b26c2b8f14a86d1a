"""A camera's features and its register memory: accesses, limits and effects.

Each feature is one row of a table, from which both the register memory and the GenICam description are made.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal
from xml.sax.saxutils import escape

from gige_vision.gvcp import Status, decode_text, encode_text

Value = int | float | str

FEATURE_SPACE = 0x1_0000
"""Where the registers begin that have no place in the standard."""
FILE_SPACE = 0x8_0000
"""Where the GenICam description lies."""


Kind = Literal["Integer", "Float", "Enumeration", "Boolean", "Command", "String"]
"""A feature's kind, a GenICam node's tag; registers hold big-endian integers, doubles or texts."""


@dataclass(frozen=True)
class Feature:
    """One feature and its register.

    category : "" of a register that no client sees by name.
    address, length : its register, bytes; address -1: wherever there is room.
    default : value after power-on; low, high, step : limits of writes.
    high_of : the feature that holds the upper limit instead.
    entries : an enumeration's names and values.
    bits : (first, last), counted from the lowest: this feature is only a part of the register at its address, which
    another row describes.
    volatile : changes by itself, clients must not cache it.
    """

    kind: Kind
    name: str
    default: Value = 0
    address: int = -1
    length: int = 4
    writable: bool = True
    low: float | None = None
    high: float | None = None
    step: int | None = None
    high_of: str = ""
    entries: tuple[tuple[str, int], ...] = ()
    bits: tuple[int, int] | None = None
    unit: str = ""
    category: str = ""
    volatile: bool = False


def placed(features: list[Feature]) -> tuple[Feature, ...]:
    """Assigns an address to each register without one."""
    found, free = [], FEATURE_SPACE
    for feature in features:
        if feature.address < 0:
            feature, free = dataclasses.replace(feature, address=free), free + -(-feature.length // 8) * 8
        found.append(feature)
    return tuple(found)


integer, boolean, command = (partial(Feature, kind) for kind in ("Integer", "Boolean", "Command"))
real = partial(Feature, "Float", length=8)


def text(name: str, default: str, length: int, address: int, writable: bool = True) -> Feature:
    return Feature("String", name, default, address, length, writable)


def choice(name: str, entries: dict[str, int], default: str = "", **more: Any) -> Feature:
    """Return an enumeration; its default is the first entry unless named."""
    value = entries[default or next(iter(entries))]
    return Feature("Enumeration", name, value, entries=tuple(entries.items()), **more)


def hidden(name: str, address: int, default: Value = 0, length: int = 4, writable: bool = False) -> Feature:
    """Return a register of the standard that no GenICam feature names."""
    kind: Kind = "String" if isinstance(default, str) else "Integer"
    return Feature(kind, name, default, address, length, writable)


class RegisterError(Exception):
    """A refused access, with its status."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.name)
        self.status = status


class Registers:
    """Big-endian registers, one a feature. Clients come by address, the camera itself by name.

    A client's write is checked against access and limits, then by ``checks[name]`` (which may raise RegisterError), and
    then ``writes[name]`` is called. ``reads[name]`` computes the value whenever a client reads it.
    Registers of the standard that no row describes read as zero.
    """

    def __init__(self, features: Iterable[Feature], file: bytes = b"") -> None:
        self._features = {f.name: f for f in features if f.bits is None}
        self._values: dict[str, Value] = {f.name: f.default for f in self._features.values()}
        self._at: dict[int, Feature] = {}
        self._file = file
        self.checks: dict[str, Callable[[Value], None]] = {}
        self.writes: dict[str, Callable[[], object]] = {}
        self.reads: dict[str, Callable[[], Value]] = {}
        for feature in self._features.values():
            for address in range(feature.address, feature.address + feature.length, 4):
                self._at[address] = feature

    def __getitem__(self, name: str) -> Value:
        return self._values[name]

    def __setitem__(self, name: str, value: Value) -> None:
        self._values[name] = value

    def integer(self, name: str) -> int:
        return int(self._values[name])

    def real(self, name: str) -> float:
        return float(self._values[name])

    def label(self, name: str) -> str:
        """Returns the name of an enumeration's present entry."""
        return next(label for label, value in self._features[name].entries if value == self._values[name])

    def read(self, address: int, count: int) -> bytes:
        if address % 4 or count % 4 or count <= 0:
            raise RegisterError(Status.BAD_ALIGNMENT)
        if address < FILE_SPACE:
            return b"".join(self._word(at) for at in range(address, address + count, 4))
        start = address - FILE_SPACE
        if start + count > len(self._file):
            raise RegisterError(Status.INVALID_ADDRESS)
        return self._file[start : start + count]

    def write(self, address: int, data: bytes) -> None:
        """Handles a client's write of one register, whole. Raises RegisterError."""
        feature = self._at.get(address)
        if feature is None:
            raise RegisterError(Status.INVALID_ADDRESS)
        if address != feature.address or len(data) != feature.length:
            raise RegisterError(Status.BAD_ALIGNMENT)
        if not feature.writable:
            raise RegisterError(Status.WRITE_PROTECT)
        value = _decode(feature, data)
        self._check_limits(feature, value)
        if feature.name in self.checks:
            self.checks[feature.name](value)
        self._values[feature.name] = value
        if feature.name in self.writes:
            self.writes[feature.name]()

    def _word(self, address: int) -> bytes:
        feature = self._at.get(address)
        if feature is None:
            if address < FEATURE_SPACE:
                return bytes(4)
            raise RegisterError(Status.INVALID_ADDRESS)
        if feature.name in self.reads:
            self._values[feature.name] = self.reads[feature.name]()
        return _encode(feature, self._values[feature.name])[address - feature.address :][:4]

    def _check_limits(self, feature: Feature, value: Value) -> None:
        if feature.kind == "Enumeration" and value not in dict(feature.entries).values():
            raise RegisterError(Status.INVALID_PARAMETER)
        if isinstance(value, str):
            return
        low, high = feature.low, self.real(feature.high_of) if feature.high_of else feature.high
        wrong = (low is not None and not value >= low) or (high is not None and not value <= high)
        if wrong or (feature.step is not None and int(value) % feature.step):
            raise RegisterError(Status.INVALID_PARAMETER)


def _encode(feature: Feature, value: Value) -> bytes:
    if feature.kind == "String":
        return encode_text(str(value), feature.length)
    if feature.kind == "Float":
        return struct.pack(">d", value)
    return (int(value) % (1 << 8 * feature.length)).to_bytes(feature.length, "big")


def _decode(feature: Feature, data: bytes) -> Value:
    if feature.kind == "String":
        try:
            return decode_text(data)
        except ValueError:
            raise RegisterError(Status.INVALID_PARAMETER) from None
    if feature.kind == "Float":
        return struct.unpack(">d", data)[0]
    return int.from_bytes(data, "big")


# --- the GenICam description of the same table

VENDOR, MODEL, XML_NAME = "Sagoma", "Studio", "sagoma_studio_camera"
_HEAD = (
    '<?xml version="1.0" encoding="utf-8"?>\n'
    f'<RegisterDescription ModelName="{MODEL}" VendorName="{VENDOR}" StandardNameSpace="GEV" SchemaMajorVersion="1" '
    'SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
    'ProductGuid="5f1b1c2e-6d1b-4a5e-9c57-000000000001" VersionGuid="5f1b1c2e-6d1b-4a5e-9c57-000000000002" '
    'xmlns="http://www.genicam.org/GenApi/Version_1_1" '
    'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
    'xsi:schemaLocation="http://www.genicam.org/GenApi/Version_1_1 '
    'http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd">\n'
)
PORT = "Device"


def genicam_xml(features: Iterable[Feature]) -> bytes:
    """Writes the XML, whole words: categories, a node for every named feature, a register node beneath each."""
    categories: dict[str, str] = {}
    nodes = ""
    for feature in features:
        if feature.category:
            member = f"<pFeature>{feature.name}</pFeature>"
            categories[feature.category] = categories.get(feature.category, "") + member
            nodes += _nodes(feature)
    root = "".join(f"<pFeature>{name}</pFeature>" for name in categories)
    lists = "".join(_element("Category", name, members) for name, members in {"Root": root, **categories}.items())
    xml = f'{_HEAD}{lists}{nodes}<Port Name="{PORT}"/>\n</RegisterDescription>\n'.encode()
    return xml + b" " * (-len(xml) % 4)


def _nodes(feature: Feature) -> str:
    """Return the node of a feature and, but for texts, that of its register."""
    where = f"<Address>0x{feature.address:X}</Address><Length>{feature.length}</Length>"
    where += f"<AccessMode>{'RW' if feature.writable else 'RO'}</AccessMode><pPort>{PORT}</pPort>"
    if feature.kind == "String":
        return _element("StringReg", feature.name, where)
    value = f"<pValue>{feature.name}Reg</pValue>"
    if feature.kind == "Enumeration":
        value = "".join(_element("EnumEntry", n, f"<Value>{v}</Value>") for n, v in feature.entries) + value
    elif feature.kind == "Command":
        value += "<CommandValue>1</CommandValue>"
    elif feature.kind == "Boolean":
        value += "<OnValue>1</OnValue><OffValue>0</OffValue>"
    else:
        numbers = {"Min": feature.low, "Max": feature.high, "Inc": feature.step}
        value += "".join(f"<{tag}>{number!r}</{tag}>" for tag, number in numbers.items() if number is not None)
        value += f"<pMax>{feature.high_of}</pMax>" if feature.high_of else ""
        value += f"<Unit>{escape(feature.unit)}</Unit>" if feature.unit else ""
    register = where + ("<Cachable>NoCache</Cachable>" if feature.volatile or feature.bits else "")
    if feature.bits:
        tag, (first, last) = "MaskedIntReg", (31 - bit for bit in feature.bits)  # bit 0 is the highest
        register += f"<Bit>{first}</Bit>" if first == last else f"<LSB>{first}</LSB><MSB>{last}</MSB>"
    else:
        tag = "FloatReg" if feature.kind == "Float" else "IntReg"
    register += "" if feature.kind == "Float" else "<Sign>Unsigned</Sign>"
    register += "<Endianess>BigEndian</Endianess>"
    return _element(feature.kind, feature.name, value) + _element(tag, f"{feature.name}Reg", register)


def _element(tag: str, name: str, body: str) -> str:
    return f'<{tag} Name="{name}">{body}</{tag}>\n'
