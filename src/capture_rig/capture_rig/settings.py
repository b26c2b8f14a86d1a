"""Typed configuration: one frozen dataclass serves ROS parameters, YAML files and plain Python alike.

A settings class is a frozen dataclass whose fields come from :func:`setting`; a field may itself be a settings
class, and is then written with dotted keys (``blob.min_area_m2``) or as a nested mapping. Other plain fields are for
Python code alone.
"""

from __future__ import annotations

import argparse
import dataclasses
import difflib
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar, get_type_hints

from .errors import InputError, shortened

T = TypeVar("T")

_SCALARS = (bool, int, float, str)
LARGEST, LARGEST_INT = 1e12, (1 << 63) - 1  # bounds of an open range
_NAME = re.compile(r"\w[\w-]*(/\w[\w-]*)*", re.ASCII)


def setting(
    default: Any,
    help: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple = (),
    is_name: bool = False,
) -> Any:
    """Return a dataclass field with a default, one line of help, its unit and its allowed values.

    A list as default becomes a default factory, so that instances never share it.
    is_name : a text that ROS takes as a name, as of a frame; the default, which may be empty, is one.
    """
    metadata = {"help": help, "unit": unit, "low": low, "high": high, "choices": choices, "is_name": is_name}
    if isinstance(default, list):
        return dataclasses.field(default_factory=lambda: list(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class Leaf:
    """One scalar (or list) setting: its dotted key, type, default value and metadata."""

    key: str
    type: Any
    default: Any
    metadata: Mapping[str, Any]

    @property
    def has_range(self) -> bool:
        """Whether the setting names a bound of its own."""
        return self.metadata.get("low") is not None or self.metadata.get("high") is not None

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the greatest number allowed; finite even if the setting names none."""
        most = LARGEST_INT if self.type in (int, list[int]) else LARGEST
        low, high = self.metadata.get("low"), self.metadata.get("high")
        return -most if low is None else low, most if high is None else high

    @property
    def range_text(self) -> str:
        """The bounds in words."""
        return "{:.12g} to {:.12g}".format(*self.bounds)


def leaves(cls: type, prefix: str = "") -> Iterator[Leaf]:
    """Yield every scalar or list setting of ``cls``, nested ones under dotted keys."""
    hints = get_type_hints(cls)
    for field in dataclasses.fields(cls):
        key = prefix + field.name
        if dataclasses.is_dataclass(hints[field.name]):
            yield from leaves(hints[field.name], key + ".")
        elif field.metadata:
            yield Leaf(key, hints[field.name], _default(field), field.metadata)


def build_settings(cls: type[T], values: Mapping[str, Any], where: str) -> T:
    """Build ``cls`` from nested or dotted ``values``; missing ones keep their defaults.

    Raises InputError naming ``where``, the key, the value and the remedy for an unknown key, a value of the wrong type,
    or one out of range.
    """
    flat = flatten(values)
    known = {leaf.key: leaf for leaf in leaves(cls)}
    for key, value in flat.items():
        if key not in known:
            raise _unknown(key, list(known), where)
        flat[key] = _checked(known[key], value, where)
    return _assemble(cls, flat, "")


def _default(field: dataclasses.Field) -> Any:
    if field.default is not dataclasses.MISSING:
        return field.default
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    raise TypeError(f"setting {field.name!r} has no default")


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of nested mappings under dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat.update(flatten(value, f"{prefix}{key}."))
        else:
            flat[prefix + str(key)] = value
    return flat


def _assemble(cls: type[T], flat: Mapping[str, Any], prefix: str) -> T:
    hints = get_type_hints(cls)
    given = {}
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        key = prefix + field.name
        if dataclasses.is_dataclass(hints[field.name]):
            given[field.name] = _assemble(hints[field.name], flat, key + ".")
        elif key in flat:
            given[field.name] = flat[key]
    return cls(**given)


def _unknown(key: str, known: list[str], where: str) -> InputError:
    near = difflib.get_close_matches(key, known, n=1)
    hint = f"Did you mean '{near[0]}'?" if near else f"Known keys: {', '.join(sorted(known))}."
    return InputError(f"unknown key '{key}'", where=where, remedy=hint)


def _checked(leaf: Leaf, value: Any, where: str) -> Any:
    value = _converted(leaf, value, where)
    choices, (low, high) = leaf.metadata.get("choices"), leaf.bounds
    unit = f" {leaf.metadata['unit']}" if leaf.metadata.get("unit") else ""
    items = value if isinstance(value, list) else [value]
    if choices and not all(item in choices for item in items):
        raise InputError(
            f"{leaf.key} = {value!r} is not one of {', '.join(map(repr, choices))}",
            where=where,
            remedy=f"Choose one of them; the default is {leaf.default!r}.",
        )
    if not all(isinstance(item, str) or low <= item <= high for item in items):  # NaN is in no range
        raise InputError(
            f"{leaf.key} = {value!r}{unit} is out of range",
            where=where,
            remedy=f"Allowed: {leaf.range_text}{unit}; the default is {leaf.default!r}.",
        )
    if leaf.metadata.get("is_name") and value != leaf.default and not _NAME.fullmatch(value):
        raise InputError(
            f"{leaf.key} = {value!r} is not a name",
            where=where,
            remedy=f"Use letters, digits, _ and -, in parts divided by /; the default is {leaf.default!r}.",
        )
    return value


def _converted(leaf: Leaf, value: Any, where: str) -> Any:
    kind = leaf.type
    if kind in _SCALARS:
        fits = _fits(value, kind)
        value = kind(value) if fits else value
    else:
        item = kind.__args__[0]
        fits = isinstance(value, list | tuple) and all(_fits(v, item) for v in value)
        value = [item(v) for v in value] if fits else value
    if not fits:
        name = kind.__name__ if kind in _SCALARS else str(kind)
        raise InputError(
            f"{leaf.key} = {value!r} is not of type {name}",
            where=where,
            remedy=f"Give a {name}; the default is {leaf.default!r}.",
        )
    return value


def _fits(value: Any, kind: type) -> bool:
    """Return whether a value is of a type; an int serves as a float, a bool is no number."""
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, (int, float) if kind is float else kind)


# --- numbers on a command line: finite, whole where they must be, in a range, of a unit that the message names


def number(unit: str, low: float, high: float, *, whole: bool = False) -> Callable[[str], float]:
    """Return a ``type`` for argparse that parses a number from ``low`` to ``high``, an int if ``whole``.

    unit : for the error ("s", "Hz", "cameras"), "" for none. Any other text, NaN and infinity are an argparse error
    that names the range.
    """

    def read(text: str) -> float:
        try:
            value = int(text) if whole else float(text)
            if low <= value <= high:  # NaN is in no range
                return value
        except ValueError:
            pass
        allowed = f"{'a whole number' if whole else 'a number'} from {low:.12g} to {high:.12g} {unit}".rstrip()
        raise argparse.ArgumentTypeError(f"'{shortened(text, 40)}' cannot be used; give {allowed}")

    return read


SECONDS, FRAME_RATE = number("s", 0, 1e7), number("Hz", 0.1, 1000)
PLAYING_SPEED = number("times real time", 0, 100)  # of footage
