"""The lines of an Acclaim file, which tell where they stand when they are wrong."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture_rig.errors import InputError

from .joint_motion import Array, number, read_lines

DAMAGED = "The file is damaged: get it again."


@dataclass(frozen=True)
class Line:
    """One line's words, and where it stands."""

    words: list[str]
    path: Path
    number: int

    @property
    def where(self) -> str:
        return f"{self.path}, line {self.number}"

    def text(self, k: int) -> str:
        if k >= len(self.words):
            raise InputError(f"'{self.words[0]}' has no value", where=self.where, remedy=DAMAGED)
        return self.words[k]

    def value(self, k: int) -> float:
        return number(self.text(k), self.where)

    def vector(self, first: int = 1) -> Array:
        return np.array([self.value(k) for k in range(first, first + 3)])


def content(path: Path, kind: str) -> list[Line]:
    """Lines that hold something but a comment."""
    lines = [(n, line.split("#", 1)[0].split()) for n, line in enumerate(read_lines(path, kind), 1)]
    return [Line(words, path, n) for n, words in lines if words]
