"""Tables of float64 fields, one row a point, ray or person: the form in which packets go into messages.

That of one row which all packets of a frame set carry are its ages at four points of the graph.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import ClassVar

import numpy as np

from capture_rig.errors import InputError


def layout(*names: str) -> np.dtype:
    """Structured dtype of float64 fields in this order."""
    return np.dtype([(name, np.float64) for name in names])


def fill(dtype: np.dtype, *columns: np.ndarray) -> np.ndarray:
    """Structured array (n,) of a :func:`layout` from columns (n,) or (n, k) in the order of its fields."""
    flat = np.column_stack(columns).astype(np.float64)
    return np.ascontiguousarray(flat).view(dtype).reshape(-1)


def column(table: np.ndarray, name: str) -> np.ndarray:
    """Return one field (n,) as float64."""
    return table[name].astype(np.float64)


def columns(table: np.ndarray, *names: str) -> np.ndarray:
    """Several fields as (n, k) float64."""
    return np.stack([table[name] for name in names], axis=1).astype(np.float64)


AGE_POINTS = ("received", "hull", "fitted", "published")


@dataclass(frozen=True)
class SetAges:
    """Nanoseconds from the exposure until the set was closed, its hull left the hull server, the filter had its fit,
    and its joint state was published; 0 where it has not come so far."""

    LAYOUT: ClassVar[np.dtype] = layout(*AGE_POINTS)

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
