"""``.ofs``: how the frames of one camera and those of the motion capture belong together.

Three numbers a, b, s: mocap frame = b + (image frame - a) s, both counted from 1; s is near 2 (120 Hz against 60 Hz).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from capture_rig.errors import InputError

from .number_file import read_numbers

MEANING = "image frame, mocap frame, mocap frames per image frame"


@dataclass(frozen=True)
class Offset:
    """Image frame ``image`` was taken at mocap frame ``mocap``; both 1-based and fractional."""

    image: float
    mocap: float
    mocap_per_image: float


def read_ofs(path: Path) -> Offset:
    """The offset of one camera; InputError naming the file."""
    offset = Offset(*read_numbers(path, 3, MEANING).tolist())
    if offset.mocap_per_image <= 0:
        raise InputError(
            f"{offset.mocap_per_image:g} mocap frames per image frame",
            where=str(path),
            remedy="It must be positive, near 2: copy the file again from the data set.",
        )
    return offset
