"""Tables of float64 fields, one row a point, ray or person: the form in which packets go into messages.

That of one row which all packets of a frame set carry are its ages at four points of the graph.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import ClassVar, Self

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


class Columns:
    """A packet of n rows whose attributes, (n,) or (n, k), are columns of a table.

    COLUMNS : in the table's order, each attribute, and behind a colon its columns' names where these are others. KINDS:
    of attributes that are not float64.
    """

    COLUMNS: ClassVar[str]
    KINDS: ClassVar[dict[str, type[np.generic]]] = {}
    LAYOUT: ClassVar[np.dtype]
    _names: ClassVar[dict[str, list[str]]]

    points_world: np.ndarray

    def __init_subclass__(cls) -> None:
        given = (column.split(":") for column in cls.COLUMNS.split("; "))
        cls._names = {attribute: names[0].split() if names else [attribute] for attribute, *names in given}
        cls.LAYOUT = layout(*(name for names in cls._names.values() for name in names))

    def __len__(self) -> int:
        return len(self.points_world)

    def to_table(self) -> np.ndarray:
        """Return the rows as the structured array LAYOUT."""
        return fill(self.LAYOUT, *(getattr(self, attribute) for attribute in self._names))

    @classmethod
    def from_table(cls, table: np.ndarray) -> Self:
        """Return the inverse of :meth:`to_table`."""
        given = dict[str, np.ndarray]()
        for attribute, names in cls._names.items():
            values = columns(table, *names) if len(names) > 1 else column(table, *names)
            kind = cls.KINDS.get(attribute, np.float64)
            given[attribute] = values > 0.5 if kind is np.bool_ else values.astype(kind, copy=False)
        return cls(**given)


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
