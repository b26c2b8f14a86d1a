"""Damages files as disks, networks and people do: bytes flipped, ends cut, values of other types, parts twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 2**63, 1e300, float("nan"), float("inf"), "", "text", "../../x", "x" * 10_000),
    *([], [1], [[1, 2], [3]], [["a"]], {}, {"a": 1}, {1: 2}),
)


def damaged_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return ``data`` with flipped bytes, cut, or with a part doubled or of zeros."""
    changed, kind = bytearray(data), rng.integers(5)
    if not changed:
        return b"\0"
    place = int(rng.integers(len(changed)))
    length = int(rng.integers(1, max(len(changed) // 4, 2)))
    if kind <= 1:
        for where in rng.integers(0, len(changed), int(rng.integers(1, 9))):
            changed[where] ^= int(rng.integers(1, 256))
    elif kind == 2:
        del changed[place:]
    elif kind == 3:
        changed[place:place] = changed[place : place + length]
    else:
        changed[place : place + length] = bytes(min(length, len(changed) - place))
    return bytes(changed)


def damaged_yaml(text: str, rng: np.random.Generator) -> bytes:
    """Return a YAML text in which one value is of another type, missing, or under another name; or damaged bytes."""
    if rng.integers(3) == 0:
        return damaged_bytes(text.encode(), rng)
    document = yaml.safe_load(text)
    holder, key = _place(document, rng)
    kind = rng.integers(4)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, dict):
        holder[VALUES[int(rng.integers(12))]] = holder.pop(key)
    else:
        holder[key] = VALUES[int(rng.integers(len(VALUES)))]
    return yaml.safe_dump(document, sort_keys=False).encode()


def _place(document: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """Return a random mapping or list in the document, and a key in it."""
    while True:
        keys = list(document) if isinstance(document, dict) else range(len(document))
        key = keys[int(rng.integers(len(keys)))]
        inner = document[key]
        if not isinstance(inner, dict | list) or not inner or rng.integers(4) == 0:
            return document, key
        document = inner


def damage(path: Path, rng: np.random.Generator) -> None:
    """Damage a file in place."""
    if path.suffix == ".yaml":
        path.write_bytes(damaged_yaml(path.read_text(encoding="utf-8"), rng))
    else:
        path.write_bytes(damaged_bytes(path.read_bytes(), rng))
