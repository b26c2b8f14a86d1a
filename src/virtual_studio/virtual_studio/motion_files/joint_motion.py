"""Positions of named joints over time: what every motion file becomes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_rig.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joints of one skeleton, frame by frame, in the file's own axes and unit of length.

    names (J,): each once; positions (F, J, 3): world; fps: frames a second; source: the file they come from.
    """

    names: tuple[str, ...]
    positions: Array
    fps: float
    source: Path

    def of(self, name: str) -> Array:
        """Positions (F, 3) of one joint."""
        return self.positions[:, self.names.index(name)]


def number(text: str, where: str) -> float:
    """A finite number; InputError where the file has something else."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"'{text}' is not a number", where=where, remedy="The file is damaged: export it again.")
    return value


def read_lines(path: Path, kind: str) -> list[str]:
    """The lines of a text file; InputError when it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="strict").splitlines()
    except FileNotFoundError:
        raise InputError("does not exist", where=str(path), remedy=f"Give the path of a {kind} file.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", where=str(path), remedy=f"Give a {kind} text file.") from None
