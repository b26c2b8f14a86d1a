"""Tables of float64 fields, one row a point, ray or person: the form in which packets go into messages.

That of one row which all packets of a frame set carry are its ages at four points of the graph.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Annotated, Any, ClassVar, Self, get_type_hints

import numpy as np

from capture_rig.errors import InputError

UPPER_TRIANGLE = np.triu_indices(3)
ZEROS: Any = None
"""Stands for a column of zeros."""
Flags = Annotated[np.ndarray, np.bool_]
Numbers = Annotated[np.ndarray, np.int32]


def layout(*names: str) -> np.dtype:
    """Structured dtype of float64 fields in this order."""
    return np.dtype([(name, np.float64) for name in names])


def fill(dtype: np.dtype, *columns: np.ndarray) -> np.ndarray:
    """Structured array (n,) of a :func:`layout` from columns (n,) or (n, k) in the order of its fields."""
    flat = np.column_stack(columns).astype(np.float64)
    return np.ascontiguousarray(flat).view(dtype).reshape(-1)


class Columns:
    """A packet of n rows whose attributes, (n,) or (n, k), are columns of a table.

    Annotated are attributes whose columns have other names, and those that are not float64. Symmetric matrices (n, 3,
    3) have six columns, their upper triangle. An attribute that is :data:`ZEROS` becomes zeros.
    """

    LAYOUT: ClassVar[np.dtype]
    _names: ClassVar[dict[str, list[str]]]
    _kinds: ClassVar[dict[str, type[np.generic]]]

    points_world: np.ndarray

    def __init_subclass__(cls) -> None:
        hints = {name: hint for name, hint in get_type_hints(cls, include_extras=True).items() if name[0].islower()}
        notes = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
        cls._names = {name: next((n.split() for n in own if isinstance(n, str)), [name]) for name, own in notes.items()}
        cls._kinds = {name: next((n for n in own if isinstance(n, type)), np.float64) for name, own in notes.items()}
        cls.LAYOUT = layout(*(name for names in cls._names.values() for name in names))

    def __post_init__(self) -> None:
        for name, kind in self._kinds.items():
            if getattr(self, name) is ZEROS:
                object.__setattr__(self, name, np.zeros(len(self), kind))

    def __len__(self) -> int:
        return len(self.points_world)

    def chosen(self, rows: np.ndarray) -> Self:
        """Return some rows, by number or mask, contiguous."""
        if rows.dtype == np.bool_:
            rows = np.flatnonzero(rows)  # rows by number are several times faster than by mask
        return type(self)(*(getattr(self, name).take(rows, axis=0) for name in self._names))

    def to_table(self) -> np.ndarray:
        """Return the rows as the structured array LAYOUT."""
        values = (getattr(self, name) for name in self._names)
        return fill(self.LAYOUT, *(v[:, *UPPER_TRIANGLE] if v.ndim == 3 else v for v in values))

    @classmethod
    def from_table(cls, table: np.ndarray) -> Self:
        """Return the inverse of :meth:`to_table`."""
        given = list[np.ndarray]()
        for names, kind in zip(cls._names.values(), cls._kinds.values(), strict=True):
            values = np.stack([table[name] for name in names], axis=-1).astype(kind)
            if len(names) == len(UPPER_TRIANGLE[0]):
                upper, values = values, np.empty((len(table), 3, 3))
                values[:, *UPPER_TRIANGLE] = values[:, *UPPER_TRIANGLE[::-1]] = upper
            given.append(values[:, 0] if len(names) == 1 else values)
        return cls(*given)


AGE_POINTS = ("received", "hull", "fitted", "published")


@dataclass(frozen=True)
class SetAges:
    """Nanoseconds from the exposure until the set was closed, its hull left the hull server, the filter received its
    fit, and its joint state was published; 0 for later stages."""

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
