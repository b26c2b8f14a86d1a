"""Age of a frame set since its exposure at four points of the graph."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import ClassVar

import numpy as np

from capture_rig.errors import InputError

from .table import layout

POINTS = ("received", "hull", "fitted", "published")


@dataclass(frozen=True)
class SetAges:
    """Nanoseconds from the exposure until the set was closed, its hull left the hull server, the filter had its fit,
    and its joint state was published; 0 where it has not come so far."""

    LAYOUT: ClassVar[np.dtype] = layout(*POINTS)

    received: int = 0
    hull: int = 0
    fitted: int = 0
    published: int = 0

    def to_table(self) -> np.ndarray:
        """Return one row of the structured array LAYOUT."""
        return np.array([astuple(self)], self.LAYOUT)

    @classmethod
    def from_table(cls, table: np.ndarray) -> SetAges:
        """Return the inverse of :meth:`to_table`. Raises InputError for another number of rows."""
        if len(table) != 1:
            raise InputError(f"{len(table)} rows of ages", remedy="Give one row.")
        return cls(*map(int, table[0]))


NO_AGES = SetAges()
