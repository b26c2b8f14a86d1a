"""A body as a YAML file: full stick lengths by name, shoulder width, the two ratios; metres.

Optionally the build, which the surface follows (`build.py`). The limbs' ``thickness``, which older files have instead,
is left aside.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_rig.errors import InputError
from capture_rig.files import read_text, write_text
from capture_rig.yaml_file import format_mapping, parse_mapping

from .body import BUILD_NUMBERS, Body
from .skeleton import STICK_NAMES

KEYS = ("lengths", "shoulder_width", "shoulder_height_ratio", "hip_width_ratio")
OPTIONAL_KEYS = ("units", "source", "thickness", "build")
MOST_BODY_BYTES = 64 << 10  # that of one person has 1 KB; bodies come as messages too, and parsing takes its time
MAX_LENGTH_M, MAX_BUILD = 2.0, 6.0
_REMEDY = f"A body file is a mapping with the keys {', '.join(KEYS)}."


def load_body(path: str | Path) -> Body:
    """Reads a body file. Raises InputError naming file, key, value and remedy for anything that does not fit."""
    return parse_body(read_text(path, _REMEDY, MOST_BODY_BYTES), str(path))


def save_body(body: Body, path: str | Path, source: str = "") -> None:
    """Writes a body so that :func:`load_body` gives the same numbers; `source` says where the sizes come from.

    All or nothing. Raises InputError when the file cannot be written.
    """
    write_text(path, format_body(body, source))


def parse_body(text: str, where: str) -> Body:
    """Return the body of a body file's text. Raises InputError naming `where`, key, value and remedy."""
    document = _mapping(text, where)
    _check_keys(document, KEYS, OPTIONAL_KEYS, where)
    if document.get("units", "metres") != "metres":
        raise InputError(f"units is {document['units']!r}", where=where, remedy="Write all sizes in metres.")
    lengths = document["lengths"]
    if not isinstance(lengths, Mapping):
        raise InputError(f"lengths is {lengths!r}", where=where, remedy="Give one length for each stick by name.")
    _check_keys(lengths, STICK_NAMES, (), f"{where}: lengths")
    values = [_number(lengths[name], f"{where}: lengths.{name}", MAX_LENGTH_M) for name in STICK_NAMES]
    width = _number(document["shoulder_width"], f"{where}: shoulder_width", MAX_LENGTH_M)
    ratios = [_number(document[key], f"{where}: {key}", 5.0) for key in KEYS[2:]]
    build = _build(document.get("build"), where)
    return Body(0.5 * np.array(values), 0.5 * width, ratios[0], ratios[1], build)


def _build(given: Any, where: str) -> np.ndarray:
    """Return the build in a file; the average one where there is none."""
    if given is None:
        return np.zeros(BUILD_NUMBERS)
    numbers = [v for v in given if isinstance(v, int | float) and np.isfinite(v)] if isinstance(given, list) else []
    if len(numbers) != BUILD_NUMBERS or np.abs(numbers).max() > MAX_BUILD:
        remedy = f"Give {BUILD_NUMBERS} numbers of at most {MAX_BUILD:g}, or leave the key out."
        raise InputError(f"build is {given!r}", where=where, remedy=remedy)
    return np.array(numbers, float)


def format_body(body: Body, source: str = "") -> str:
    """Return a body file's text, from which :func:`parse_body` gives the same numbers."""
    document: dict[str, Any] = {"units": "metres"}
    if source:
        document["source"] = source
    document["lengths"] = {name: float(v) for name, v in zip(STICK_NAMES, body.lengths, strict=True)}
    document["shoulder_width"] = 2.0 * body.half_shoulder_width
    document["shoulder_height_ratio"] = body.shoulder_height_ratio
    document["hip_width_ratio"] = body.hip_width_ratio
    if body.build.any():
        document["build"] = body.build.tolist()
    return format_mapping(document)


def _mapping(text: str, where: str) -> Mapping[str, Any]:
    if len(text) > MOST_BODY_BYTES:
        raise InputError(f"has {len(text)} characters, too many for a body", where=where, remedy=_REMEDY)
    return parse_mapping(text, where, _REMEDY)


def _check_keys(given: Mapping[str, Any], needed: tuple[str, ...], optional: tuple[str, ...], where: str) -> None:
    for key in needed:
        if key not in given:
            raise InputError(f"key '{key}' is missing", where=where, remedy=f"Needed: {', '.join(needed)}.")
    for key in given:
        if key not in needed + optional:
            raise InputError(f"key '{key}' is not known", where=where, remedy=f"Known: {', '.join(needed + optional)}.")


def _number(value: Any, where: str, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"value {value!r} is not a number", where=where, remedy="Give a positive number.")
    if not 0.0 < value <= high:
        raise InputError(
            f"value {value:g} is out of range",
            where=where,
            remedy=f"Give a number above 0 and at most {high:g} (metres for lengths).",
        )
    return float(value)
